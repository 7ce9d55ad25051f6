"""Which wheelsets changed in a transaction: counted once each, in a fixed order, when it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, update

from fleet_db.rows import insert_new, table_of
from fleet_db.subjects import Subjects
from fleet_db.tables import SectionChangeRow, WheelsetChangeRow

CHANGES, OF_SECTIONS = table_of(WheelsetChangeRow), table_of(SectionChangeRow)


@dataclass(slots=True)
class Changes:
    """Serials whose geometry is behind what it is computed from, and sections that jobs look at.

    They are written in the order of the serial at the end of the transaction, and the sections behind them in the order
    of their codes, so that two transactions that change the same wait for each other and never in a circle.
    """

    connection: Connection
    subjects: Subjects
    noted: set[str] = field(default_factory=set)  # since they were written last
    sections: set[str] = field(default_factory=set)  # on which something has happened since they were written last

    def note(self, wheelset: str) -> None:
        """Something that the geometry of a wheelset is computed from has changed."""
        self.noted.add(wheelset)

    def on_section(self, section: str | None) -> None:
        """Something has happened to windows, positions or epochs of a section; None is no section.

        Jobs look again at a section only where this has been said, or what they compare is another.
        """
        self.sections.add(section or "")

    def refile(self, wheelset: str) -> None:
        """Something on file of ``wheelset`` has changed that its geometry, windows and epochs rest on."""
        self.note(wheelset)
        self.sections.update(self.subjects.wheelset_on_file(wheelset))

    def refile_vehicle(self, vehicle: str) -> None:
        """Something on file of ``vehicle`` has changed that its windows rest on."""
        self.sections.update(self.subjects.vehicle_on_file(vehicle))

    def flush(self) -> None:
        """Write what was noted."""
        self.subjects.flush()
        for wheelset in sorted(self.noted):
            counted = update(CHANGES).where(CHANGES.c.wheelset == wheelset).values(change=CHANGES.c.change + 1)
            if not self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount:
                first = {"wheelset": wheelset, "change": 1, "geometry_change": 0}
                if not insert_new(self.connection, CHANGES, first):
                    self.connection.execute(counted)
        for section in sorted(self.sections):
            counted = update(OF_SECTIONS).where(OF_SECTIONS.c.section == section)
            counted = counted.values(touched=OF_SECTIONS.c.touched + 1)
            known = self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount
            if not known and not insert_new(self.connection, OF_SECTIONS, {"section": section, "touched": 1}):
                self.connection.execute(counted)
        self.noted.clear()
        self.sections.clear()
