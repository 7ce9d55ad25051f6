"""Our own clock: results that were stored while it was ahead."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, func, select, update

from fleet_db.locks import Subject, serialise
from fleet_db.receipts import ChunkState
from fleet_db.rows import table_of
from fleet_db.tables import ChunkRow, ResultRow

CHUNKS = table_of(ChunkRow)
RESULTS = table_of(ResultRow)
DAY_NS = 86_400_000_000_000
MOST_BEHIND_NS = DAY_NS
"""How far our clock may be behind what vehicles have measured by theirs before it is the one that is wrong."""


@dataclass(frozen=True, slots=True)
class RecordedTimeStore:
    """Our clock on what is stored: results from the time when it was ahead count as recorded now."""

    connection: Connection

    def correct(self, now_ns: int) -> int:
        """Let results that carry a later time than our clock shows count as recorded now; return how many.

        A time that our clock has shown twice is then the second time; the order of results does not change. Nothing
        is done where our clock is so far behind the vehicles' that it is the one that is wrong.
        """
        newest = self.connection.scalar(select(func.max(RESULTS.c.recorded_ns)))
        if newest is None or newest <= now_ns:
            return 0
        measured = select(func.max(CHUNKS.c.last_ns)).where(
            CHUNKS.c.state == ChunkState.DECODED.value,
            CHUNKS.c.last_ns <= func.coalesce(CHUNKS.c.clock_checked_ns, CHUNKS.c.received_ns) + DAY_NS,
        )
        if now_ns < (self.connection.scalar(measured) or 0) - MOST_BEHIND_NS:
            return 0
        serialise(self.connection, Subject.GEOMETRIES)
        superseded = update(RESULTS).where(RESULTS.c.superseded_ns > now_ns).values(superseded_ns=now_ns)
        self.connection.execute(superseded)
        recorded = update(RESULTS).where(RESULTS.c.recorded_ns > now_ns).values(recorded_ns=now_ns)
        return self.connection.execute(recorded).rowcount
