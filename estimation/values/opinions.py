"""What windows say of the friction of the track and of lateral dampers, and what they say together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason
from estimation.values.results import History, ResultKind
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowKey

CREEP: Final = "creep"
"""The stage of creep forces, and the facet that a section and a vehicle with new ones have raised."""
FRICTION: Final = "friction"
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

    wheelset: Annotated[str, Served(example="WS-0001")]
    start_ns: Annotated[int, Served("Start of the window.", "measured_from")]
    vehicle: str
    track_section: str | None
    content_digest: Annotated[str, Served("Of the samples.")]
    status: Status
    contact_force: Annotated[
        Estimate, Served("Lateral force at the contacts: creep and gravitational stiffness.", "contact_force_n")
    ]
    lateral_creep: Annotated[Estimate, Served("Lateral creep force of both wheels.", "lateral_creep_force_n")]
    yaw_creep: Annotated[Estimate, Served("Moment of the creep forces about the vertical.", "yaw_creep_moment_n_m")]
    used_adhesion: Annotated[
        Estimate,
        Served(
            "Creep force of a wheel over its normal force, which a hundredth of the samples exceed.", "used_adhesion_1"
        ),
    ]
    sums: FrictionSums | None = None
    reason: Reason | None = None
    smoothed: bool = False

    @property
    def key(self) -> WindowKey:
        """Wheelset and start."""
        return self.wheelset, self.start_ns


@dataclass(frozen=True, slots=True)
class CellFriction:
    """The friction of a place, pooled over passes."""

    cell: int
    friction: Annotated[  # unestimated where creep was too small; then ``at_least`` is what there is
        Estimate, Served("Coefficient of friction; null where creep shows a lower bound alone.", "friction_1")
    ]
    at_least: float  # lower end of the 95 % interval, 0 where nothing is known
    low_probability: Annotated[
        float,
        Served(
            "Probability of a friction below the limit of `low_adhesion`, load and sensors being as on file.",
            "low_probability_1",
        ),
    ]
    passes: Annotated[int, Served("Passes of wheelsets behind it.")]
    vehicles: int = 0  # whose wheelsets they are

    @property
    def from_m(self) -> Annotated[float, Served("Where it begins, along the section.")]:
        """Where the place begins along the section, m."""
        return self.cell * CELL_LENGTH

    @property
    def to_m(self) -> Annotated[float, Served("Where it ends, along the section.")]:
        """Where it ends, m."""
        return (self.cell + 1) * CELL_LENGTH


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A vehicle, or one wheelset of it, whose passes contradict those of the others."""

    vehicle: str
    wheelset: Annotated[str | None, Served("Null where all passes of the vehicle are left out.")]
    reason: Reason


@dataclass(frozen=True, slots=True)
class SectionAdhesion:
    """The friction along a section over some hours, pooled over the fleet."""

    track_section: Annotated[str, Served("", "section", example="main-1")]
    from_ns: Annotated[int, Served("Start of the first window.", "measured_from")]  # vehicle time
    to_ns: Annotated[int, Served("Start of the last window.", "measured_to")]
    windows: Annotated[int, Served("Windows that are pooled along the section.")]
    cells: Annotated[tuple[CellFriction, ...], Served("Places that were passed, in order of distance.", "places")]
    low_stretches: tuple[tuple[float, float], ...]  # m, begin and end of where friction is low
    left_out: Annotated[  # nothing here rests on their passes
        tuple[LeftOut, ...], Served("Vehicles and wheelsets that contradict the others.")
    ] = ()
    certain_stretches: tuple[
        tuple[float, float], ...
    ] = ()  # m, where friction is so surely low that no geometry has it


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
    """The damper of a running gear, from its newest windows; ``windows`` say something of it."""

    vehicle: str
    first_axle: Annotated[int, Served("First axle of the running gear, from 1.")]
    share: Annotated[
        Estimate,
        Served(
            "Damping over that of the vehicle class on file; `n_windows` counts those that show it.", "damping_share_1"
        ),
    ]
    weak_probability: Annotated[
        float | None, Served("That less than half of it is left; null where unknown.", "weak_probability_1")
    ]
    weak: Annotated[bool | None, Served("Whether less than half of the damping is likely left; null where unknown.")]
    windows: int
    diverged: Annotated[int, Served("Windows that the filter did not follow.", "diverged_windows")]
    refused: Annotated[int, Served("Windows that say nothing of the damper.", "refused_windows")]
    from_ns: Annotated[int, Served("Start of the first window that counts.")]
    to_ns: Annotated[int, Served("Start of the last window that counts.")]
    from_km: Annotated[float, Served("Odometer of the vehicle at the first window.", "odometer_from_km")]
    to_km: Annotated[float, Served("Odometer of the vehicle at the last window.", "odometer_to_km")]


GEAR_DAMPERS = ResultKind("damper", SubjectKind.VEHICLE, GearDamper, History.NEWEST)


def part_of_gear(first_axle: int) -> str:
    """Return the part of the results of a vehicle that a running gear is."""
    return f"{first_axle:04d}"
