"""What a job has seen of each wheelset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, select

from estimation.values.runs import Look
from fleet_db.changes import CHANGES, Changes
from fleet_db.rows import table_of, upsert
from fleet_db.tables import LookRow

LOOKS = table_of(LookRow)


@dataclass(frozen=True, slots=True)
class LookStore:
    """Implements ``estimation.storage.Looks``."""

    connection: Connection
    changes: Changes

    def of(self, stage: str) -> Mapping[str, Look]:
        """Return by wheelset what the last look of a job was made from."""
        columns = (LOOKS.c.wheelset, LOOKS.c.inputs, LOOKS.c.until_ns, LOOKS.c.number)
        rows = self.connection.execute(select(*columns).where(LOOKS.c.stage == stage))
        return {row.wheelset: Look(row.inputs, row.until_ns, row.number) for row in rows}

    def note(self, stage: str, wheelset: str, look: Look) -> None:
        """Note what a look at a wheelset was made from.

        Args:
            look: Its inputs, and until when they say the same.
        """
        values = {"inputs": look.inputs, "until_ns": look.until_ns, "number": look.number}
        upsert(self.connection, LOOKS, {"stage": stage, "wheelset": wheelset, **values})

    def touched_of(self, wheelset: str) -> int | None:
        """Return how often something has happened to one wheelset, what this transaction does included."""
        self.changes.flush()
        return self.connection.scalar(select(CHANGES.c.touched).where(CHANGES.c.wheelset == wheelset))

    def touched(self) -> Mapping[str, int]:
        """Return by wheelset how often something has happened to its windows, results, alerts or registration."""
        return {
            row.wheelset: row.touched for row in self.connection.execute(select(CHANGES.c.wheelset, CHANGES.c.touched))
        }
