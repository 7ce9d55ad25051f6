"""A pass: what one wheelset felt along a stretch of a section, on the section's grid of distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray, frozen_array
from estimation.signals import SignalParameters, running_integrals, stretches
from estimation.types import Window
from estimation.vehicle import VehicleParameters


@dataclass(frozen=True, slots=True)
class Pass:
    """Lateral displacement and rolling radius difference of a wheelset against distance, slow parts meaningless.

    Grid point k of the section lies at ``k * step``; the pass covers first..first + n - 1.
    """

    wheelset: str
    key: int  # start of its window, ns: passes are told apart by (wheelset, key, first)
    first: int
    step: float  # m
    displacement: FloatArray  # (n,) y, m
    difference: FloatArray  # (n,) R, m, measured without knowledge of the track

    def __post_init__(self) -> None:
        n = len(self.displacement)
        for name in ("displacement", "difference"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))

    @property
    def stop(self) -> int:
        """One past its last grid point."""
        return self.first + len(self.displacement)


def passes(window: Window, step: float, vehicle: VehicleParameters, parameters: SignalParameters) -> list[Pass]:
    """Return the passes of a window: one for each uninterrupted stretch, resampled every ``step`` m.

    Parameters
    ----------
    window
        Measured accelerations and distance along its section.
    step
        Grid spacing, m.
    vehicle
        Parameters of Eq. 2, which turns the yaw motion into rL - rR.
    parameters
        Gates on gaps, length and speed.
    """
    with np.errstate(invalid="ignore"):
        usable = window.valid & np.isfinite(window.distance) & (window.speed >= parameters.least_speed_m_s)
    if not usable.any():
        return []
    found = []
    for start, stop in stretches(np.asarray(usable), window, parameters):
        part = slice(start, stop)
        known = np.asarray(usable[part])
        y, R = _felt(window, known, part, vehicle)
        at = np.interp(np.arange(stop - start), np.flatnonzero(known), window.distance[part][known])
        if np.diff(at).min() <= 0:
            continue  # distance runs backwards or stands still: not a pass along this section's direction
        first, last = int(np.ceil(at[0] / step)), int(np.floor(at[-1] / step))
        grid = np.arange(first, last + 1) * step
        if len(grid):
            found.append(
                Pass(window.wheelset, window.start_ns, first, step, np.interp(grid, at, y), np.interp(grid, at, R))
            )
    return found


def _felt(
    window: Window, known: np.ndarray[tuple[int], np.dtype[np.bool_]], part: slice, p: VehicleParameters
) -> tuple[FloatArray, FloatArray]:
    """Return y and the measured R (Eq. 2 solved for rL - rR with S = 2 r0, the small contact angle term left out)."""
    accelerations, rates, displacements = running_integrals(window, known, part)
    V = np.interp(np.arange(len(known)), np.flatnonzero(known), window.speed[part][known])
    y, ψ = displacements[0], displacements[1]
    dy, dψ, dφ = rates[0], rates[1], rates[2]
    f11, f23, l = p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient, p.half_contact_distance  # noqa: E741 - the paper's l
    moment = (
        p.yaw_inertia * accelerations[1]
        + (p.pitch_inertia * V / p.nominal_radius) * dφ
        + (2 * l**2 * f11 / V) * dψ
        + p.yaw_stiffness * ψ
        + p.yaw_damping * dψ
        - (2 * f23 / V) * (dy + p.nominal_radius * dφ - V * ψ)
    )
    return y, np.asarray(-moment * p.nominal_radius / (l * f11))
