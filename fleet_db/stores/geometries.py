"""Geometries and trends, as results of their stages, and the bins of each current geometry as plain rows for SQL."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import starmap
from typing import Any

from sqlalchemy import Connection, delete, exists, func, insert, select

from estimation.errors import DamagedError
from estimation.values.geometry import (
    COMBINATIONS,
    GEOMETRY,
    MOST_INTERVALS,
    BinValues,
    GeometryRecord,
    IntervalConicities,
    IntervalDigest,
    KnownConicity,
    WheelsetGeometry,
    key_of_part,
    part_of,
)
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Result, ResultKind
from estimation.values.trend import TREND, TrendRecord, WearTrend
from fleet_db.rows import grouped, nan_if_null, null_if_nan, table_of
from fleet_db.stores.results import RESULTS, Parts, ResultHead, ResultStore
from fleet_db.stores.window_rows import NOTED_OF, noted_columns, noted_in
from fleet_db.subjects import ReadOnce
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.windows import WheelsetBinRow, WindowBinTableRow

BINS = table_of(WheelsetBinRow)
UNITS = {name: "rad" if name.startswith("contact_angle") else "m" for name in COMBINATIONS}
TABLES, WHEELSETS = table_of(WindowBinTableRow), table_of(WheelsetRow)
CURRENT: Parts = ("current.", "current.9999")
INTERVALS: Parts = ("0000", "9999.9999999")
HAVING, HAVING_ANY = "having a current geometry", "having had a geometry"


@dataclass(frozen=True, slots=True)
class GeometryStore:
    """Geometry estimates, append-only; reads give the state recorded at ``as_of_ns``."""

    connection: Connection
    results: ResultStore
    once: ReadOnce = field(default_factory=ReadOnce)

    def current(self, wheelset: str, as_of_ns: int | None = None) -> GeometryRecord | None:
        """Return the current geometry of the newest baseline with windows, as it was recorded at ``as_of_ns``.

        Where no baseline has windows any more it is the empty one of the newest.
        """
        if as_of_ns is None:
            records = self.baselines(wheelset)
            filled = [record for record in records if record.geometry.windows]
            return next(reversed(filled or records), None)
        result = self._newest_of([wheelset], as_of_ns).get(wheelset)
        return None if result is None else _record(result)

    def read_with(self, kinds: Collection[ResultKind[Any]], subjects: Collection[str]) -> None:
        """Read with one statement what :meth:`current_of` is asked next, and what is in force of other kinds."""
        self.results.read_ahead([(GEOMETRY, subjects, CURRENT), *((kind, subjects, None) for kind in kinds)])

    def read_intervals(self, wanted: Mapping[str, tuple[int, int | None, int | None]]) -> None:
        """Read together what :meth:`intervals` is asked of one wheelset after the other.

        Args:
            wanted: By wheelset its baseline, and the numbers of the first and the last interval of it; None is all.
        """
        if wanted:
            self.results.read_ahead((GEOMETRY, [serial], _intervals(*span)) for serial, span in wanted.items())

    def current_of(self, wheelsets: Collection[str]) -> Mapping[str, GeometryRecord]:
        """Return what :meth:`current` does of each of some wheelsets that has one, by serial."""
        return {wheelset: _record(result) for wheelset, result in self._newest_of(wheelsets).items()}

    def _newest_of(
        self, wheelsets: Collection[str], as_of_ns: int | None = None
    ) -> dict[str, Result[WheelsetGeometry]]:
        current = self.results.in_force(GEOMETRY, wheelsets, as_of_ns, CURRENT)
        stored: dict[str, list[Result[WheelsetGeometry]]] = grouped(current, by="subject")
        return {wheelset: _newest(results) for wheelset, results in stored.items()}

    def version(self, wheelset: str) -> tuple[int, int] | None:
        """Return number and time of the current geometry put last: they change whenever :meth:`current` does."""
        number, recorded_ns = self.results.version(GEOMETRY, wheelset, CURRENT)
        return None if number is None or recorded_ns is None else (number, recorded_ns)

    def having(self, wheelsets: Collection[str]) -> frozenset[str]:
        """Return which of some wheelsets have a geometry."""
        return self.results.having(GEOMETRY, wheelsets, CURRENT)

    def baselines(self, wheelset: str) -> Sequence[GeometryRecord]:
        """Return the current geometry of each baseline that there has been, by its number."""
        if self.once.is_absent(HAVING, wheelset):
            return ()
        return self.once.of_wheelset("current geometries", wheelset, self._baselines) or ()

    def _baselines(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[GeometryRecord]]:
        return grouped(self.results.in_force(GEOMETRY, wheelsets, None, CURRENT), _record, by="subject")

    def read_ahead(self, wheelsets: Collection[str]) -> None:
        """Read together what :meth:`baselines` and :meth:`conicities` are asked for one by one; raises DamagedError."""
        self.once.of("current geometries", wheelsets, self._baselines)
        self.once.of("conicities", wheelsets, self._conicities)

    def interval_digests(self, wheelset: str) -> Mapping[tuple[int, int], IntervalDigest]:
        """Return by baseline and interval what the newest geometry was made from, and why it holds no number."""
        if self.once.is_absent(HAVING_ANY, wheelset):
            return {}

        def read(some: Collection[str]) -> Mapping[str, Sequence[tuple[tuple[int, int], IntervalDigest]]]:
            return grouped(self.results.heads(GEOMETRY, some, INTERVALS), _interval_digest, by="subject")

        return dict(self.once.of_wheelset("interval digests", wheelset, read) or ())

    def interval_numbers(self, baselines: Mapping[str, int]) -> Mapping[str, Mapping[int, int]]:
        """Return by wheelset and interval of one baseline of each the number of the newest geometry."""
        numbers: dict[str, dict[int, int]] = {serial: {} for serial in baselines}
        spans = {serial: _intervals(baseline) for serial, baseline in baselines.items()}
        for serial, part, number in self.results.numbers(GEOMETRY, spans):
            numbers[serial][key_of_part(part)[1] or 0] = number
        return numbers

    def intervals(
        self,
        wheelset: str,
        baseline: int | None = None,
        as_of_ns: int | None = None,
        *,
        first: int | None = None,
        last: int | None = None,
    ) -> Sequence[GeometryRecord]:
        """Return the newest geometry of each mileage interval, of one baseline or of all, in the order of mileage.

        Args:
            baseline: Its number; None is all.
            as_of_ns: Recorded until then; None is now.
            first, last: Numbers of the first and the last interval of the baseline; None is all.
        """
        parts = INTERVALS if baseline is None else _intervals(baseline, first, last)
        return [_record(result) for result in self.results.in_force(GEOMETRY, [wheelset], as_of_ns, parts)]

    def conicities(self, wheelset: str, baseline: int) -> Sequence[IntervalConicities]:
        """Return the conicities of the newest geometry of each mileage interval of a baseline, in order of mileage."""
        ahead = self.once.known("conicities", wheelset)
        if ahead is None:
            return self.conicities_of({wheelset: baseline})[wheelset]
        return [conicities for number, conicities in ahead if number == baseline]

    def conicities_of(self, baselines: Mapping[str, int]) -> Mapping[str, Sequence[IntervalConicities]]:
        """Return the conicities of the intervals of some wheelsets, of one baseline of each by its number."""
        numbers = baselines.values()
        spanned = (_intervals(min(numbers))[0], _intervals(max(numbers))[1]) if numbers else INTERVALS
        conicities: dict[str, list[IntervalConicities]] = {wheelset: [] for wheelset in baselines}
        for result in self.results.heads(GEOMETRY, list(baselines), spanned):
            if key_of_part(result.part)[0] == baselines[result.subject]:
                conicities[result.subject].append(_conicities(result))
        return conicities

    def _conicities(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[tuple[int, IntervalConicities]]]:
        heads = self.results.heads(GEOMETRY, wheelsets, INTERVALS)
        return grouped(heads, lambda result: (key_of_part(result.part)[0], _conicities(result)), by="subject")

    def estimable(self, wheelsets: Collection[str]) -> frozenset[str]:
        """Return those of some wheelsets that have a bin table or a geometry."""
        tabled = exists().where(TABLES.c.wheelset == WHEELSETS.c.serial)
        current = (RESULTS.c.stage == GEOMETRY.stage, RESULTS.c.part.between(*CURRENT))
        having = exists().where(*current, RESULTS.c.subject == WHEELSETS.c.serial, RESULTS.c.superseded_ns.is_(None))
        some = exists().where(RESULTS.c.stage == GEOMETRY.stage, RESULTS.c.subject == WHEELSETS.c.serial)
        columns = (WHEELSETS.c.serial, tabled.label("tabled"), having.label("having"), some.label("some"))
        rows = self.connection.execute(
            select(*columns, *noted_columns()).where(WHEELSETS.c.serial.in_(wheelsets))
        ).all()
        self.once.of(HAVING, wheelsets, lambda _: {row.serial: True for row in rows if row.having})
        self.once.of(HAVING_ANY, wheelsets, lambda _: {row.serial: True for row in rows if row.some})
        self.once.of(NOTED_OF, wheelsets, lambda _: {row.serial: noted_in(row) for row in rows})
        return frozenset(row.serial for row in rows if row.tabled or row.having)

    def bins_are_current(self, wheelset: str) -> bool:
        """Whether the plain rows of bins are those of the current geometry."""
        current = self._newest_of([wheelset]).get(wheelset)
        shown = select(func.max(BINS.c.geometry_id)).where(BINS.c.wheelset == wheelset)
        return current is None or current.number == self.connection.scalar(shown)

    def show_bins(self, wheelsets: Collection[str]) -> None:
        """Let the plain rows of bins of some wheelsets be those of their current geometry."""
        if not wheelsets:
            return
        newest = self._newest_of(wheelsets).values()
        rows = [row for result in newest if result.value is not None for row in _bin_rows(result, result.value)]
        if rows:
            self.connection.execute(delete(BINS).where(BINS.c.wheelset.in_({row["wheelset"] for row in rows})))
            self.connection.execute(insert(BINS), rows)


def _interval_digest(result: ResultHead) -> tuple[tuple[int, int], IntervalDigest]:
    baseline, interval = key_of_part(result.part)
    return (baseline, interval or 0), IntervalDigest(result.made_from, _head(result)["windows"], result.reason)


def _newest(results: Sequence[Result[WheelsetGeometry]]) -> Result[WheelsetGeometry]:
    """Return the current geometry of the newest baseline with windows, or else of the newest one."""
    return ([result for result in results if _head(result)["windows"]] or results)[-1]


def _intervals(baseline: int, first: int | None = None, last: int | None = None) -> Parts:
    begin, end = -MOST_INTERVALS if first is None else first, MOST_INTERVALS if last is None else last
    return part_of(baseline, begin), part_of(baseline, end)


def _head(result: Result[Any] | ResultHead) -> dict[str, Any]:
    if not isinstance(result.head, dict):
        raise DamagedError(f"head of geometry {result.number} of {result.subject}: damaged")
    return result.head


def _record(result: Result[WheelsetGeometry]) -> GeometryRecord:
    head, (baseline, interval) = _head(result), key_of_part(result.part)
    assert result.value is not None
    return GeometryRecord(
        wheelset=result.subject,
        baseline=baseline,
        interval=interval,
        mileage_km=nan_if_null(head["mileage_km"]),
        from_ns=head["from_ns"],
        to_ns=head["to_ns"],
        geometry=result.value,
        input_digest=result.made_from,
        track_versions={section: tuple(versions) for section, versions in head["track_versions"].items()},
        parameters=result.parameters,
        code_version=result.numerics,
        recorded_ns=result.recorded_ns,
    )


def _conicities(result: ResultHead) -> IntervalConicities:
    """Return what the head of a geometry says of its conicities: a trend reads hundreds of them, and no bins."""
    head, (baseline, interval) = _head(result), key_of_part(result.part)
    try:
        why = head["no_conicity"]
        return IntervalConicities(
            baseline=baseline,
            interval=interval,
            mileage_km=nan_if_null(head["mileage_km"]),
            from_ns=head["from_ns"],
            to_ns=head["to_ns"],
            windows=head["windows"],
            input_digest=result.made_from,
            code_version=result.numerics,
            known=tuple(starmap(KnownConicity, head["conicities"])),
            reason=None if why is None else Reason(ReasonCode(why[0]), why[1]),
        )
    except (ValueError, TypeError, LookupError) as error:
        place = f"conicities of baseline {baseline}, interval {interval} of {result.subject}"
        raise DamagedError(f"{place}: damaged ({error})") from error


def _bin_rows(result: Result[WheelsetGeometry], geometry: WheelsetGeometry) -> list[dict[str, Any]]:
    return [
        {
            "wheelset": result.subject,
            "bin": index,
            "geometry_id": result.number,
            "lateral_displacement_low_m": float(geometry.bin_edges[index]),
            "lateral_displacement_high_m": float(geometry.bin_edges[index + 1]),
            "samples": null_if_nan(float(geometry.samples[index])),
            **_bin_columns(geometry, index),
        }
        for index in range(len(geometry.samples))
    ]


def _bin_columns(geometry: WheelsetGeometry, index: int) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for name, unit in UNITS.items():
        values: BinValues = getattr(geometry, name)
        columns[f"{name}_{unit}"] = null_if_nan(float(values.value[index]))
        columns[f"{name}_std_{unit}"] = null_if_nan(float(values.std[index]))
        columns[f"{name}_status"] = str(values.status[index])
    return columns


@dataclass(frozen=True, slots=True)
class TrendStore:
    """Trends, append-only."""

    results: ResultStore
    geometries: GeometryStore

    def version(self, wheelset: str) -> tuple[int | None, ...]:
        """Return what changes whenever the newest trend or the current geometry does; None for none."""
        return *self.results.version(TREND, wheelset), *(self.geometries.version(wheelset) or (None, None))

    def of(self, wheelsets: Collection[str]) -> Mapping[str, TrendRecord]:
        """Return the newest trend of each of some wheelsets that has one, by serial."""
        newest_first = self.results.in_force(TREND, wheelsets)
        return {result.subject: _trend_record(result) for result in reversed(newest_first)}

    def latest(self, wheelset: str, as_of_ns: int | None = None) -> TrendRecord | None:
        """Return the newest trend, as it was recorded at ``as_of_ns``: that of the baseline in force then."""
        result = self.results.latest(TREND, wheelset, as_of_ns)
        return None if result is None else _trend_record(result)


def _trend_record(result: Result[WearTrend]) -> TrendRecord:
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
