"""Trends, as results of their stage."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from estimation.values.runs import Result
from estimation.values.trend import TREND, TrendRecord, WearTrend, baseline_part
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.results import ResultStore


@dataclass(frozen=True, slots=True)
class TrendStore:
    """Trends, append-only."""

    results: ResultStore
    geometries: GeometryStore

    def put(self, record: TrendRecord) -> bool:
        """Put a trend; False if the newest of its wheelset is of the same baseline, inputs and numerics."""
        return bool(self.results.put_all(TREND, [result_of_trend(record)]))

    def version(self, wheelset: str) -> tuple[int | None, ...]:
        """Return what changes whenever the newest trend or the current geometry does; None for none."""
        return *self.results.version(TREND, wheelset), *(self.geometries.version(wheelset) or (None, None))

    def of(self, wheelsets: Collection[str]) -> Mapping[str, TrendRecord]:
        """Return the newest trend of each of some wheelsets that has one, by serial."""
        newest_first = self.results.in_force(TREND, wheelsets)
        return {result.subject: _record(result) for result in reversed(newest_first)}

    def latest(self, wheelset: str, as_of_ns: int | None = None) -> TrendRecord | None:
        """Return the newest trend, as it was recorded at ``as_of_ns``: that of the baseline in force then."""
        found = self.results.latest(TREND, wheelset, as_of_ns)
        return None if found is None else _record(found)


def result_of_trend(record: TrendRecord) -> Result[WearTrend]:
    """Return a trend as a result."""
    return Result(
        subject=record.wheelset,
        part=baseline_part(record.baseline),
        made_from=record.input_digest,
        numerics=record.code_version,
        recorded_ns=record.recorded_ns,
        value=record.trend,
        status=record.trend.status,
        reason=record.trend.reason,
        head=record.trend.head,
        parameters=record.parameters,
    )


def _record(result: Result[WearTrend]) -> TrendRecord:
    assert result.value is not None
    return TrendRecord(
        wheelset=result.subject,
        baseline=int(result.part),
        trend=result.value,
        input_digest=result.made_from,
        code_version=result.numerics,
        recorded_ns=result.recorded_ns,
        parameters=result.parameters,
    )
