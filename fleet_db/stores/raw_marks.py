"""The mark that the folder of raw recordings of this database holds."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, delete, insert, select

from fleet_db.rows import table_of
from fleet_db.tables import RawMarkRow

MARKS = table_of(RawMarkRow)


@dataclass(frozen=True, slots=True)
class RawMarkStore:
    """The mark, in one transaction."""

    connection: Connection

    def get(self) -> str | None:
        """Return the mark; None before the first use."""
        mark: str | None = self.connection.scalar(select(MARKS.c.mark))
        return mark

    def set(self, mark: str, recorded_ns: int) -> None:
        """Make this the mark."""
        self.connection.execute(delete(MARKS))
        self.connection.execute(insert(MARKS).values(mark=mark, recorded_ns=recorded_ns))
