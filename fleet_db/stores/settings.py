"""Settings that must not differ between the processes of a deployment, nor change after data are stored."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, select

from fleet_db.locks import Subject, serialise
from fleet_db.rows import table_of, upsert
from fleet_db.tables import ChunkRow, StoredSettingRow

SETTINGS, CHUNKS = table_of(StoredSettingRow), table_of(ChunkRow)


@dataclass(frozen=True, slots=True)
class StoredSettingStore:
    """Settings and their values, in one transaction."""

    connection: Connection

    def get(self, name: str) -> str | None:
        """Return a setting; None where it was never stored."""
        found: str | None = self.connection.scalar(select(SETTINGS.c.value).where(SETTINGS.c.name == name))
        return found

    def put(self, name: str, value: str, recorded_ns: int) -> None:
        """Store a setting in place of what is there."""
        upsert(self.connection, SETTINGS, {"name": name, "value": value, "recorded_ns": recorded_ns})

    def alone(self) -> None:
        """Let no other transaction change settings until this one has ended."""
        serialise(self.connection, Subject.SETTINGS)

    def in_use(self) -> bool:
        """Return whether a recording was stored: before that every setting may change."""
        return self.connection.execute(select(CHUNKS.c.digest).limit(1)).first() is not None
