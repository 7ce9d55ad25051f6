"""Creep forces of windows and the friction of sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, delete, func, or_, select

from estimation.values.adhesion import SectionAdhesion, WindowAdhesion
from estimation.values.geometry_results import GEOMETRY
from estimation.values.windows import WindowKey, WindowState
from fleet_db.packed_adhesion import (
    pack_section_adhesion,
    pack_window_adhesion,
    unpack_section_adhesion,
    unpack_window_adhesion,
)
from fleet_db.rows import table_of, upsert
from fleet_db.tables import ResultRow, SectionAdhesionRow, WindowAdhesionRow, WindowRow

OF_WINDOWS, OF_SECTIONS = table_of(WindowAdhesionRow), table_of(SectionAdhesionRow)
WINDOWS, RESULTS = table_of(WindowRow), table_of(ResultRow)
FORGOTTEN = 1000  # windows at once: the next run goes on
SAME = and_(OF_WINDOWS.c.wheelset == WINDOWS.c.wheelset, OF_WINDOWS.c.start_ns == WINDOWS.c.start_ns)


@dataclass(frozen=True, slots=True)
class AdhesionStore:
    """Implements ``estimation.storage.Adhesion``."""

    connection: Connection

    def waiting(self, section: str, after: WindowKey | None, limit: int) -> Sequence[WindowKey]:
        """Return windows of a section that are estimated and whose creep has not been looked at, by time and wheelset.

        Their wheelsets have a geometry, and their samples are there. Each window is returned until what was found of
        its content is stored.

        Args:
            after: Wheelset and start of the one behind which to go on; None from the beginning.
            limit: How many at most.
        """
        wheelset, start_ns = WINDOWS.c.wheelset, WINDOWS.c.start_ns
        of_wheelset = (RESULTS.c.stage == GEOMETRY.stage, RESULTS.c.subject == wheelset)
        known = select(RESULTS.c.subject).where(*of_wheelset).correlate(WINDOWS).exists()
        statement = _not_looked_at(section).where(known)
        if after is not None:
            statement = statement.where(or_(start_ns > after[1], and_(start_ns == after[1], wheelset > after[0])))
        rows = self.connection.execute(statement.order_by(start_ns, wheelset).limit(limit))
        return [(row.wheelset, row.start_ns) for row in rows]

    def unlooked(self, section: str) -> bool:
        """Return whether there are windows of a section that are estimated and not looked at, geometry or not."""
        return self.connection.execute(_not_looked_at(section).limit(1)).first() is not None

    def put(self, found: WindowAdhesion) -> None:
        """Store the creep of a window; an earlier one is replaced."""
        values = {
            "wheelset": found.wheelset,
            "start_ns": found.start_ns,
            "track_section": found.track_section,
            "content_digest": found.content_digest,
            "with_sums": found.sums is not None,
            "packed": pack_window_adhesion(found),
        }
        upsert(self.connection, OF_WINDOWS, values)

    def window(self, wheelset: str, start_ns: int) -> WindowAdhesion | None:
        """Return the creep of a window; None where it has not been looked at."""
        same = (OF_WINDOWS.c.wheelset == wheelset, OF_WINDOWS.c.start_ns == start_ns)
        return next(iter(self._windows(select(OF_WINDOWS).where(*same))), None)

    def of_wheelset(self, wheelset: str, after_ns: int | None, limit: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a wheelset that begin after a time, oldest first.

        A window whose samples are others by now is left out until it has been looked at again.

        Args:
            after_ns: Start of the one behind which to go on; None from the beginning.
            limit: How many at most.
        """
        same = (OF_WINDOWS.c.wheelset == wheelset, OF_WINDOWS.c.content_digest == WINDOWS.c.content_digest)
        chosen = select(OF_WINDOWS).select_from(OF_WINDOWS.join(WINDOWS, SAME)).where(*same)
        if after_ns is not None:
            chosen = chosen.where(OF_WINDOWS.c.start_ns > after_ns)
        return self._windows(chosen.limit(limit))

    def of_section(self, section: str, from_ns: int, to_ns: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a section that begin within ``[from_ns, to_ns]``, by time and wheelset.

        A window whose samples or section are others by now is left out until it has been looked at again.
        """
        within = (OF_WINDOWS.c.start_ns >= from_ns, OF_WINDOWS.c.start_ns <= to_ns)
        return self._windows(_standing(select(OF_WINDOWS), section).where(*within))

    def starts_with_sums(self, section: str, from_ns: int, to_ns: int) -> Sequence[int]:
        """Return when the windows of a section began within ``[from_ns, to_ns]`` whose sums of friction are kept."""
        start_ns = OF_WINDOWS.c.start_ns
        chosen = _standing(select(start_ns).distinct(), section).where(start_ns >= from_ns, start_ns <= to_ns)
        return list(self.connection.execute(chosen.where(OF_WINDOWS.c.with_sums).order_by(start_ns)).scalars())

    def forget_sums(self, section: str, before_ns: int) -> int:
        """Remove the sums of friction of the windows of a section that begin before a time; return of how many.

        They are a hundred times as long as the forces, and only what is pooled needs them.
        """
        old = (OF_WINDOWS.c.track_section == section, OF_WINDOWS.c.start_ns < before_ns, OF_WINDOWS.c.with_sums)
        found = self._windows(select(OF_WINDOWS).where(*old).limit(FORGOTTEN))
        for one in found:
            self.put(replace(one, sums=None))
        return len(found)

    def put_section(self, found: SectionAdhesion, code_version: str) -> bool:
        """Store the friction of a section; return whether anything changed.

        Of the hours that end within these, those that reach back furthest are kept: so every time stays in some.
        """
        values = {
            "track_section": found.track_section,
            "to_ns": found.to_ns,
            "from_ns": found.from_ns,
            "code_version": code_version,
            "packed": pack_section_adhesion(found),
        }
        key = (OF_SECTIONS.c.track_section == found.track_section, OF_SECTIONS.c.to_ns == found.to_ns)
        before = self.connection.execute(select(OF_SECTIONS).where(*key)).mappings().first()
        if before is not None and all(before[name] == value for name, value in values.items()):
            return False
        within = (
            OF_SECTIONS.c.track_section == found.track_section,
            OF_SECTIONS.c.to_ns >= found.from_ns,
            OF_SECTIONS.c.to_ns < found.to_ns,
        )
        first = select(func.min(OF_SECTIONS.c.to_ns)).where(*within).scalar_subquery()
        self.connection.execute(delete(OF_SECTIONS).where(*within, OF_SECTIONS.c.to_ns > first))
        return upsert(self.connection, OF_SECTIONS, values)

    def section(self, section: str, at_ns: int | None = None) -> SectionAdhesion | None:
        """Return the newest friction of a section; None where there is none.

        Args:
            at_ns: Of hours that hold this vehicle time; None for the last hours.
        """
        statement = select(OF_SECTIONS).where(OF_SECTIONS.c.track_section == section)
        if at_ns is not None:
            statement = statement.where(OF_SECTIONS.c.from_ns <= at_ns, OF_SECTIONS.c.to_ns >= at_ns)
        row = self.connection.execute(statement.order_by(OF_SECTIONS.c.to_ns.desc()).limit(1)).first()
        where = f"friction of section {section}"
        return None if row is None else unpack_section_adhesion(row.packed, where=where)

    def during(self, section: str, from_ns: int, to_ns: int) -> Sequence[SectionAdhesion]:
        """Return the friction of a section of all hours that hold a time of a span, newest first."""
        chosen = (
            OF_SECTIONS.c.track_section == section,
            OF_SECTIONS.c.from_ns <= to_ns,
            OF_SECTIONS.c.to_ns >= from_ns,
        )
        rows = self.connection.execute(select(OF_SECTIONS).where(*chosen).order_by(OF_SECTIONS.c.to_ns.desc()))
        return [unpack_section_adhesion(row.packed, where=f"friction of section {section}") for row in rows]

    def _windows(self, statement: Select[Any]) -> Sequence[WindowAdhesion]:
        ordered = statement.order_by(OF_WINDOWS.c.start_ns, OF_WINDOWS.c.wheelset)
        return [_window(row) for row in self.connection.execute(ordered)]


def _window(row: Row[Any]) -> WindowAdhesion:
    return unpack_window_adhesion(row.packed, where=f"creep of window {row.wheelset}@{row.start_ns}")


def _standing(statement: Select[Any], section: str) -> Select[Any]:
    """Return a statement for the creep of windows of a section, of the samples that they have."""
    return statement.select_from(OF_WINDOWS.join(WINDOWS, SAME)).where(
        OF_WINDOWS.c.track_section == section,
        WINDOWS.c.track_section == section,
        WINDOWS.c.content_digest == OF_WINDOWS.c.content_digest,
    )


def _not_looked_at(section: str) -> Select[Any]:
    """Return a statement for the keys of windows of a section whose content has not been looked at."""
    looked_at = OF_WINDOWS.c.content_digest
    return (
        select(WINDOWS.c.wheelset, WINDOWS.c.start_ns)
        .select_from(WINDOWS.outerjoin(OF_WINDOWS, SAME))
        .where(WINDOWS.c.track_section == section, WINDOWS.c.state == WindowState.ESTIMATED.value)
        .where(WINDOWS.c.samples_purged_ns.is_(None), or_(looked_at.is_(None), looked_at != WINDOWS.c.content_digest))
    )
