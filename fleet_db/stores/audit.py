"""The audit log: entries are added, read and, when they are old, purged; never changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, insert, select

from fleet_db.access_records import AuditEntry
from fleet_db.rows import columns_of, table_of, value_of_row
from fleet_db.tables import AuditRow

ENTRIES = table_of(AuditRow)


@dataclass(frozen=True, slots=True)
class AuditFilter:
    """Which entries: of an owner, of a key, with a status, of a method, and at which times; None is no filter."""

    owner: str | None = None
    key_prefix: str | None = None
    status: int | None = None
    method: str | None = None
    from_ns: int | None = None
    to_ns: int | None = None


@dataclass(frozen=True, slots=True)
class AuditStore:
    """The audit log, in one transaction."""

    connection: Connection

    def add(self, entries: Sequence[AuditEntry]) -> None:
        """Add entries, in their order."""
        if entries:
            self.connection.execute(insert(ENTRIES), [columns_of(entry, "entry_id") for entry in entries])

    def page(self, chosen: AuditFilter, before_id: int | None, limit: int) -> Sequence[AuditEntry]:
        """Return at most ``limit`` entries with a number below ``before_id``, newest first."""
        same = {name: getattr(chosen, name) for name in ("owner", "key_prefix", "status", "method")}
        statement = select(ENTRIES).where(
            *(ENTRIES.c[name] == value for name, value in same.items() if value is not None)
        )
        if chosen.from_ns is not None:
            statement = statement.where(ENTRIES.c.at_ns >= chosen.from_ns)
        if chosen.to_ns is not None:
            statement = statement.where(ENTRIES.c.at_ns < chosen.to_ns)
        if before_id is not None:
            statement = statement.where(ENTRIES.c.entry_id < before_id)
        rows = self.connection.execute(statement.order_by(ENTRIES.c.entry_id.desc()).limit(limit))
        return [value_of_row(AuditEntry, row) for row in rows]
