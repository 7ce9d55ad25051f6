"""Creep forces of windows and the friction of sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, Row, Select, and_, delete, func, select, tuple_

from estimation.values.opinions import CREEP, FRICTION, SectionAdhesion, WindowAdhesion
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowKey
from fleet_db.due import NOT_LOOKED_AT, list_due
from fleet_db.packed_values import (
    pack_section_adhesion,
    pack_window_adhesion,
    unpack_section_adhesion,
    unpack_window_adhesion,
)
from fleet_db.rows import insert_all_new, replace_all, table_of, upsert
from fleet_db.rows import replace as replace_row
from fleet_db.subjects import Subjects
from fleet_db.tables.windows import SectionAdhesionRow, WindowAdhesionRow, WindowRow

OF_WINDOWS, OF_SECTIONS = table_of(WindowAdhesionRow), table_of(SectionAdhesionRow)
WINDOWS = table_of(WindowRow)
FORGOTTEN = 1000  # windows at once: the next run goes on
SAME = and_(OF_WINDOWS.c.wheelset == WINDOWS.c.wheelset, OF_WINDOWS.c.start_ns == WINDOWS.c.start_ns)


@dataclass(frozen=True, slots=True)
class AdhesionStore:
    """Creep forces of windows, and the friction of sections."""

    connection: Connection
    subjects: Subjects

    def looked_at(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, str]:
        """Return digests of the samples that the creep of windows was found from."""
        own = tuple_(OF_WINDOWS.c.wheelset, OF_WINDOWS.c.start_ns).in_(keys)
        rows = self.connection.execute(select(*OF_WINDOWS.primary_key, OF_WINDOWS.c.content_digest).where(own))
        return {(row.wheelset, row.start_ns): row.content_digest for row in rows}

    def list_waiting(self, wheelset: str) -> None:
        """List the estimated windows of a wheelset that have not been looked at."""
        list_due(self.connection, CREEP, and_(WINDOWS.c.wheelset == wheelset, NOT_LOOKED_AT))

    def list_pooled(self, section: str, before_ns: int) -> None:
        """List the windows of a section that begin before a time, and whose sums are kept, to be pooled again."""
        kept = select(OF_WINDOWS.c.with_sums).where(SAME, OF_WINDOWS.c.with_sums).exists()
        old = (WINDOWS.c.track_section == section, WINDOWS.c.start_ns < before_ns)
        list_due(self.connection, FRICTION, and_(*old, kept))

    def put_all(self, found: Sequence[WindowAdhesion]) -> None:
        """Store the creep of windows; earlier ones are replaced. Their sections pool them then."""
        rows = [_values(one) for one in found]
        if insert_all_new(self.connection, OF_WINDOWS, rows) < len(rows):
            replace_all(self.connection, OF_WINDOWS, rows)
        keys = [(one.wheelset, one.start_ns) for one in found]
        if keys:
            list_due(self.connection, FRICTION, tuple_(WINDOWS.c.wheelset, WINDOWS.c.start_ns).in_(keys))
        for one in found:
            self.subjects.raised(SubjectKind.SECTION, one.track_section, CREEP)
            self.subjects.raised(SubjectKind.VEHICLE, one.vehicle, CREEP)

    def window(self, wheelset: str, start_ns: int) -> WindowAdhesion | None:
        """Return the creep of a window; None where it has not been looked at."""
        same = (OF_WINDOWS.c.wheelset == wheelset, OF_WINDOWS.c.start_ns == start_ns)
        return next(iter(self._windows(select(OF_WINDOWS).where(*same))), None)

    def of_wheelset(self, wheelset: str, after_ns: int | None, limit: int) -> Sequence[WindowAdhesion]:
        """Return the creep of the windows of a wheelset that begin after a time, oldest first.

        A window whose samples are others by now is left out until it has been looked at again.
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
        replace_all(self.connection, OF_WINDOWS, [_values(replace(one, sums=None)) for one in found])
        return len(found)

    def put_section(self, found: SectionAdhesion, code_version: str, made_with: str) -> bool:
        """Store a section's friction; of hours that end within these, those that reach back furthest stay: no gaps."""
        values = {
            "track_section": found.track_section,
            "to_ns": found.to_ns,
            "from_ns": found.from_ns,
            "code_version": code_version,
            "made_with": made_with,
            "packed": pack_section_adhesion(found),
        }
        key = (OF_SECTIONS.c.track_section == found.track_section, OF_SECTIONS.c.to_ns == found.to_ns)
        before = self.connection.execute(select(OF_SECTIONS).where(*key)).mappings().first()
        if before is not None and all(before[name] == value for name, value in values.items() if name != "made_with"):
            if before["made_with"] != made_with:
                replace_row(self.connection, OF_SECTIONS, values)
            return False
        within = (
            OF_SECTIONS.c.track_section == found.track_section,
            OF_SECTIONS.c.to_ns >= found.from_ns,
            OF_SECTIONS.c.to_ns < found.to_ns,
        )
        first = select(func.min(OF_SECTIONS.c.to_ns)).where(*within).scalar_subquery()
        self.connection.execute(delete(OF_SECTIONS).where(*within, OF_SECTIONS.c.to_ns > first))
        self.subjects.raised(SubjectKind.SECTION, found.track_section, FRICTION)
        return upsert(self.connection, OF_SECTIONS, values)

    def made_with(self, sections: Sequence[str]) -> Mapping[str, tuple[int, str]]:
        """Return when the newest hours of some sections end, and digests of the limits that they were found with."""
        chosen = (OF_SECTIONS.c.track_section.in_(sections),)
        columns = (OF_SECTIONS.c.track_section, OF_SECTIONS.c.to_ns, OF_SECTIONS.c.made_with)
        rows = self.connection.execute(select(*columns).where(*chosen).order_by(OF_SECTIONS.c.to_ns))
        return {row.track_section: (row.to_ns, row.made_with) for row in rows}

    def section(self, section: str, at_ns: int | None = None) -> SectionAdhesion | None:
        """Return the newest friction of a section, or that of hours with a vehicle time; None where there is none."""
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


def _values(found: WindowAdhesion) -> dict[str, object]:
    return {
        "wheelset": found.wheelset,
        "start_ns": found.start_ns,
        "track_section": found.track_section,
        "content_digest": found.content_digest,
        "with_sums": found.sums is not None,
        "packed": pack_window_adhesion(found),
    }
