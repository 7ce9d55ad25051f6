"""What changed in a transaction: counted once each, in a fixed order, when it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, update

from estimation.values.runs import SubjectKind
from estimation.values.subjects import Facet
from fleet_db.rows import insert_new, table_of
from fleet_db.subjects import Subjects
from fleet_db.tables import SectionChangeRow

OF_SECTIONS = table_of(SectionChangeRow)


@dataclass(slots=True)
class Changes:
    """Sections on which something has happened that jobs look at, and facets of wheelsets.

    They are written in one order at the end of the transaction, so that two transactions that changed the same wait for
    each other and never in a circle.
    """

    connection: Connection
    subjects: Subjects
    sections: set[str] = field(default_factory=set)  # on which something has happened since they were written last

    def note(self, wheelset: str) -> None:
        """Something that the geometry of a wheelset is computed from has changed."""
        self.subjects.raised(SubjectKind.WHEELSET, wheelset, Facet.TABLES)

    def on_section(self, section: str | None) -> None:
        """Something has happened to windows, positions or epochs of a section; None is no section.

        Jobs look again at a section only where this has been said, or what they compare is another.
        """
        self.sections.add(section or "")

    def refile(self, wheelset: str) -> None:
        """Something on file of ``wheelset`` has changed that its geometry, windows and epochs rest on."""
        self.sections.update(self.subjects.wheelset_on_file(wheelset))

    def refile_vehicle(self, vehicle: str) -> None:
        """Something on file of ``vehicle`` has changed that its windows rest on."""
        self.sections.update(self.subjects.vehicle_on_file(vehicle))

    def flush(self) -> None:
        """Write what was noted."""
        self.subjects.flush()
        for section in sorted(self.sections):
            counted = update(OF_SECTIONS).where(OF_SECTIONS.c.section == section)
            counted = counted.values(touched=OF_SECTIONS.c.touched + 1)
            known = self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount
            if not known and not insert_new(self.connection, OF_SECTIONS, {"section": section, "touched": 1}):
                self.connection.execute(counted)
        self.sections.clear()
