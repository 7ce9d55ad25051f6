"""What windows say of friction, lateral dampers and rails, what they say together, and what is published of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Final

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import History, ResultKind, SubjectKind
from estimation.values.sums import INVERSE, SUMS
from estimation.values.units import IN_MM
from estimation.values.windows import OfWindow

CREEP: Final = "creep"
"""The stage of creep forces, and the facet that a section and a vehicle with new ones have raised."""
FRICTION: Final = "friction"


@dataclass(frozen=True, slots=True)
class FrictionSums(FrozenArrays):
    """Sums over the samples of c places of a section, mergeable: the regression of e = h(y - d) - R on saturation.

    e is by how much the rolling radius difference of linear creep falls short of the wheelset's curve, q the part of
    R that its creep moment makes, x the displacement, g_k = q (1/share - 1) what e would be at 1/``INVERSE``[k].
    """

    cells: Annotated[IntArray, "c"]  # place: distance along the section over ``SUMS.cell_length``, rounded down
    samples: Annotated[FloatArray, "c"]
    squares: Annotated[FloatArray, "c", 6]  # sums of e e, e q, q q, e x, q x and x x, m2
    saturated: Annotated[FloatArray, "c", 4, len(INVERSE)]  # sums of g_k e, g_k g_k, g_k q and g_k x, m2


@dataclass(frozen=True, slots=True)
class WindowAdhesion(OfWindow):
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
        return self.cell * SUMS.cell_length

    @property
    def to_m(self) -> Annotated[float, Served("Where it ends, along the section.")]:
        """Where it ends, m."""
        return (self.cell + 1) * SUMS.cell_length


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


GEAR = tuple[str, int]  # a running gear: code of its vehicle, and its first axle, from 1


@dataclass(frozen=True, slots=True)
class DamperSums(FrozenArrays):
    """Products of the innovations of q particles, summed over the samples of a window; they add up in any order.

    Of a particle there are m signals: its innovations, by how much each of k uncertain parameters changes them (one
    standard deviation of its class), the second order of that for the first p of them, and by how much they differ from
    those of the next particle. All are over the rms of what the best particle does not explain, so that windows count
    by what is known in them.
    """

    products: Annotated[FloatArray, len(SUMS.damping_shares) - 1, "m", "m"]
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


TONNAGE_NOT_ON_FILE = Estimate.unknown(Reason(ReasonCode.TONNAGE_UNKNOWN, "the traffic of the section is not on file"))


@dataclass(frozen=True, slots=True, order=True)
class WheelKey:
    """A wheelset over one mileage interval, in which its profiles hardly wear."""

    wheelset: str
    baseline: int  # reprofilings before it
    interval: int  # of mileage since the baseline


@dataclass(frozen=True, slots=True, order=True)
class RailKey:
    """A section over one period, in which its rails hardly wear."""

    section: str
    period: int  # counted from 1970


@dataclass(frozen=True, slots=True, eq=False)
class SectionConicity(FrozenArrays):
    """What the windows of a wheelset in one mileage interval, on one section in one period, give; NaN where unknown."""

    wheel: WheelKey
    rail: RailKey
    amplitude: Annotated[FloatArray, "k"]  # m
    conicity: Annotated[FloatArray, "k"]
    sampled: Annotated[FloatArray, "k"]  # std from the spread of the data, widened to that of a normal distribution
    systematic: Annotated[FloatArray, "k"]  # std that more data of the same kind do not lessen
    scale_std: float  # relative, of a scale of y - d that the alignment of the section leaves open
    windows: int
    from_ns: int
    to_ns: int

    @property
    def key(self) -> tuple[WheelKey, RailKey]:
        """Wheelset and section, with interval and period."""
        return self.wheel, self.rail


@dataclass(frozen=True, slots=True, eq=False)
class KnownWheel(FrozenArrays):
    """A wheelset whose conicity on the reference rails follows from its measured profiles; NaN where it has none."""

    wheel: WheelKey
    conicity: Annotated[FloatArray, "k"]
    std: Annotated[FloatArray, "k"]


class RailsReference(StrEnum):
    """What the rails of a section are compared with: a constant may be moved between all wheels and all rails."""

    KNOWN_RAILS = "known_rails"  # sections whose rails are as on file
    MEASURED_WHEELS = "measured_wheels"  # wheelsets whose profiles were measured
    MEAN = "mean"  # the mean of the sections that wheelsets connect: the level is open


@dataclass(frozen=True, slots=True)
class RailPart:
    """What belongs to the rails of a section in a period, at every amplitude (k,)."""

    rail: RailKey
    reference: Annotated[RailsReference | None, Served("What the rails are compared with; null where nothing was.")]
    part: tuple[Estimate, ...]  # conicity of the fleet's mean wheel here less that on the reference
    reference_wheel: tuple[Estimate, ...]  # conicity of the wheel as designed, on these rails
    excess: tuple[Estimate, ...]  # of that over what it would be on the rails as on file
    wheelsets: Annotated[int, Served("Number of wheelsets that ran on the section.", "n_wheelsets")]
    windows: Annotated[int, Served(name="n_windows")]
    from_ns: int
    to_ns: int


@dataclass(frozen=True, slots=True)
class WheelPart:
    """What belongs to the wheels of a wheelset in a mileage interval: its conicity on the reference (k,)."""

    wheel: WheelKey
    reference: Annotated[RailsReference | None, Served("Whose rails the conicities are for; null where none are.")]
    conicity: tuple[Estimate, ...]
    sections: Annotated[tuple[str, ...], Served("On which it ran.")]
    windows: Annotated[int, Served(name="n_windows")]
    from_ns: int
    to_ns: int


@dataclass(frozen=True, slots=True)
class RailTrend:
    """How fast the excess of a section changes, from its periods."""

    per_year: Annotated[Estimate, Served("Growth of the excess in a year.", "excess_per_year_1")]
    amplitude: Annotated[float, Served(name="amplitude_mm", scale=IN_MM)]  # m
    periods: Annotated[int, Served("Number of periods behind it.", "n_periods")]
    per_100_mgt: Annotated[
        Estimate,
        Served(
            "Growth of the excess with 100 million gross tonnes, where the traffic of the section is on file.",
            "excess_per_100_mgt_1",
        ),
    ] = TONNAGE_NOT_ON_FILE

    def with_tonnage(self, tonnage: float | None) -> RailTrend:
        """Return the trend with that by traffic, million gross tonnes a year, which runs evenly; as it is without."""
        if tonnage is None:
            return self
        return replace(self, per_100_mgt=_scaled(self.per_year, 100.0 / tonnage))


def _scaled(one: Estimate, factor: float) -> Estimate:
    if one.value is None or one.std is None or one.low is None or one.high is None:
        return one
    return replace(one, value=factor * one.value, std=factor * one.std, low=factor * one.low, high=factor * one.high)


@dataclass(frozen=True, slots=True)
class RailsApart(FrozenArrays):
    """Wheel and rail apart, for all cells that were looked at together."""

    amplitude: Annotated[FloatArray, "k"]  # m
    rails: tuple[RailPart, ...]  # in the order of their keys
    wheels: tuple[WheelPart, ...]
    trends: Mapping[str, RailTrend]  # by section
    no_trends: Mapping[str, Reason]  # why the other sections have none
    interaction: Annotated[FloatArray, "k"]  # std of what neither wheel nor rail explains; NaN where nothing was parted
    refused: Mapping[str, Reason] = field(default_factory=dict)  # why sections named as known hold no level
    refused_wheels: Mapping[str, Reason] = field(default_factory=dict)  # why measured wheelsets hold none, by serial


@dataclass(frozen=True, slots=True)
class StoredCell:
    """A cell as it is stored, or why its windows give none, with what it was made from."""

    wheel: WheelKey
    rail: RailKey
    digest: str  # of windows, tables, class and settings; empty where what is stored cannot be read
    cell: SectionConicity | None
    reason: Reason | None  # why it is not used, or why there is none
    windows: int = 0  # that it was made from
    from_ns: int = 0
    to_ns: int = 0
    interval_digest: str = ""  # of what all cells of its mileage interval are made from

    @property
    def usable(self) -> SectionConicity | None:
        """The cell where nothing speaks against it."""
        return self.cell if self.reason is None else None

    @property
    def damaged(self) -> bool:
        """Whether it cannot be read: it is made again."""
        return not self.digest


@dataclass(frozen=True, slots=True)
class RailsFinding:
    """What was found of the rails of a section."""

    amplitude: tuple[float, ...]  # m
    reference_wheel_profile: Annotated[str, Served("The wheel as designed, of most wheelsets.", example="P8")]
    periods: Annotated[tuple[RailPart, ...], Served("Oldest first.")]
    trend: Annotated[RailTrend | None, Served("Null where there is none; `trend_reason_code` says why.")]
    limit: Annotated[float, Served("On the excess.", "limit_1")]
    exceeded: Annotated[
        bool | None,
        Served(
            "Whether the newest excess is beyond the limit, and its interval leaves no doubt of its sign; "
            "null where it is not known: the newest period says why.",
            "limit_exceeded",
        ),
    ]
    reported_amplitude: Annotated[
        float | None, Served("3 mm, or the largest amplitude below that is known.", "limit_amplitude_mm", IN_MM)
    ]
    refused: Annotated[
        Reason | None,
        Served("Why the section holds no level though it is named as known; null where that does not apply.", "reason"),
    ] = None
    no_trend: Annotated[Reason | None, Served("Why there is no trend; null where there is one.", "trend_reason")] = None


@dataclass(frozen=True, slots=True)
class WheelsFinding:
    """The conicity of a wheelset without what belongs to rails, in its newest interval."""

    amplitude: tuple[float, ...]  # m
    part: WheelPart
    refused: Annotated[
        Reason | None,
        Served("Why it holds no level though its profiles were measured; null where that does not apply.", "reason"),
    ] = None


CELLS = "cells"
"""The stage of cells, and the facet that a wheelset with other cells has raised."""
SECTION_RAILS = ResultKind("section_rails", SubjectKind.SECTION, RailsFinding, History.NEWEST)
WHEELSET_RAILS = ResultKind("wheelset_rails", SubjectKind.WHEELSET, WheelsFinding, History.NEWEST)
