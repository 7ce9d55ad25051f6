"""Which windows have a mileage or a place that is not believed, and which recordings were rejected."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Row,
    Select,
    String,
    and_,
    exists,
    func,
    literal,
    select,
    union_all,
    update,
)

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import (
    DueStage,
    MileageReading,
    PassedOver,
    ReadingSpan,
    WindowKey,
    WindowMark,
    WindowState,
)
from fleet_db.due import BATCH, DUE, is_due, list_due
from fleet_db.receipts import ChunkState
from fleet_db.rows import by_wheelset, replace_all, table_of
from fleet_db.stores.window_rows import implausible_reason, keys_given
from fleet_db.stores.windows import WindowStore
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.windows import WindowRow

WINDOWS, CHUNKS = table_of(WindowRow), table_of(ChunkRow)
_READING = ("start_ns", "mileage_km", "odometer_excess_m", "off_line_m", "implausible", "implausible_code")
READING = [WINDOWS.c[name] for name in _READING]
DOUBTED = WINDOWS.c.implausible_code.is_not(None)  # word for word that of the index
SPANS = 100  # of readings, in a statement


@dataclass(frozen=True, slots=True)
class PlausibilityStore:
    """Which windows have a mileage or a place that is not believed."""

    connection: Connection
    windows: WindowStore

    def note_odometer(self, wheelset: str, start_ns: int, excess_m: float) -> None:
        """Store by how much the odometer of a window differs from its speed, beyond what it may, m."""
        self._note(wheelset, start_ns, WINDOWS.c.odometer_excess_m, excess_m)

    def note_place(self, wheelset: str, start_ns: int, off_line_m: float) -> None:
        """Store how far from its section's line the vehicle was in a window by GNSS, m; 0 within the limit."""
        self._note(wheelset, start_ns, WINDOWS.c.off_line_m, off_line_m)

    def _note(self, wheelset: str, start_ns: int, column: ColumnElement[float], value: float) -> None:
        this = and_(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns == start_ns)
        noted = update(WINDOWS).where(this, column != value).values({column: value})
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
        return by_wheelset(rows, _reading)

    def readings_around(self, spans: Sequence[ReadingSpan]) -> Mapping[ReadingSpan, Sequence[MileageReading]]:
        """Return mileages in spans (wheelset, first, last start), one before and one after each, oldest first."""
        found: dict[ReadingSpan, list[MileageReading]] = {span: [] for span in spans}
        for first in range(0, len(spans), SPANS):
            for row in self.connection.execute(_around(spans[first : first + SPANS])):
                found[row.wheelset, row.from_ns, row.to_ns].append(_reading(row))
        return found

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
        for row in self._standing(sorted(verdicts)):
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

    def _standing(self, keys: Sequence[WindowKey]) -> Iterator[Row[Any]]:
        names = ("wheelset", "start_ns", "implausible", "implausible_code", "samples_purged_ns")
        standing = select(*(WINDOWS.c[name] for name in names)).where(keys_given(WINDOWS))
        for first in range(0, len(keys), BATCH):
            yield from self.connection.execute(standing, {"keys": keys[first : first + BATCH]}).all()

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
        found: dict[str, dict[str, int]] = {}
        for vehicle, code, count in self.connection.execute(statement.group_by(*columns).order_by(*columns)):
            found.setdefault(vehicle, {})[code] = int(count)
        return found


def _reading(row: Any) -> MileageReading:  # noqa: ANN401 - a row of READING
    return MileageReading(row.start_ns, row.mileage_km, row.odometer_excess_m, row.off_line_m, implausible_reason(row))


def _around(spans: Sequence[ReadingSpan]) -> Select[Any]:
    """Return the statement for the readings of spans, with one before and one after each."""
    named = union_all(
        *(
            select(
                literal(wheelset, String).label("wheelset"),
                literal(from_ns, BigInteger).label("from_ns"),
                literal(to_ns, BigInteger).label("to_ns"),
            )
            for wheelset, from_ns, to_ns in spans
        )
    ).subquery("spans")
    beside = WINDOWS.alias("beside")
    own = beside.c.wheelset == named.c.wheelset
    before = select(func.max(beside.c.start_ns)).where(own, beside.c.start_ns < named.c.from_ns)
    after = select(func.min(beside.c.start_ns)).where(own, beside.c.start_ns > named.c.to_ns)
    within = (
        WINDOWS.c.wheelset == named.c.wheelset,
        WINDOWS.c.start_ns >= func.coalesce(before.correlate(named).scalar_subquery(), named.c.from_ns),
        WINDOWS.c.start_ns <= func.coalesce(after.correlate(named).scalar_subquery(), named.c.to_ns),
    )
    statement = select(*named.columns, *READING).where(*within)
    return statement.order_by(WINDOWS.c.wheelset, named.c.from_ns, WINDOWS.c.start_ns)
