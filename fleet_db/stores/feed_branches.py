"""The identity of a database and of each restore of it, for cursors of the feed."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, func, insert, select

from estimation.errors import StorageError
from fleet_db.rows import table_of
from fleet_db.tables import AlertEventRow, FeedBranchRow

BRANCHES, EVENTS = table_of(FeedBranchRow), table_of(AlertEventRow)


@dataclass(frozen=True, slots=True)
class FeedBranch:
    """The feed from one restore to the next.

    Attributes:
        identity: Random; of the database at first, another one after each restore.
        after_sequence: Last event that it shares with the branch before.
    """

    identity: str
    after_sequence: int


@dataclass(frozen=True, slots=True)
class FeedBranchStore:
    """The branches of the feed, in one transaction."""

    connection: Connection

    def all(self) -> Sequence[FeedBranch]:
        """Return the branches, the current one last; StorageError: somebody has emptied the database."""
        statement = select(BRANCHES.c.identity, BRANCHES.c.after_sequence).order_by(BRANCHES.c.branch_id)
        found = [FeedBranch(row.identity, row.after_sequence) for row in self.connection.execute(statement)]
        if not found:
            raise StorageError("the database has no identity: its table feed_branches is empty")
        return found

    def begin(self, now_ns: int) -> FeedBranch:
        """Begin a branch behind the newest event, in the transaction that restores a database, and return it."""
        branch = FeedBranch(uuid.uuid4().hex, self.newest_sequence())
        row = {"identity": branch.identity, "after_sequence": branch.after_sequence, "began_ns": now_ns}
        self.connection.execute(insert(BRANCHES).values(**row))
        return branch

    def newest_sequence(self) -> int:
        """Return the number of the newest event; 0 where there is none."""
        return self.connection.scalar(select(func.max(EVENTS.c.sequence))) or 0
