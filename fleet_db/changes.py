"""Which wheelsets changed in a transaction: counted once each, in a fixed order, when it ends.

What the worklist shows of them is made again then, too (``fleet_db.stores.worklist``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, select, update

from estimation.values.runs import SubjectKind
from estimation.values.subjects import Facet
from fleet_db.rows import insert_new, table_of
from fleet_db.subjects import Subjects
from fleet_db.tables import MountingRow, SectionChangeRow, WheelsetChangeRow

CHANGES, OF_SECTIONS = table_of(WheelsetChangeRow), table_of(SectionChangeRow)
MOUNTINGS = table_of(MountingRow)


@dataclass(slots=True)
class Changes:
    """Serials to which something has happened that jobs look at, and those of which the worklist shows something.

    They are written in the order of the serial at the end of the transaction, and the sections behind them in the order
    of their codes, so that two transactions that touched the same wait for each other and never in a circle.
    """

    connection: Connection
    subjects: Subjects
    shown: set[str] = field(default_factory=set)
    touched: set[str] = field(default_factory=set)  # since they were written last
    sections: set[str] = field(default_factory=set)  # on which something has happened since they were written last

    def note(self, wheelset: str, *, shown: bool = True) -> None:
        """Something that the geometry of a wheelset is computed from has changed."""
        self.subjects.raised(SubjectKind.WHEELSET, wheelset, Facet.WINDOWS)
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
        """Something on file of ``vehicle`` has changed that its windows rest on, and the worklist shows."""
        self.sections.update(self.subjects.vehicle_on_file(vehicle))
        mounted = select(MOUNTINGS.c.wheelset).where(MOUNTINGS.c.vehicle == vehicle, MOUNTINGS.c.to_ns.is_(None))
        for serial in self.connection.scalars(mounted):
            self.show(serial)

    def take_shown(self) -> list[str]:
        """Return the serials whose row of the worklist is to be made again, in their order; they are forgotten here."""
        taken = sorted(self.shown)
        self.shown.clear()
        return taken

    def flush(self) -> None:
        """Write what was noted."""
        self.subjects.flush()
        for wheelset in sorted(self.touched):
            counted = update(CHANGES).where(CHANGES.c.wheelset == wheelset).values(touched=CHANGES.c.touched + 1)
            known = self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount
            if not known and not insert_new(self.connection, CHANGES, {"wheelset": wheelset, "touched": 1}):
                self.connection.execute(counted)
        for section in sorted(self.sections):
            counted = update(OF_SECTIONS).where(OF_SECTIONS.c.section == section)
            counted = counted.values(touched=OF_SECTIONS.c.touched + 1)
            known = self.connection.execute(counted.execution_options(preserve_rowcount=True)).rowcount
            if not known and not insert_new(self.connection, OF_SECTIONS, {"section": section, "touched": 1}):
                self.connection.execute(counted)
        self.touched.clear()
        self.sections.clear()
