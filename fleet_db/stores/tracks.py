"""Track sections and versions of their alignment."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, Select, insert, select

from estimation.errors import ConflictError, NotFoundError
from estimation.ports import TrackSectionRecord
from estimation.types import TrackAlignment
from fleet_db.locks import Subject, serialise
from fleet_db.models import TrackAlignmentRow, TrackSectionRow
from fleet_db.packed.alignment import pack_alignment, unpack_alignment
from fleet_db.rows import table_of, upsert

SECTIONS, ALIGNMENTS = table_of(TrackSectionRow), table_of(TrackAlignmentRow)


@dataclass(frozen=True, slots=True)
class TrackStore:
    """Implements ``estimation.ports.Tracks``."""

    connection: Connection

    def sections(self) -> Sequence[TrackSectionRecord]:
        """Return all sections by code."""
        return self._sections(select(SECTIONS).order_by(SECTIONS.c.code))

    def section(self, code: str) -> TrackSectionRecord:
        """Return one section.

        Raises
        ------
        NotFoundError
            There is none of that code.
        """
        found = self._sections(select(SECTIONS).where(SECTIONS.c.code == code))
        if not found:
            raise NotFoundError("track section", code)
        return found[0]

    def section_by_number(self, number: int) -> TrackSectionRecord | None:
        """Return the section that vehicles call ``number``."""
        found = self._sections(select(SECTIONS).where(SECTIONS.c.number == number))
        return found[0] if found else None

    def add_section(self, record: TrackSectionRecord) -> None:
        """Add a section or change it.

        Raises
        ------
        ConflictError
            Another section has its number.
        """
        serialise(self.connection, Subject.TRACKS)
        other = self.section_by_number(record.number)
        if other is not None and other.code != record.code:
            raise ConflictError(
                f"track section {other.code!r} already has number {record.number}",
                kind="track section",
                key=record.code,
            )
        upsert(self.connection, SECTIONS, asdict(record))

    def alignment(self, section: str, version: int | None = None) -> TrackAlignment | None:
        """Return one version of the alignment of a section, or the newest."""
        statement = select(ALIGNMENTS.c.version, ALIGNMENTS.c.packed).where(ALIGNMENTS.c.section == section)
        if version is not None:
            statement = statement.where(ALIGNMENTS.c.version == version)
        row = self.connection.execute(statement.order_by(ALIGNMENTS.c.version.desc()).limit(1)).first()
        if row is None:
            return None
        return unpack_alignment(row.packed, row.version, where=f"alignment {row.version} of track section {section!r}")

    def add_alignment(self, alignment: TrackAlignment) -> int:
        """Store an alignment as the next version of its section and return that; ``alignment.version`` is not read.

        The content of the newest version again changes nothing and returns its version.

        Raises
        ------
        NotFoundError
            The section is unknown.
        """
        serialise(self.connection, Subject.TRACKS)
        self.section(alignment.section)
        packed = pack_alignment(alignment)
        digest = hashlib.sha256(packed).hexdigest()
        newest = self.connection.execute(
            select(ALIGNMENTS.c.version, ALIGNMENTS.c.content_digest)
            .where(ALIGNMENTS.c.section == alignment.section)
            .order_by(ALIGNMENTS.c.version.desc())
            .limit(1)
        ).first()
        if newest is not None and newest.content_digest == digest:
            return int(newest.version)
        version = 1 if newest is None else int(newest.version) + 1
        self.connection.execute(
            insert(ALIGNMENTS).values(
                section=alignment.section,
                version=version,
                status=str(alignment.status),
                points=len(alignment.s),
                content_digest=digest,
                packed=packed,
            )
        )
        return version

    def _sections(self, statement: Select[Any]) -> Sequence[TrackSectionRecord]:
        return [TrackSectionRecord(*row) for row in self.connection.execute(statement)]
