"""Which wheelsets changed in a transaction: counted once each, in a fixed order, when it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, update

from fleet_db.models import WheelsetChangeRow
from fleet_db.rows import insert_new, table_of

CHANGES = table_of(WheelsetChangeRow)


@dataclass(slots=True)
class Changes:
    """Serials whose geometry is behind what it is computed from.

    They are written in the order of the serial at the end of the transaction, so that two transactions that touched
    the same wheelsets wait for each other and never in a circle.
    """

    connection: Connection
    noted: set[str] = field(default_factory=set)

    def note(self, wheelset: str) -> None:
        """Something that the geometry of ``wheelset`` is computed from has changed."""
        self.noted.add(wheelset)

    def flush(self) -> None:
        """Write what was noted."""
        for wheelset in sorted(self.noted):
            if not insert_new(self.connection, CHANGES, {"wheelset": wheelset, "change": 1, "geometry_change": 0}):
                self.connection.execute(
                    update(CHANGES).where(CHANGES.c.wheelset == wheelset).values(change=CHANGES.c.change + 1)
                )
        self.noted.clear()
