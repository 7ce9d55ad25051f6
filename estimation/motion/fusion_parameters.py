"""Where the rolling radius difference of the yaw sensor and that of the lateral motion meet."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FusionParameters:
    """Where the two meet; wavelengths in m."""

    step: float = 0.25
    oversampling: int = 5  # samples per step before short waves are taken out
    shortest: tuple[float, float] = (0.5, 2.0)  # half of it remains: of quiet axle boxes, of those that vibrate
    vibrating: float = 0.08e-3  # rad of (y' + r0 phi')/V in waves shorter than 2 m; quiet axle boxes have half of it
    crossover: float = 15.0  # longer wavelengths come from the lateral motion
    compared: tuple[float, float] = (8.0, 40.0)  # in which g is estimated
    margin: float = 45.0  # m at each end that is not compared
    gravity: float = -0.2  # g known beforehand, 1/m
    gravity_weight: float = 1.6e-4  # m2: squares of the regressor that the knowledge beforehand is worth
