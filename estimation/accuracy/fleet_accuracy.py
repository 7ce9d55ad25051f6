"""Over a fleet: how many intervals covered what was measured."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.accuracy.comparison import Comparison
from estimation.accuracy.coverage import CoverageCount
from estimation.accuracy.wheel_contact import AMPLITUDES
from estimation.values.reasons import ReasonCode
from estimation.values.served import Served


class Outcome(StrEnum):
    """Whether an interval covered a measured conicity at 3 mm."""

    COVERED = "covered"
    NOT_COVERED = "not_covered"
    NOT_COMPARED = "not_compared"


@dataclass(frozen=True, slots=True)
class PlacedComparison:
    """A comparison with where the wheelset ran."""

    comparison: Comparison
    vehicle_class: str | None  # of the vehicle at the measurement; None where it was on none
    sections: tuple[str, ...]  # those that the estimate is of

    @property
    def outcome(self) -> Outcome:
        """Whether the estimate's interval covers the measured conicity at 3 mm."""
        covered = self.comparison.at_limit.covered
        if covered is None:
            return Outcome.NOT_COMPARED
        return Outcome.COVERED if covered else Outcome.NOT_COVERED


@dataclass(frozen=True, slots=True)
class CoveragePair:
    """A count of all comparisons, and of those whose estimate was made without a measurement of the same wheels."""

    all: Annotated[CoverageCount, Served("Of all comparisons.", "everything")]
    independent: Annotated[
        CoverageCount, Served("Of those whose estimate was made without a measurement of the same profiles.")
    ]


@dataclass(frozen=True, slots=True)
class FleetAccuracy:
    """What the comparisons of a fleet add up to; at 3 mm where no amplitude is named."""

    at_limit: CoveragePair
    by_amplitude: Mapping[float, CoveragePair]  # m
    by_vehicle_class: Mapping[str, CoveragePair]
    by_section: Mapping[str, CoveragePair]  # an estimate of several sections counts in each
    not_compared: Mapping[ReasonCode, int]


def fleet_accuracy(rows: Sequence[PlacedComparison]) -> FleetAccuracy:
    """Return what some comparisons add up to."""
    reasons = [row.comparison.reason for row in rows]
    return FleetAccuracy(
        at_limit=_count(rows),
        by_amplitude={float(a): _count(rows, index) for index, a in enumerate(AMPLITUDES)},
        by_vehicle_class=_grouped(rows, lambda row: [row.vehicle_class] if row.vehicle_class is not None else []),
        by_section=_grouped(rows, lambda row: row.sections),
        not_compared=dict(sorted(Counter(reason.code for reason in reasons if reason is not None).items())),
    )


def _count(rows: Iterable[PlacedComparison], index: int | None = None) -> CoveragePair:
    """Return the counts at an amplitude, or at that of limits."""
    found = [row.comparison for row in rows]
    outcomes = [(one.at_limit if index is None else one.conicity[index]).covered for one in found]
    alone = [outcome for one, outcome in zip(found, outcomes, strict=True) if one.independent]
    return CoveragePair(CoverageCount.of(outcomes), CoverageCount.of(alone))


def _grouped(
    rows: Iterable[PlacedComparison], keys: Callable[[PlacedComparison], Iterable[str]]
) -> dict[str, CoveragePair]:
    groups: defaultdict[str, list[PlacedComparison]] = defaultdict(list)
    for row in rows:
        for key in keys(row):
            groups[key].append(row)
    return {key: _count(members) for key, members in sorted(groups.items())}
