"""Rails and wheels apart: conicities of wheelsets by section, and what of them belongs to the rails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.quantities import Estimate
from estimation.values.quarantine import SubjectKind
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.results import History, ResultKind

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
class SectionConicity:
    """What the windows of a wheelset in one mileage interval, on one section in one period, give: a cell.

    NaN where an amplitude is not estimated.
    """

    wheel: WheelKey
    rail: RailKey
    amplitude: FloatArray  # (k,) m
    conicity: FloatArray  # (k,)
    sampled: FloatArray  # (k,) std from the spread of the data, widened to that of a normal distribution
    systematic: FloatArray  # (k,) std that more data of the same kind do not lessen
    scale_std: float  # relative, of a scale of y - d that the alignment of the section leaves open
    windows: int
    from_ns: int
    to_ns: int

    def __post_init__(self) -> None:
        k = len(self.amplitude)
        for name in ("amplitude", "conicity", "sampled", "systematic"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))

    @property
    def key(self) -> tuple[WheelKey, RailKey]:
        """Wheelset and section, with interval and period."""
        return self.wheel, self.rail


@dataclass(frozen=True, slots=True, eq=False)
class KnownWheel:
    """A wheelset whose conicity on the reference rails follows from its measured profiles; NaN where it has none."""

    wheel: WheelKey
    conicity: FloatArray  # (k,)
    std: FloatArray  # (k,)

    def __post_init__(self) -> None:
        k = len(self.conicity)
        for name in ("conicity", "std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))


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
class RailsApart:
    """Wheel and rail apart, for all cells that were looked at together."""

    amplitude: FloatArray  # (k,) m
    rails: tuple[RailPart, ...]  # in the order of their keys
    wheels: tuple[WheelPart, ...]
    trends: Mapping[str, RailTrend]  # by section
    no_trends: Mapping[str, Reason]  # why the other sections have none
    interaction: FloatArray  # (k,) std of what neither wheel nor rail explains; NaN where nothing was parted
    refused: Mapping[str, Reason] = field(default_factory=dict)  # why sections named as known hold no level
    refused_wheels: Mapping[str, Reason] = field(default_factory=dict)  # why measured wheelsets hold none, by serial

    def __post_init__(self) -> None:
        k = len(self.amplitude)
        object.__setattr__(self, "amplitude", frozen_array(self.amplitude, (k,), name="amplitude"))
        object.__setattr__(self, "interaction", frozen_array(self.interaction, (k,), name="interaction"))


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
    reference_wheel_profile: str
    periods: tuple[RailPart, ...]  # oldest first
    trend: RailTrend | None
    limit: float  # on the excess
    exceeded: bool | None  # whether the excess is above the limit by its interval; None where it is not known
    reported_amplitude: float | None  # m, at which the limit was looked at
    refused: Reason | None = None  # why it holds no level though it is named as known
    no_trend: Reason | None = None  # why there is no trend


@dataclass(frozen=True, slots=True)
class WheelsFinding:
    """The conicity of a wheelset without what belongs to rails, in its newest interval."""

    amplitude: tuple[float, ...]  # m
    part: WheelPart
    refused: Reason | None = None  # why it holds no level though its profiles were measured


CELLS = "cells"
"""The stage of cells, and the facet that a wheelset with other cells has raised."""
SECTION_RAILS = ResultKind("section_rails", SubjectKind.SECTION, RailsFinding, History.NEWEST)
WHEELSET_RAILS = ResultKind("wheelset_rails", SubjectKind.WHEELSET, WheelsFinding, History.NEWEST)
