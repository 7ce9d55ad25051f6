"""Rails and wheels apart: conicities of wheelsets by section, and what of them belongs to the rails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.fields import IN_MM, Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.results import History, ResultKind
from estimation.values.runs import SubjectKind

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
    """What the windows of a wheelset in one mileage interval, on one section in one period, give: a cell.

    NaN where an amplitude is not estimated.
    """

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
