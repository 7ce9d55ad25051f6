"""What a database holds of its installation: settings, mark of the raw store, clock, branches of the feed."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import delete, func, insert, select, update

from estimation.errors import ParameterError, StorageError
from estimation.values.units import DAY_NS, SECOND_NS
from fleet_db.locks import Subject, serialise
from fleet_db.records import ChunkState
from fleet_db.rows import columns_of, table_of, upsert
from fleet_db.subjects import Store
from fleet_db.tables.alerts import AlertEventRow, FeedBranchRow
from fleet_db.tables.operation import ResultRow, StoredSettingRow
from fleet_db.tables.recordings import ChunkRow, RawMarkRow

SETTINGS, CHUNKS = table_of(StoredSettingRow), table_of(ChunkRow)
LENGTH = "window_length_ns"


class StoredSettingStore(Store):
    """Settings and their values, in one transaction."""

    def get(self, name: str) -> str | None:
        """Return a setting; None where it was never stored."""
        value: str | None = self.connection.scalar(select(SETTINGS.c.value).where(SETTINGS.c.name == name))
        return value

    def put(self, name: str, value: str, recorded_ns: int) -> None:
        """Store a setting in place of what is there."""
        upsert(self.connection, SETTINGS, {"name": name, "value": value, "recorded_ns": recorded_ns})

    def alone(self) -> None:
        """Let no other transaction change settings until this one has ended."""
        serialise(self.connection, Subject.SETTINGS)

    def in_use(self) -> bool:
        """Return whether a recording was stored: before that every setting may change."""
        return self.connection.execute(select(CHUNKS.c.digest).limit(1)).first() is not None

    def check_window_length(self, length_ns: int) -> None:
        """Refuse a window length that is not the one with which data are stored."""
        text = self.get(LENGTH)
        stored = None if text is None else int(text)
        if stored is not None and stored != length_ns and self.in_use():
            raise ParameterError(
                f"is {length_ns / SECOND_NS:g} s, and the windows in this database have {stored / SECOND_NS:g} s: set"
                f" it to {stored / SECOND_NS:g}, or begin a database and a data directory of their own",
                field="window_length_s",
            )


MARKS = table_of(RawMarkRow)


class RawMarkStore(Store):
    """The mark, in one transaction."""

    def get(self) -> str | None:
        """Return the mark; None before the first use."""
        mark: str | None = self.connection.scalar(select(MARKS.c.mark))
        return mark

    def set(self, mark: str, recorded_ns: int) -> None:
        """Make this the mark."""
        self.connection.execute(delete(MARKS))
        self.connection.execute(insert(MARKS).values(mark=mark, recorded_ns=recorded_ns))


BRANCHES, EVENTS = table_of(FeedBranchRow), table_of(AlertEventRow)


@dataclass(frozen=True, slots=True)
class FeedBranch:
    """The feed from one restore to the next."""

    identity: str  # random; of the database at first, another one after each restore
    after_sequence: int  # last event that it shares with the branch before


class FeedBranchStore(Store):
    """The branches of the feed, in one transaction."""

    def all(self) -> Sequence[FeedBranch]:
        """Return the branches, the current one last; StorageError: somebody has emptied the database."""
        statement = select(BRANCHES.c.identity, BRANCHES.c.after_sequence).order_by(BRANCHES.c.branch_id)
        branches = [FeedBranch(*row) for row in self.connection.execute(statement)]
        if not branches:
            raise StorageError("the database has no identity: its table feed_branches is empty")
        return branches

    def begin(self, now_ns: int) -> FeedBranch:
        """Begin a branch behind the newest event, in the transaction that restores a database, and return it."""
        branch = FeedBranch(uuid.uuid4().hex, self.newest_sequence())
        self.connection.execute(insert(BRANCHES).values(**columns_of(branch), began_ns=now_ns))
        return branch

    def newest_sequence(self) -> int:
        """Return the number of the newest event; 0 where there is none."""
        return self.connection.scalar(select(func.max(EVENTS.c.sequence))) or 0


RESULTS = table_of(ResultRow)
MOST_BEHIND_NS = DAY_NS
"""How far our clock may be behind what vehicles have measured by theirs before it is the one that is wrong."""


class RecordedTimeStore(Store):
    """Our clock on what is stored: results from the time when it was ahead count as recorded now."""

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
        self.connection.execute(update(RESULTS).where(RESULTS.c.superseded_ns > now_ns).values(superseded_ns=now_ns))
        recorded = update(RESULTS).where(RESULTS.c.recorded_ns > now_ns).values(recorded_ns=now_ns)
        return self.connection.execute(recorded).rowcount
