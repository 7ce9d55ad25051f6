"""A pass: what one wheelset felt along a stretch of a section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import BoolArray, FloatArray, frozen_array
from estimation.signals import SignalParameters, running_integrals, stretches
from estimation.track.fusion import Felt, FusionParameters, fused
from estimation.types import Window
from estimation.vehicle import VehicleParameters


@dataclass(frozen=True, slots=True)
class Pass:
    """Lateral displacement and rolling radius difference of a wheelset against distance, slow parts meaningless.

    The displacement is the section's, positive to the left of increasing distance; the difference is the wheelset's,
    its left wheel less its right one. Where the wheelset's left wheel runs on the section's right rail ``side`` is -1,
    and y = d - h(R) instead of y = d + h(R).
    """

    wheelset: str
    vehicle: str
    start_ns: int  # of its window
    at: FloatArray  # (n,) m along the section, strictly increasing
    displacement: FloatArray  # (n,) y, m
    difference: FloatArray  # (n,) R, m, measured without knowledge of the track
    side: int = 1  # or -1
    elastic: FloatArray | None = None  # (n,) m, part of R that scales with yaw stiffness over creep coefficient

    def __post_init__(self) -> None:
        n = len(self.at)
        for name in ("at", "displacement", "difference"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        if self.elastic is not None:
            object.__setattr__(self, "elastic", frozen_array(self.elastic, (n,), name="elastic"))


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
        at = np.interp(np.arange(stop - start), np.flatnonzero(known), window.distance[part][known])
        steps = np.diff(at)
        direction = 1 if steps.min() > 0 else -1 if steps.max() < 0 else 0
        if direction:
            felt = felt_along(window, known, part, vehicle, np.asarray(direction * at))
            found += _placed(window, felt, vehicle, direction, -1 if mounted_reversed else 1)
    return found


def _placed(window: Window, felt: Felt, vehicle: VehicleParameters, direction: int, mounted: int) -> list[Pass]:
    """Return the pass of one stretch, along the section's own direction."""
    if not (np.isfinite(felt.displacement).all() and np.isfinite(felt.difference).all()):
        return []
    grid = fused(felt, vehicle, FusionParameters())
    if len(grid.run) < 2:  # noqa: PLR2004 - a pass has a length
        return []
    along = slice(None, None, direction)
    return [
        Pass(
            window.wheelset,
            window.vehicle,
            window.start_ns,
            direction * grid.run[along],
            direction * grid.displacement[along],
            mounted * grid.difference[along],
            direction * mounted,
            mounted * grid.elastic[along],
        )
    ]


def felt_along(window: Window, known: BoolArray, part: slice, p: VehicleParameters, run: FloatArray) -> Felt:
    """Return y, the measured R (Eq. 2 solved for rL - rR with S = 2 r0, the contact angle terms left out) and psi.

    Parameters
    ----------
    window
        Measured accelerations and speed.
    known
        (m,) which samples of the stretch are usable.
    part
        The stretch.
    p
        Parameters of Eq. 1 and Eq. 2.
    run
        (m,) m, increasing.
    """
    accelerations, rates, displacements = running_integrals(window, known, part)
    V = np.interp(np.arange(len(known)), np.flatnonzero(known), window.speed[part][known])
    y, ψ, φ = displacements[:3]
    dy, dψ, dφ = rates[:3]
    f11, f23, l = p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient, p.half_contact_distance  # noqa: E741 - the paper's l
    rolling_velocity = dy + p.nominal_radius * dφ
    elastic = p.yaw_inertia * accelerations[1] + p.yaw_stiffness * ψ + p.yaw_damping * dψ
    moment = (
        elastic
        + (p.pitch_inertia * V / p.nominal_radius) * dφ
        + (2 * l**2 * f11 / V) * dψ
        - (2 * f23 / V) * (rolling_velocity - V * ψ)
    )
    force = (
        p.wheelset_mass * accelerations[0]
        + (2 * f23 / V) * dψ
        + p.load * φ
        + p.suspended_mass * accelerations[3]  # what the suspension takes up
    )
    per_moment = -p.nominal_radius / (l * f11)
    return Felt(
        run=run,
        speed=V,
        displacement=y,
        difference=np.asarray(per_moment * moment),
        elastic=np.asarray(per_moment * elastic),
        yaw=np.asarray(rolling_velocity / V + force / (2 * p.lateral_creep_coefficient)),
    )
