"""What windows say of the lateral damper of a running gear, and what they say together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason

SHARES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.2, 1.5, 2.0)
"""Particles: shares of the damping on file at which sums are kept; between them innovations are interpolated."""

GEAR = tuple[str, int]  # a running gear: code of its vehicle, and its first axle, from 1


@dataclass(frozen=True, slots=True)
class DamperSums(FrozenArrays):
    """Products of the innovations of q particles, summed over the samples of a window; they add up in any order.

    Of a particle there are m signals: its innovations, by how much each of k uncertain parameters changes them (one
    standard deviation of its class), the second order of that for the first p of them, and by how much they differ from
    those of the next particle. All are over the rms of what the best particle does not explain, so that windows count
    by what is known in them.
    """

    products: Annotated[FloatArray, len(SHARES) - 1, "m", "m"]
    samples: float  # independent ones
    curved: int  # p


@dataclass(frozen=True, slots=True)
class WindowDamper:
    """What one window says of the damper of a running gear."""

    vehicle: str
    first_axle: int
    wheelset: str  # of the first axle
    start_ns: int
    odometer_km: float  # of the vehicle
    content_digest: str  # of the samples of that wheelset
    class_digest: str  # of the class that it was judged by: sums of another one do not add up with these
    mass_std: float  # relative, of the mass above the wheelsets on file. Accelerations show damping over mass
    innovation: float | None = None  # mean square over the largest that is believed; None without a filter
    sums: DamperSums | None = None  # None with ``reason``
    reason: Reason | None = None

    @property
    def gear(self) -> GEAR:
        """Vehicle and first axle."""
        return self.vehicle, self.first_axle


@dataclass(frozen=True, slots=True)
class GearDamper:
    """The damper of a running gear, from its newest windows."""

    vehicle: str
    first_axle: int
    share: Estimate  # damping over that of the class on file
    weak_probability: float | None  # of a share below the limit; None where the share is not estimated
    weak: bool | None  # whether that is likely; None where nothing is known
    windows: int  # that say something
    diverged: int  # windows that were not followed
    refused: int  # windows of no use
    from_ns: int  # start of the first window that counts
    to_ns: int  # start of the last one
    from_km: float  # the odometer there
    to_km: float
