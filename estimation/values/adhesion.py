"""Creep forces of windows, what they say of the friction of the track by place, and the friction of a section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason
from estimation.values.windows import WindowKey

CELL_LENGTH = 50.0  # m, of the places whose friction is separated
FRICTIONS = (4.0, 1.5, 0.8, 0.6, 0.45, 0.35, 0.28, 0.22, 0.18, 0.15, 0.125, 0.1, 0.08, 0.065, 0.05, 0.035)
"""Coefficients of friction at which sums are kept; between them the sums are interpolated over the inverse."""

INVERSE = frozen_array(1.0 / np.array(FRICTIONS), (len(FRICTIONS),), name="INVERSE")  # (k,) 1/mu, increasing


@dataclass(frozen=True, slots=True)
class FrictionSums(FrozenArrays):
    """Sums over the samples of c places of a section, mergeable: the regression of e = h(y - d) - R on saturation.

    e is by how much the rolling radius difference of linear creep falls short of the wheelset's curve, q the part of
    R that its creep moment makes, x the displacement, g_k = q (1/share - 1) what e would be at 1/``INVERSE``[k].
    """

    cells: Annotated[IntArray, "c"]  # place: distance along the section over ``CELL_LENGTH``, rounded down
    samples: Annotated[FloatArray, "c"]
    squares: Annotated[FloatArray, "c", 6]  # sums of e e, e q, q q, e x, q x and x x, m2
    saturated: Annotated[FloatArray, "c", 4, len(INVERSE)]  # sums of g_k e, g_k g_k, g_k q and g_k x, m2


@dataclass(frozen=True, slots=True)
class WindowAdhesion:
    """Creep forces of one wheelset over one window, and what they say of the friction along its way."""

    wheelset: str
    start_ns: int
    vehicle: str
    track_section: str | None
    content_digest: str  # of the samples it was made from
    status: Status
    contact_force: Estimate  # rms in the band of wavelengths up to the cut-off, N; its std is of filter and load
    lateral_creep: Estimate  # likewise, N
    yaw_creep: Estimate  # likewise, N m
    used_adhesion: Estimate  # creep over normal force of a wheel, exceeded by 1 % of samples: friction is no less
    sums: FrictionSums | None = None  # None where nothing can be said of friction
    reason: Reason | None = None  # why there are no forces, or no sums
    smoothed: bool = False  # the forces are without vibration of the axle boxes, and without what is as fast

    @property
    def key(self) -> WindowKey:
        """Wheelset and start."""
        return self.wheelset, self.start_ns


@dataclass(frozen=True, slots=True)
class CellFriction:
    """The friction of a place, pooled over passes."""

    cell: int
    friction: Estimate  # unestimated where creep was too small; then ``at_least`` is what there is
    at_least: float  # lower end of the 95 % interval, 0 where nothing is known
    low_probability: float  # of a friction below the limit, 0 to 1
    passes: int  # of wheelsets
    vehicles: int = 0  # whose wheelsets they are

    @property
    def from_m(self) -> float:
        """Where the place begins along the section, m."""
        return self.cell * CELL_LENGTH

    @property
    def to_m(self) -> float:
        """Where it ends, m."""
        return (self.cell + 1) * CELL_LENGTH


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A vehicle, or one wheelset of it, whose passes contradict those of the others."""

    vehicle: str
    wheelset: str | None  # None: all of the vehicle
    reason: Reason


@dataclass(frozen=True, slots=True)
class SectionAdhesion:
    """The friction along a section over some hours, pooled over the fleet."""

    track_section: str
    from_ns: int  # vehicle time, start of the first window
    to_ns: int  # start of the last
    windows: int  # behind it
    cells: tuple[CellFriction, ...]  # places that were passed, in order of distance
    low_stretches: tuple[tuple[float, float], ...]  # m, begin and end of where friction is low
    left_out: tuple[LeftOut, ...] = ()  # whose passes contradict those of the others: nothing here rests on them
    certain_stretches: tuple[
        tuple[float, float], ...
    ] = ()  # m, where friction is so surely low that no geometry has it
