"""Which wheelsets changed in a transaction: counted once each, in a fixed order, when it ends.

What the worklist shows of them is made again then, too (``fleet_db.stores.worklist``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, update

from fleet_db.models import WheelsetChangeRow
from fleet_db.rows import insert_new, table_of

CHANGES = table_of(WheelsetChangeRow)


@dataclass(slots=True)
class Changes:
    """Serials whose geometry is behind what it is computed from, and those of which the worklist shows something.

    They are written in the order of the serial at the end of the transaction, so that two transactions that touched
    the same wheelsets wait for each other and never in a circle.
    """

    connection: Connection
    noted: set[str] = field(default_factory=set)
    shown: set[str] = field(default_factory=set)
    touched: set[str] = field(default_factory=set)  # noted or shown since they were written last

    def note(self, wheelset: str, *, shown: bool = True) -> None:
        """Something that the geometry of a wheelset is computed from has changed.

        Parameters
        ----------
        wheelset
            Serial.
        shown
            Whether the worklist shows it.
        """
        self.noted.add(wheelset)
        self.touched.add(wheelset)
        if shown:
            self.show(wheelset)

    def show(self, wheelset: str) -> None:
        """Something that the worklist shows of ``wheelset`` has changed."""
        self.shown.add(wheelset)
        self.touched.add(wheelset)

    def touch(self, wheelset: str) -> None:
        """Something has happened to ``wheelset`` that jobs look at, and the worklist does not show."""
        self.touched.add(wheelset)

    def take_shown(self) -> list[str]:
        """Return the serials whose row of the worklist is to be made again, in their order; they are forgotten here."""
        taken = sorted(self.shown)
        self.shown.clear()
        return taken

    def flush(self) -> None:
        """Write what was noted."""
        for wheelset in sorted(self.touched):
            more = 1 if wheelset in self.noted else 0
            counted = update(CHANGES).where(CHANGES.c.wheelset == wheelset)
            counted = counted.values(change=CHANGES.c.change + more, touched=CHANGES.c.touched + 1)
            if not self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount:
                first = {"wheelset": wheelset, "change": more, "geometry_change": 0, "touched": 1}
                if not insert_new(self.connection, CHANGES, first):
                    self.connection.execute(counted)
        self.noted.clear()
        self.touched.clear()
