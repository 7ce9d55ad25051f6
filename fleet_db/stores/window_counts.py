"""Windows counted by state and reason, what waits, and which windows have a mileage or place that is not believed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import starmap
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Subquery,
    and_,
    bindparam,
    case,
    exists,
    false,
    func,
    or_,
    select,
    true,
    union_all,
    update,
)

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import DAY_NS
from estimation.values.windows import (
    DueStage,
    MileageReading,
    PassedOver,
    ReadingSpan,
    WindowKey,
    WindowMark,
    WindowState,
)
from fleet_db.due import DUE, IS_PENDING, PLACED, is_due, list_due
from fleet_db.records import ChunkState
from fleet_db.rows import batches, equal, given, grouped, keys_given, replace_all, stored_reason, table_of, value_of_row
from fleet_db.stores.window_rows import implausible_reason, spans_given
from fleet_db.stores.windows import WindowStore
from fleet_db.tables.operation import WorklistEntryRow
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.windows import WindowRow

WINDOWS, CHUNKS = table_of(WindowRow), table_of(ChunkRow)


@dataclass(frozen=True, slots=True)
class WindowCount:
    """Windows that begin in one stretch of time, with one state and reason."""

    from_ns: int  # begin of the stretch
    state: WindowState
    code: ReasonCode | None  # why they are refused, or wait
    windows: int


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """Windows of one wheelset over all stretches of time that have any, the oldest first."""

    stretch_ns: int
    counts: tuple[WindowCount, ...]


def window_counts(connection: Connection, wheelset: str, most: int) -> WindowCounts:
    """Return windows by state and reason in at most ``most`` stretches of whole days."""
    of_wheelset = WINDOWS.c.wheelset == wheelset
    first, last = connection.execute(
        select(func.min(WINDOWS.c.start_ns), func.max(WINDOWS.c.start_ns)).where(of_wheelset)
    ).one()
    if first is None:
        return WindowCounts(DAY_NS, ())
    begin = first // DAY_NS * DAY_NS
    stretch_ns = DAY_NS * (1 + (last - begin) // (most * DAY_NS))
    place = ((WINDOWS.c.start_ns - begin) // stretch_ns).label("place")
    placed = select(place, WINDOWS.c.state, WINDOWS.c.reason_code.label("code")).where(of_wheelset).subquery()
    key = (placed.c.place, placed.c.state, placed.c.code)
    rows = connection.execute(select(*key, func.count().label("windows")).group_by(*key))
    counts = [value_of_row(WindowCount, row, from_ns=begin + int(row.place) * stretch_ns) for row in rows]
    counts.sort(key=lambda count: (count.from_ns, count.state.value, "" if count.code is None else count.code.value))
    return WindowCounts(stretch_ns, tuple(counts))


COUNTED = 1000
"""Windows that are counted, the newest: 17 hours of running."""

EVER_NS = -(2**63)
SERIALS_AT_ONCE = 50


@dataclass(frozen=True, slots=True)
class CountedWindows:
    """Windows of one wheelset that have the same state, reason code, section and vehicle."""

    state: WindowState
    reason: Reason | None  # as it is stored of the newest; None where none is
    section: str | None
    vehicle: str
    placed: bool  # whether their place on the section is found; False of those that do not wait
    windows: int
    first_ns: int  # begin of the oldest
    newest_start_ns: int
    newest_end_ns: int


def newest_by_reason(
    connection: Connection, wheelset: str, since_ns: int | None = None, most: int = COUNTED
) -> Sequence[CountedWindows]:
    """Return windows by state and reason code of the ``most`` newest since a time, the most frequent first."""
    given = {"serial": wheelset, "since_ns": EVER_NS if since_ns is None else since_ns, "most": most}
    rows = connection.execute(_grouped(), given).all()
    starts = [row.newest_start_ns for row in rows if row.reason_code is not None]
    with_reasons = connection.execute(_reasons(), {"serial": wheelset, "starts": starts}) if starts else ()
    stored = {row.start_ns: stored_reason(row) for row in with_reasons}
    counted = [_counted(row, reason=stored.get(row.newest_start_ns)) for row in rows]
    return sorted(counted, key=lambda group: (-group.windows, -group.newest_end_ns, group.state.value))


def pending_by_place(
    connection: Connection, *, vehicles: Sequence[str] | None = None, wheelset: str | None = None
) -> Sequence[CountedWindows]:
    """Return the windows that wait, however many, by vehicle, section, and whether their place is found."""
    chosen = [IS_PENDING, *given(vehicles, WINDOWS.c.vehicle.in_), *equal(WINDOWS, wheelset=wheelset)]
    placed = case((PLACED, true()), else_=false()).label("placed")
    names = ("vehicle", "track_section", "start_ns")
    end = (WINDOWS.c.start_ns + WINDOWS.c.length_ns).label("end_ns")
    waiting = select(*(WINDOWS.c[name] for name in names), end, placed).where(*chosen).subquery()
    key = (waiting.c.vehicle, waiting.c.track_section, waiting.c.placed)
    rows = connection.execute(select(*key, *_sums(waiting)).group_by(*key))
    return [_counted(row, state=WindowState.PENDING, reason=None) for row in rows]


def _counted(row: Row[Any], **given: object) -> CountedWindows:
    return value_of_row(CountedWindows, row, section=row.track_section, placed=bool(row.placed), **given)


def refused_by_code(connection: Connection, since_ns: Mapping[str, int | None]) -> dict[str, dict[ReasonCode, int]]:
    """Return how many of the newest windows since a time (None: ever) are refused, by serial and code, most first."""
    refusals: dict[str, dict[ReasonCode, int]] = {serial: {} for serial in since_ns}
    for some in batches(list(since_ns.items()), SERIALS_AT_ONCE):
        newest = union_all(*starmap(_newest_refused, some)).subquery()
        counted = select(newest.c.wheelset, newest.c.reason_code, func.count().label("windows"))
        refused = counted.where(newest.c.state == WindowState.REFUSED.value, newest.c.reason_code.is_not(None))
        for row in connection.execute(refused.group_by(newest.c.wheelset, newest.c.reason_code)):
            refusals[row.wheelset][ReasonCode(row.reason_code)] = row.windows
    return {
        serial: dict(sorted(counts.items(), key=lambda item: (-item[1], item[0].value)))
        for serial, counts in refusals.items()
    }


def _newest_refused(serial: str, since_ns: int | None) -> Select[Any]:
    of_key = (WINDOWS.c.wheelset == serial, WINDOWS.c.start_ns >= (EVER_NS if since_ns is None else since_ns))
    newest = select(WINDOWS.c.wheelset, WINDOWS.c.state, WINDOWS.c.reason_code).where(*of_key)
    limited = newest.order_by(WINDOWS.c.start_ns.desc()).limit(COUNTED).subquery()
    return select(limited)


@cache
def _grouped() -> Select[Any]:
    of_key = (WINDOWS.c.wheelset == bindparam("serial"), WINDOWS.c.start_ns >= bindparam("since_ns"))
    waits = WINDOWS.c.state == WindowState.PENDING.value
    names = ("state", "reason_code", "track_section", "vehicle", "start_ns")
    end = (WINDOWS.c.start_ns + WINDOWS.c.length_ns).label("end_ns")
    placed = case((waits, PLACED), else_=false()).label("placed")
    chosen = select(*(WINDOWS.c[name] for name in names), end, placed).where(*of_key)
    newest = chosen.order_by(WINDOWS.c.start_ns.desc()).limit(bindparam("most")).subquery()
    key = (newest.c.state, newest.c.reason_code, newest.c.track_section, newest.c.vehicle, newest.c.placed)
    return select(*key, *_sums(newest)).group_by(*key)


def _sums(windows: Subquery) -> tuple[ColumnElement[Any], ...]:
    return (
        func.count().label("windows"),
        func.min(windows.c.start_ns).label("first_ns"),
        func.max(windows.c.start_ns).label("newest_start_ns"),
        func.max(windows.c.end_ns).label("newest_end_ns"),
    )


@cache
def _reasons() -> Select[Any]:
    starts = WINDOWS.c.start_ns.in_(bindparam("starts", expanding=True))
    columns = (WINDOWS.c.start_ns, WINDOWS.c.reason, WINDOWS.c.reason_code)
    return select(*columns).where(WINDOWS.c.wheelset == bindparam("serial"), starts)


ENTRIES = table_of(WorklistEntryRow)


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits."""

    recordings: Mapping[ChunkState, int]  # how many there are, by state
    oldest_recording_ns: int | None  # since when, by our clock, it waits to be decoded; None where none does
    oldest_window_ns: int | None  # the same of a window that waits to be estimated
    last_data: tuple[tuple[str, int | None], ...]  # fleet and newest data of each vehicle with a mounted wheelset


def backlog_of(connection: Connection) -> Backlog:
    """Return what waits now."""
    states = connection.execute(select(CHUNKS.c.state, func.count()).group_by(CHUNKS.c.state))
    stored = select(func.min(CHUNKS.c.received_ns)).where(CHUNKS.c.state == ChunkState.STORED.value)
    pending = select(func.min(WINDOWS.c.recorded_ns)).where(WINDOWS.c.state == WindowState.PENDING.value)
    newest = (
        select(ENTRIES.c.fleet, func.max(ENTRIES.c.last_data_ns))
        .where(ENTRIES.c.vehicle.is_not(None))
        .group_by(ENTRIES.c.fleet, ENTRIES.c.vehicle)
    )
    return Backlog(
        recordings={ChunkState(state): int(count) for state, count in states},
        oldest_recording_ns=connection.scalar(stored),
        oldest_window_ns=connection.scalar(pending),
        last_data=tuple((fleet, at_ns) for fleet, at_ns in connection.execute(newest)),
    )


_READING = ("start_ns", "mileage_km", "odometer_excess_m", "off_line_m", "implausible", "implausible_code")
READING = [WINDOWS.c[name] for name in _READING]
DOUBTED = WINDOWS.c.implausible_code.is_not(None)  # word for word that of the index
SPANS = 100  # of readings, in a statement


@dataclass(frozen=True, slots=True)
class PlausibilityStore:
    """Which windows have a mileage or a place that is not believed."""

    connection: Connection
    windows: WindowStore

    def note(self, wheelset: str, start_ns: int, odometer_excess_m: float, off_line_m: float) -> None:
        """Store how far the odometer of a window differs from its speed, and GNSS from its section's line, m.

        Each beyond what it may; 0 within the limit.
        """
        this = and_(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns == start_ns)
        values = {"odometer_excess_m": odometer_excess_m, "off_line_m": off_line_m}
        other = or_(*(WINDOWS.c[name] != value for name, value in values.items()))
        noted = update(WINDOWS).where(this, other).values(values)
        if self.connection.execute(noted.execution_options(preserve_rowcount=True)).rowcount:
            list_due(self.connection, DueStage.MILEAGES, this)

    def readings(self, wheelset: str) -> Sequence[MileageReading]:
        """Return the mileages of all windows of a wheelset, oldest first."""
        statement = select(*READING).where(WINDOWS.c.wheelset == wheelset)
        rows = self.connection.execute(statement.order_by(WINDOWS.c.start_ns))
        return [_reading(row) for row in rows]

    def new_readings(self, wheelsets: Collection[str]) -> Mapping[str, Sequence[MileageReading]]:
        """Return by serial the mileages of the windows that were not judged as they are, oldest first."""
        statement = select(WINDOWS.c.wheelset, *READING).where(WINDOWS.c.wheelset.in_(wheelsets))
        statement = statement.where(is_due(DueStage.MILEAGES, WINDOWS))
        rows = self.connection.execute(statement.order_by(WINDOWS.c.wheelset, WINDOWS.c.start_ns))
        return grouped(rows, _reading)

    def readings_around(self, spans: Sequence[ReadingSpan]) -> Mapping[ReadingSpan, Sequence[MileageReading]]:
        """Return mileages in spans (wheelset, first, last start), one before and one after each, oldest first."""
        readings: dict[ReadingSpan, list[MileageReading]] = {span: [] for span in spans}
        for some in batches(spans, SPANS):
            for row in self.connection.execute(_around(some)):
                readings[row.of_wheelset, row.from_ns, row.to_ns].append(_reading(row))
        return readings

    def due(self, wheelsets: Collection[str]) -> tuple[Mapping[WindowKey, int], frozenset[str]]:
        """Return the windows of wheelsets that are to be judged, oldest first, and which of these are doubted.

        Returns:
            Versions in which windows are due, by key, and of which wheelsets with some the mileage of a window is not
            believed.
        """
        of_odometer = WINDOWS.c.implausible_code == ReasonCode.ODOMETER_IMPLAUSIBLE.value
        doubted = exists().where(WINDOWS.c.wheelset == DUE.c.wheelset, of_odometer, DOUBTED)
        statement = select(DUE.c.wheelset, DUE.c.start_ns, DUE.c.version, doubted.label("doubted"))
        statement = statement.where(DUE.c.stage == DueStage.MILEAGES.value, DUE.c.wheelset.in_(wheelsets))
        rows = self.connection.execute(statement.order_by(DUE.c.wheelset, DUE.c.start_ns)).all()
        seen = {(row.wheelset, row.start_ns): row.version for row in rows}
        return seen, frozenset(row.wheelset for row in rows if row.doubted)

    def judge(self, verdicts: Mapping[WindowKey, Reason | None]) -> int:
        """Store which windows have a mileage or place that is not believed; return how many changed.

        They are refused; those that are believed again wait to be estimated. What has no samples any more stays.
        """
        rows, marks = [], []
        names = ("wheelset", "start_ns", "implausible", "implausible_code", "samples_purged_ns")
        standing = select(*(WINDOWS.c[name] for name in names)).where(keys_given(WINDOWS))
        keys = batches(sorted(verdicts))
        for row in (row for some in keys for row in self.connection.execute(standing, {"keys": some}).all()):
            key = (row.wheelset, row.start_ns)
            reason = verdicts[key]
            if reason == implausible_reason(row):
                continue
            if row.samples_purged_ns is not None:
                self.windows.pass_over(*key, PassedOver.SUPERSEDED)
                continue
            text, code = (None, None) if reason is None else (reason.text, reason.code.value)
            rows.append({"wheelset": key[0], "start_ns": key[1], "implausible": text, "implausible_code": code})
            state = WindowState.PENDING if reason is None else WindowState.REFUSED
            marks.append(WindowMark(*key, state, reason))
        replace_all(self.connection, WINDOWS, rows)
        self.windows.mark_all(marks)
        for wheelset in {mark.wheelset for mark in marks}:
            self.windows.subjects.windows(wheelset)
        return len(marks)

    def left_out(self, wheelset: str, from_ns: int) -> Mapping[ReasonCode, int]:
        """Return how many windows of a wheelset that start at or after a time are not believed, by code."""
        if "implausible_code" not in self.windows.noted(wheelset):
            return {}
        statement = (
            select(WINDOWS.c.implausible_code, func.count())
            .where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns >= from_ns)
            .where(WINDOWS.c.implausible_code.is_not(None))
            .group_by(WINDOWS.c.implausible_code)
            .order_by(WINDOWS.c.implausible_code)
        )
        return {ReasonCode(code): int(count) for code, count in self.connection.execute(statement)}

    def rejected(self, vehicles: Collection[str]) -> Mapping[str, Mapping[str, int]]:
        """Return how many recordings of some vehicles are rejected, by vehicle and by reason code."""
        columns = (CHUNKS.c.vehicle, CHUNKS.c.reason_code)
        chosen = (CHUNKS.c.state == ChunkState.REJECTED.value, CHUNKS.c.vehicle.in_(vehicles))
        statement = select(*columns, func.count()).where(*chosen)
        counts: dict[str, dict[str, int]] = {}
        for vehicle, code, count in self.connection.execute(statement.group_by(*columns).order_by(*columns)):
            counts.setdefault(vehicle, {})[code] = int(count)
        return counts


def _reading(row: Any) -> MileageReading:  # noqa: ANN401 - a row of READING
    return MileageReading(row.start_ns, row.mileage_km, row.odometer_excess_m, row.off_line_m, implausible_reason(row))


def _around(spans: Sequence[ReadingSpan]) -> Select[Any]:
    """Return the statement for the readings of spans, with one before and one after each."""
    named = spans_given(spans)
    beside = WINDOWS.alias("beside")
    same = beside.c.wheelset == named.c.of_wheelset
    before = select(func.max(beside.c.start_ns)).where(same, beside.c.start_ns < named.c.from_ns)
    after = select(func.min(beside.c.start_ns)).where(same, beside.c.start_ns > named.c.to_ns)
    within = (
        WINDOWS.c.wheelset == named.c.of_wheelset,
        WINDOWS.c.start_ns >= func.coalesce(before.correlate(named).scalar_subquery(), named.c.from_ns),
        WINDOWS.c.start_ns <= func.coalesce(after.correlate(named).scalar_subquery(), named.c.to_ns),
    )
    statement = select(*named.columns, *READING).where(*within)
    return statement.order_by(WINDOWS.c.wheelset, named.c.from_ns, WINDOWS.c.start_ns)
