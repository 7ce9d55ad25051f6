"""What was done to recordings by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from fleet_db.receipts import ChunkState, RecordingAction, RecordingChange
from fleet_db.rows import table_of
from fleet_db.tables import RecordingChangeRow

CHANGES = table_of(RecordingChangeRow)


@dataclass(frozen=True, slots=True)
class RecordingChangeStore:
    """The record of changes, append-only, in one transaction."""

    connection: Connection

    def add(self, change: RecordingChange) -> None:
        """Add one."""
        self.connection.execute(insert(CHANGES).values(**asdict(change)))

    def list(self, digest: str) -> Sequence[RecordingChange]:
        """Return what was done to one recording, oldest first."""
        statement = select(CHANGES).where(CHANGES.c.digest == digest).order_by(CHANGES.c.id)
        return [_change(row) for row in self.connection.execute(statement)]


def _change(row: Row[Any]) -> RecordingChange:
    fields = dict(row._mapping)  # noqa: SLF001 - SQLAlchemy's public accessor
    del fields["id"]
    enumerations = {
        "action": RecordingAction(row.action),
        "state_before": ChunkState(row.state_before),
        "state_after": ChunkState(row.state_after),
    }
    return RecordingChange(**{**fields, **enumerations})
