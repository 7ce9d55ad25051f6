"""Rails and wheels apart: conicities of wheelsets by section, and what of them belongs to the rails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode

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
    reference: RailsReference | None  # None where nothing was parted
    part: tuple[Estimate, ...]  # conicity of the fleet's mean wheel here less that on the reference
    reference_wheel: tuple[Estimate, ...]  # conicity of the wheel as designed, on these rails
    excess: tuple[Estimate, ...]  # of that over what it would be on the rails as on file
    wheelsets: int  # that ran there
    windows: int
    from_ns: int
    to_ns: int


@dataclass(frozen=True, slots=True)
class WheelPart:
    """What belongs to the wheels of a wheelset in a mileage interval: its conicity on the reference (k,)."""

    wheel: WheelKey
    reference: RailsReference | None
    conicity: tuple[Estimate, ...]
    sections: tuple[str, ...]
    windows: int
    from_ns: int
    to_ns: int


@dataclass(frozen=True, slots=True)
class RailTrend:
    """How fast the excess of a section changes, from its periods."""

    per_year: Estimate  # 1/year
    amplitude: float  # m
    periods: int
    per_100_mgt: Estimate = TONNAGE_NOT_ON_FILE  # 1 by 100 million gross tonnes of traffic

    def with_tonnage(self, tonnage: float | None) -> RailTrend:
        """Return the trend with that by traffic, which runs evenly.

        Args:
            tonnage: Million gross tonnes a year; None where it is not on file.
        """
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

    @property
    def usable(self) -> SectionConicity | None:
        """The cell where nothing speaks against it."""
        return self.cell if self.reason is None else None

    @property
    def damaged(self) -> bool:
        """Whether it cannot be read: it is made again."""
        return not self.digest


@dataclass(frozen=True, slots=True)
class SectionRailsRecord:
    """What the last run found of the rails of a section, with its provenance; superseded by a later one."""

    section: str
    amplitude: tuple[float, ...]  # m
    reference_wheel_profile: str
    periods: tuple[RailPart, ...]  # oldest first
    trend: RailTrend | None
    limit: float  # on the excess
    exceeded: bool | None  # whether the excess is above the limit by its interval; None where it is not known
    reported_amplitude: float | None  # m, at which the limit was looked at
    input_digest: str
    code_version: str
    recorded_ns: int
    refused: Reason | None = None  # why it holds no level though it is named as known
    no_trend: Reason | None = None  # why there is no trend


@dataclass(frozen=True, slots=True)
class WheelsetRailsRecord:
    """The conicity of a wheelset without what belongs to rails, in its newest interval; superseded by a later one."""

    amplitude: tuple[float, ...]  # m
    part: WheelPart
    input_digest: str
    code_version: str
    recorded_ns: int
    refused: Reason | None = None  # why it holds no level though its profiles were measured

    @property
    def wheelset(self) -> str:
        """Serial."""
        return self.part.wheel.wheelset
