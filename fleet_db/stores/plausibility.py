"""Which windows have a mileage or a place that is not believed, and which recordings were rejected."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, exists, func, select, update

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import MileageReading, PassedOver, WindowMark, WindowState
from fleet_db.receipts import ChunkState
from fleet_db.rows import replace_all, table_of
from fleet_db.stores.windows import WindowStore, implausible_reason
from fleet_db.tables import ChunkRow, WheelsetRow, WindowRow

WINDOWS, CHUNKS, WHEELSETS = table_of(WindowRow), table_of(ChunkRow), table_of(WheelsetRow)
READING = (WINDOWS.c.start_ns, WINDOWS.c.mileage_km, WINDOWS.c.odometer_excess_m, WINDOWS.c.off_line_m)


@dataclass(frozen=True, slots=True)
class PlausibilityStore:
    """Implements ``estimation.storage.Plausibility``."""

    connection: Connection
    windows: WindowStore

    def note_odometer(self, wheelset: str, start_ns: int, excess_m: float) -> None:
        """Store by how much the odometer of a window differs from its speed, beyond what it may, m."""
        self.connection.execute(
            update(WINDOWS)
            .where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns == start_ns)
            .where(WINDOWS.c.odometer_excess_m != excess_m)
            .values(odometer_excess_m=excess_m, judged=False)
        )

    def note_place(self, wheelset: str, start_ns: int, off_line_m: float) -> None:
        """Store how far from its section's line the vehicle was in a window by GNSS, m; 0 within the limit."""
        self.connection.execute(
            update(WINDOWS)
            .where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns == start_ns)
            .where(WINDOWS.c.off_line_m != off_line_m)
            .values(off_line_m=off_line_m, judged=False)
        )

    def unjudged(self) -> Sequence[str]:
        """Return the wheelsets with windows that were stored, or have another mileage, since they were judged."""
        statement = select(WINDOWS.c.wheelset).where(~WINDOWS.c.judged).distinct().order_by(WINDOWS.c.wheelset)
        return list(self.connection.scalars(statement))

    def readings(self, wheelset: str) -> Sequence[MileageReading]:
        """Return the mileages of all windows of a wheelset, oldest first."""
        statement = select(*READING).where(WINDOWS.c.wheelset == wheelset)
        rows = self.connection.execute(statement.order_by(WINDOWS.c.start_ns))
        return [MileageReading(*row) for row in rows]

    def new_readings(self, wheelset: str) -> Sequence[MileageReading]:
        """Return the mileages of the windows of a wheelset that were not judged as they are, oldest first."""
        statement = select(*READING).where(WINDOWS.c.wheelset == wheelset, ~WINDOWS.c.judged)
        return [MileageReading(*row) for row in self.connection.execute(statement.order_by(WINDOWS.c.start_ns))]

    def readings_around(self, wheelset: str, from_ns: int, to_ns: int) -> Sequence[MileageReading]:
        """Return the mileages of the windows from one start to another, with one before and one after, oldest first."""
        own = select(*READING).where(WINDOWS.c.wheelset == wheelset)
        before = own.where(WINDOWS.c.start_ns < from_ns).order_by(WINDOWS.c.start_ns.desc()).limit(1)
        rest = own.where(WINDOWS.c.start_ns >= from_ns).order_by(WINDOWS.c.start_ns)
        within = self.connection.execute(rest.where(WINDOWS.c.start_ns <= to_ns)).all()
        after = self.connection.execute(rest.where(WINDOWS.c.start_ns > to_ns).limit(1)).all()
        return [MileageReading(*row) for row in (*self.connection.execute(before), *within, *after)]

    def mileages_doubted(self, wheelset: str) -> bool:
        """Return whether the mileage of a window of a wheelset is not believed."""
        doubted = WINDOWS.c.implausible_code == ReasonCode.ODOMETER_IMPLAUSIBLE.value
        found = select(WINDOWS.c.start_ns).where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.implausible.is_not(None))
        return self.connection.execute(found.where(doubted).limit(1)).first() is not None

    def judge(self, wheelset: str, implausible: Mapping[int, Reason], *, new_only: bool = False) -> int:
        """Store which windows of a wheelset have a mileage that is not believed, by start; return how many changed.

        They are refused; those that are believed again wait to be estimated. What has no samples any more stays.

        Args:
            implausible: Why a window is not believed, by its start.
            new_only: Whether the windows judged before keep their verdict.
        """
        names = ("start_ns", "implausible", "implausible_code", "judged", "samples_purged_ns")
        standing = select(*(WINDOWS.c[name] for name in names))
        standing = standing.where(WINDOWS.c.wheelset == wheelset)
        rows, marks = [], []
        for row in self.connection.execute(standing.where(~WINDOWS.c.judged) if new_only else standing).all():
            reason, before = implausible.get(row.start_ns), implausible_reason(row)
            if row.judged and reason == before:
                continue
            if row.samples_purged_ns is not None and reason != before:
                self.windows.pass_over(wheelset, row.start_ns, PassedOver.SUPERSEDED)
                reason = before
            text, code = (None, None) if reason is None else (reason.text, reason.code.value)
            key = {"wheelset": wheelset, "start_ns": row.start_ns}
            rows.append({**key, "implausible": text, "implausible_code": code, "judged": True})
            if reason != before:
                state = WindowState.PENDING if reason is None else WindowState.REFUSED
                marks.append(WindowMark(wheelset, row.start_ns, state, reason))
        replace_all(self.connection, WINDOWS, rows)
        if marks:
            self.windows.mark_all(marks)
            self.windows.subjects.windows(wheelset)
        return len(marks)

    def left_out(self, wheelset: str, from_ns: int) -> Mapping[ReasonCode, int]:
        """Return how many windows of a wheelset that start at or after a time are not believed, by code."""
        some = self.windows.once.of_wheelset("left out", wheelset, self._some_left_out)
        if not some:
            return {}
        statement = (
            select(WINDOWS.c.implausible_code, func.count())
            .where(WINDOWS.c.wheelset == wheelset, WINDOWS.c.start_ns >= from_ns)
            .where(WINDOWS.c.implausible_code.is_not(None))
            .group_by(WINDOWS.c.implausible_code)
            .order_by(WINDOWS.c.implausible_code)
        )
        return {ReasonCode(code): int(count) for code, count in self.connection.execute(statement)}

    def _some_left_out(self, wheelsets: Collection[str]) -> Mapping[str, bool]:
        left_out = exists().where(WINDOWS.c.wheelset == WHEELSETS.c.serial, WINDOWS.c.implausible_code.is_not(None))
        return dict.fromkeys(
            self.connection.scalars(select(WHEELSETS.c.serial).where(WHEELSETS.c.serial.in_(wheelsets), left_out)), True
        )

    def rejected(self, vehicles: Collection[str]) -> Mapping[str, Mapping[str, int]]:
        """Return how many recordings of some vehicles are rejected, by vehicle and by reason code."""
        columns = (CHUNKS.c.vehicle, CHUNKS.c.reason_code)
        chosen = (CHUNKS.c.state == ChunkState.REJECTED.value, CHUNKS.c.vehicle.in_(vehicles))
        statement = select(*columns, func.count()).where(*chosen)
        found: dict[str, dict[str, int]] = {}
        for vehicle, code, count in self.connection.execute(statement.group_by(*columns).order_by(*columns)):
            found.setdefault(vehicle, {})[code] = int(count)
        return found
