"""What was done to recordings by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, insert, select

from fleet_db.receipts import RecordingChange
from fleet_db.rows import columns_of, table_of, value_of_row
from fleet_db.tables import RecordingChangeRow

CHANGES = table_of(RecordingChangeRow)


@dataclass(frozen=True, slots=True)
class RecordingChangeStore:
    """The record of changes, append-only, in one transaction."""

    connection: Connection

    def add(self, change: RecordingChange) -> None:
        """Add one."""
        self.connection.execute(insert(CHANGES).values(columns_of(change)))

    def list(self, digest: str) -> Sequence[RecordingChange]:
        """Return what was done to one recording, oldest first."""
        statement = select(CHANGES).where(CHANGES.c.digest == digest).order_by(CHANGES.c.id)
        return [value_of_row(RecordingChange, row) for row in self.connection.execute(statement)]
