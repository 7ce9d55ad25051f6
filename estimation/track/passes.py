"""A pass: what one wheelset felt along a stretch of a section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import BoolArray, FloatArray, frozen_array
from estimation.signals import SignalParameters, running_integrals, stretches
from estimation.types import Window
from estimation.vehicle import VehicleParameters


@dataclass(frozen=True, slots=True)
class Pass:
    """Lateral displacement and rolling radius difference of a wheelset against distance, slow parts meaningless.

    The displacement is the section's, positive to the left of increasing distance; the difference is the wheelset's, its
    left wheel less its right one. Where the wheelset's left wheel runs on the section's right rail ``side`` is -1, and
    y = d - h(R) instead of y = d + h(R).
    """

    wheelset: str
    vehicle: str
    start_ns: int  # of its window
    at: FloatArray  # (n,) m along the section, strictly increasing
    displacement: FloatArray  # (n,) y, m
    difference: FloatArray  # (n,) R, m, measured without knowledge of the track
    side: int = 1  # or -1

    def __post_init__(self) -> None:
        n = len(self.at)
        for name in ("at", "displacement", "difference"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))


def gridded(item: Pass, step: float) -> tuple[int, FloatArray, FloatArray]:
    """Return the first grid point, and y and R (m,) at the grid points ``k * step`` that the pass covers."""
    first, last = int(np.ceil(item.at[0] / step)), int(np.floor(item.at[-1] / step))
    grid = np.arange(first, last + 1) * step
    return first, np.interp(grid, item.at, item.displacement), np.interp(grid, item.at, item.difference)


def passes(
    window: Window, vehicle: VehicleParameters, parameters: SignalParameters, *, mounted_reversed: bool = False
) -> list[Pass]:
    """Return the passes of a window: one for each uninterrupted stretch along which distance rises, or falls.

    A vehicle that runs the section the other way has its axes turned half round: what it feels to its left lies to the
    section's right, and its left wheels run on the section's right rail.

    Parameters
    ----------
    window
        Measured accelerations and distance along its section.
    vehicle
        Parameters of Eq. 2, which turns the yaw motion into rL - rR.
    parameters
        Gates on gaps, length and speed.
    mounted_reversed
        The wheelset's left wheel is on the vehicle's right-hand side.
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
        steps = np.diff(at)
        direction = 1 if steps.min() > 0 else -1 if steps.max() < 0 else 0
        if direction and np.isfinite(y).all() and np.isfinite(R).all():
            mounted = -1 if mounted_reversed else 1
            along = slice(None, None, direction)
            found.append(
                Pass(
                    window.wheelset,
                    window.vehicle,
                    window.start_ns,
                    at[along],
                    direction * y[along],
                    mounted * R[along],
                    direction * mounted,
                )
            )
    return found


def _felt(window: Window, known: BoolArray, part: slice, p: VehicleParameters) -> tuple[FloatArray, FloatArray]:
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
