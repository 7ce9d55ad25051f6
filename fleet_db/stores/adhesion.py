"""Creep forces of windows and the friction of sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, or_, select

from estimation.values.adhesion import SectionAdhesion, WindowAdhesion
from estimation.values.windows import WindowKey, WindowState
from fleet_db.models import GeometryRow, SectionAdhesionRow, WindowAdhesionRow, WindowRow
from fleet_db.packed_adhesion import (
    pack_section_adhesion,
    pack_window_adhesion,
    unpack_section_adhesion,
    unpack_window_adhesion,
)
from fleet_db.rows import table_of, upsert

OF_WINDOWS, OF_SECTIONS = table_of(WindowAdhesionRow), table_of(SectionAdhesionRow)
WINDOWS, GEOMETRIES = table_of(WindowRow), table_of(GeometryRow)
SAME = and_(OF_WINDOWS.c.wheelset == WINDOWS.c.wheelset, OF_WINDOWS.c.start_ns == WINDOWS.c.start_ns)


@dataclass(frozen=True, slots=True)
class AdhesionStore:
    """Implements ``estimation.storage.Adhesion``."""

    connection: Connection

    def waiting(self, after: WindowKey | None, limit: int) -> Sequence[WindowKey]:
        """Return windows that are estimated and whose creep has not been looked at, by wheelset and start.

        Their wheelsets have a geometry, and their samples are there. Each window is returned until what was found of
        its content is stored.

        Parameters
        ----------
        after
            Behind this one; None from the beginning.
        limit
            How many at most.
        """
        wheelset, start_ns = WINDOWS.c.wheelset, WINDOWS.c.start_ns
        known = select(GEOMETRIES.c.wheelset).where(GEOMETRIES.c.wheelset == wheelset).correlate(WINDOWS).exists()
        statement = (
            select(wheelset, start_ns)
            .select_from(WINDOWS.outerjoin(OF_WINDOWS, SAME))
            .where(WINDOWS.c.state == WindowState.ESTIMATED.value, WINDOWS.c.track_section.is_not(None))
            .where(WINDOWS.c.samples_purged_ns.is_(None), known)
            .where(or_(OF_WINDOWS.c.content_digest.is_(None), OF_WINDOWS.c.content_digest != WINDOWS.c.content_digest))
        )
        if after is not None:
            statement = statement.where(or_(wheelset > after[0], and_(wheelset == after[0], start_ns > after[1])))
        rows = self.connection.execute(statement.order_by(wheelset, start_ns).limit(limit))
        return [(row.wheelset, row.start_ns) for row in rows]

    def put(self, found: WindowAdhesion) -> None:
        """Store the creep of a window; an earlier one is replaced."""
        values = {
            "wheelset": found.wheelset,
            "start_ns": found.start_ns,
            "vehicle": found.vehicle,
            "track_section": found.track_section,
            "content_digest": found.content_digest,
            "status": found.status.value,
            "reason_code": None if found.reason is None else found.reason.code.value,
            "packed": pack_window_adhesion(found),
        }
        upsert(self.connection, OF_WINDOWS, values)

    def window(self, wheelset: str, start_ns: int) -> WindowAdhesion | None:
        """Return the creep of a window; None where it has not been looked at."""
        same = (OF_WINDOWS.c.wheelset == wheelset, OF_WINDOWS.c.start_ns == start_ns)
        return next(iter(self._windows(select(OF_WINDOWS).where(*same))), None)

    def of_section(self, section: str, from_ns: int, to_ns: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a section that begin within ``[from_ns, to_ns]``, by time and wheelset."""
        chosen = (
            OF_WINDOWS.c.track_section == section,
            OF_WINDOWS.c.start_ns >= from_ns,
            OF_WINDOWS.c.start_ns <= to_ns,
        )
        return self._windows(select(OF_WINDOWS).where(*chosen))

    def put_section(self, found: SectionAdhesion, code_version: str, recorded_ns: int) -> bool:
        """Store the friction of a section; return whether anything changed."""
        values = {
            "track_section": found.track_section,
            "to_ns": found.to_ns,
            "from_ns": found.from_ns,
            "windows": found.windows,
            "code_version": code_version,
            "packed": pack_section_adhesion(found),
        }
        key = (OF_SECTIONS.c.track_section == found.track_section, OF_SECTIONS.c.to_ns == found.to_ns)
        before = self.connection.execute(select(OF_SECTIONS).where(*key)).mappings().first()
        if before is not None and all(before[name] == value for name, value in values.items()):
            return False
        return upsert(self.connection, OF_SECTIONS, values | {"recorded_ns": recorded_ns})

    def section(self, section: str, at_ns: int | None = None) -> SectionAdhesion | None:
        """Return the newest friction of a section; None where there is none.

        Parameters
        ----------
        section
            Code.
        at_ns
            Of hours that hold this vehicle time; None for the last hours.
        """
        statement = select(OF_SECTIONS).where(OF_SECTIONS.c.track_section == section)
        if at_ns is not None:
            statement = statement.where(OF_SECTIONS.c.from_ns <= at_ns, OF_SECTIONS.c.to_ns >= at_ns)
        row = self.connection.execute(statement.order_by(OF_SECTIONS.c.to_ns.desc()).limit(1)).first()
        where = f"friction of section {section}"
        return None if row is None else unpack_section_adhesion(row.packed, where=where)

    def _windows(self, statement: Select[Any]) -> Sequence[WindowAdhesion]:
        ordered = statement.order_by(OF_WINDOWS.c.start_ns, OF_WINDOWS.c.wheelset)
        return [_window(row) for row in self.connection.execute(ordered)]


def _window(row: Row[Any]) -> WindowAdhesion:
    return unpack_window_adhesion(row.packed, where=f"creep of window {row.wheelset}@{row.start_ns}")
