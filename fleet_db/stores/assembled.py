"""Windows as a set that is made from recordings and registry: which there are, which go, and what rests on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, and_, delete, exists, func, select

from estimation.errors import DamagedError
from estimation.values.reasons import ReasonCode
from estimation.values.windows import WindowRecord
from fleet_db.changes import Changes
from fleet_db.models import ChunkRow, TrackVersionRow, WindowBinTableRow, WindowPositionRow, WindowRow
from fleet_db.receipts import ChunkState
from fleet_db.rows import table_of
from fleet_db.stores.estimated_again import Again
from fleet_db.stores.windows import to_window_record
from fleet_db.telemetry import WindowFiles

WINDOWS, TABLES, POSITIONS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WindowPositionRow)
CHUNKS, VERSIONS = table_of(ChunkRow), table_of(TrackVersionRow)


@dataclass(frozen=True, slots=True)
class AssembledWindowStore:
    """The stored windows of a vehicle over a span of its clock, in one transaction."""

    connection: Connection
    changes: Changes
    files: WindowFiles

    def of_vehicle(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[WindowRecord]:
        """Return the windows of a vehicle that start in ``[from_ns, to_ns)``, by start and wheelset."""
        statement = (
            select(WINDOWS)
            .where(WINDOWS.c.vehicle == vehicle, WINDOWS.c.start_ns >= from_ns, WINDOWS.c.start_ns < to_ns)
            .order_by(WINDOWS.c.start_ns, WINDOWS.c.wheelset)
        )
        return [to_window_record(row) for row in self.connection.execute(statement)]

    def first_start(self, vehicle: str, from_ns: int, to_ns: int) -> int | None:
        """Return the start of the first window of a vehicle in ``[from_ns, to_ns)``; None where there is none."""
        within = (WINDOWS.c.vehicle == vehicle, WINDOWS.c.start_ns >= from_ns, WINDOWS.c.start_ns < to_ns)
        found: int | None = self.connection.scalar(select(func.min(WINDOWS.c.start_ns)).where(*within))
        return found

    def extents(self, vehicle: str, from_ns: int, to_ns: int, limit: int) -> Sequence[tuple[int, int, int]]:
        """Return ``(first, last, frames)`` of at most ``limit`` decoded recordings in a span, by their first frame."""
        statement = (
            select(CHUNKS.c.first_ns, CHUNKS.c.last_ns, CHUNKS.c.frames)
            .where(CHUNKS.c.vehicle == vehicle, CHUNKS.c.first_ns < to_ns, CHUNKS.c.last_ns >= from_ns)
            .where(CHUNKS.c.state == ChunkState.DECODED.value)
            .order_by(CHUNKS.c.first_ns, CHUNKS.c.digest)
            .limit(limit)
        )
        return [(row.first_ns, row.last_ns, row.frames) for row in self.connection.execute(statement)]

    def withdraw(self, records: Sequence[WindowRecord], recorded_ns: int) -> Sequence[str]:
        """Start the sections again whose alignment may rest on windows that were not what they seemed; return those.

        Called before the windows are removed or replaced.

        Parameters
        ----------
        records
            The windows as they are stored.
        recorded_ns
            Our time, ns UTC.
        """
        sections: set[str] = set()
        for record in records:
            if record.track_section is not None and record.track_section not in sections and self._rests_on(record):
                sections.add(record.track_section)
        Again(self.connection, self.changes, recorded_ns).sections(sorted(sections))
        return sorted(sections)

    def remove(self, records: Sequence[WindowRecord]) -> None:
        """Remove windows with their bin tables and positions; their files are no concern of a transaction."""
        for record in records:
            for table in (TABLES, POSITIONS, WINDOWS):
                same = (table.c.wheelset == record.wheelset, table.c.start_ns == record.start_ns)
                self.connection.execute(delete(table).where(*same))
            self.changes.note(record.wheelset)

    def intact(self, record: WindowRecord, *, verify: bool) -> bool:
        """Return whether the file of a window is there; one that is damaged is removed, so that it is written again.

        Parameters
        ----------
        record
            The window.
        verify
            Whether the file is read and checked; else only its size is.
        """
        key = and_(WINDOWS.c.wheelset == record.wheelset, WINDOWS.c.start_ns == record.start_ns)
        size = self.connection.scalar(select(WINDOWS.c.sample_bytes).where(key)) or 0
        if not self.files.has(record.content_digest, size):
            return False
        if verify:
            try:
                self.files.load(record.content_digest)
            except DamagedError:
                self.files.path(record.content_digest).unlink(missing_ok=True)
                return False
        return True

    def _rests_on(self, record: WindowRecord) -> bool:
        """Whether an alignment of the fleet's own may rest on a window."""
        of_fleet = exists().where(VERSIONS.c.section == record.track_section)
        placed = exists().where(
            POSITIONS.c.wheelset == record.wheelset,
            POSITIONS.c.start_ns == record.start_ns,
            POSITIONS.c.reason_code.is_distinct_from(ReasonCode.CLASS_UNKNOWN.value),
        )
        return bool(self.connection.scalar(select(and_(of_fleet, placed))))
