"""Track sections, versions of their alignment and of their layout."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy import Connection, Select, and_, delete, exists, func, insert, select, update

from estimation.errors import ConflictError
from estimation.values.runs import Facet, SubjectKind
from estimation.values.track import (
    AlignmentRecord,
    AlignmentSource,
    SectionStanding,
    TrackAlignment,
    TrackLayout,
    TrackReport,
    TrackSectionRecord,
)
from estimation.values.windows import WindowKey, WindowPosition
from fleet_db.locks import Subject, serialise
from fleet_db.packed_values import pack_alignment, pack_layout, unpack_alignment, unpack_layout
from fleet_db.records import Decision, RecordAction, RecordKind
from fleet_db.rows import (
    batches,
    columns_of,
    equal,
    given,
    keys_given,
    null_if_nan,
    present,
    put_rows,
    row_of,
    same_window,
    table_of,
    upsert,
    value_of_row,
)
from fleet_db.stores.assembled import make_stale
from fleet_db.stores.registry_history import RecordKey, RegistryHistoryStore
from fleet_db.stores.track_epochs import EpochStore
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.track import (
    TrackAlignmentRow,
    TrackEpochRow,
    TrackLayoutRow,
    TrackReportRow,
    TrackSectionRow,
    TrackVersionRow,
    WindowPositionRow,
)
from fleet_db.tables.windows import WindowRow

LAYOUTS = table_of(TrackLayoutRow)
SECTIONS, ALIGNMENTS, VERSIONS = table_of(TrackSectionRow), table_of(TrackAlignmentRow), table_of(TrackVersionRow)
EPOCHS = table_of(TrackEpochRow)
REPORTS, POSITIONS, WINDOWS = table_of(TrackReportRow), table_of(WindowPositionRow), table_of(WindowRow)
OF_WINDOWS = select(POSITIONS).where(keys_given(POSITIONS))
SAME_VERSION = and_(VERSIONS.c.section == ALIGNMENTS.c.section, VERSIONS.c.version == ALIGNMENTS.c.version)
STANDS = VERSIONS.c.superseded_ns.is_(None)  # a registered one has no row there
SOURCE = func.coalesce(VERSIONS.c.source, AlignmentSource.RECORDED)
RECORDS = select(
    ALIGNMENTS.c.section,
    ALIGNMENTS.c.version,
    ALIGNMENTS.c.status,
    ALIGNMENTS.c.points,
    SOURCE.label("source"),
    func.coalesce(VERSIONS.c.same_since, ALIGNMENTS.c.version).label("same_since"),
    VERSIONS.c.cut_off_m,
    func.coalesce(VERSIONS.c.scale_std, 0.0).label("scale_std"),
    func.coalesce(VERSIONS.c.gauge_known, True).label("gauge_known"),
    VERSIONS.c.alignment_std_m,
    VERSIONS.c.recorded_ns,
    VERSIONS.c.superseded_ns,
).select_from(ALIGNMENTS.outerjoin(VERSIONS, SAME_VERSION))


@dataclass(frozen=True, slots=True)
class TrackStore:
    """Track sections and versions of their alignment."""

    connection: Connection
    subjects: Subjects
    once: ReadOnce = field(default_factory=ReadOnce)

    def sections(self) -> Sequence[TrackSectionRecord]:
        """Return all sections by code; one that was voided has no number of a bus and is none."""
        statement = select(SECTIONS).where(SECTIONS.c.number > 0).order_by(SECTIONS.c.code)
        return self.once.one("sections", None, partial(self._sections, statement))

    def section(self, code: str) -> TrackSectionRecord:
        """Return one section; raises NotFoundError."""
        sections = self._sections(select(SECTIONS).where(SECTIONS.c.code == code, SECTIONS.c.number > 0))
        return present(next(iter(sections), None), "track section", code)

    def section_by_number(self, number: int) -> TrackSectionRecord | None:
        """Return the section that vehicles call ``number``."""
        return next(iter(self._sections(select(SECTIONS).where(SECTIONS.c.number == number))), None)

    def add_section(self, record: TrackSectionRecord, recorded_ns: int | None = None) -> None:
        """Add or change a section and assemble windows again; ConflictError: another section has its number."""
        serialise(self.connection, Subject.TRACKS)
        other = self.section_by_number(record.number)
        if other is not None and other.code != record.code:
            reason = f"track section {other.code!r} already has number {record.number}"
            raise ConflictError(reason, kind="track section", key=record.code)
        was = row_of(self.connection, SECTIONS, record.code)
        line = None if record.line is None else [list(point) for point in record.line]  # as JSON has it
        if upsert(self.connection, SECTIONS, asdict(record) | {"line": line}):
            history = RegistryHistoryStore(self.connection, self.subjects)
            before = None if was is None or was["number"] <= 0 else was
            key, decision = RecordKey(RecordKind.SECTION, record.code), Decision(recorded_ns=recorded_ns)
            history.note_change(key, before, None, decision)
        if was is None or was["number"] != record.number:
            make_stale(self.connection, record.code, f"number of track section {record.code}", elsewhere=True)
        elif was["line"] != line:
            make_stale(self.connection, record.code, f"coordinates of track section {record.code}", elsewhere=False)

    def alignment(self, section: str, version: int | None = None) -> TrackAlignment | None:
        """Return one version of the alignment of a section, or the one in force."""
        return self.once.one("alignment", (section, version), partial(self._alignment, section, version))

    def _alignment(self, section: str, version: int | None) -> TrackAlignment | None:
        statement = select(ALIGNMENTS.c.version, ALIGNMENTS.c.packed).where(ALIGNMENTS.c.section == section)
        if version is not None:
            statement = statement.where(ALIGNMENTS.c.version == version)
        else:
            statement = statement.select_from(ALIGNMENTS.outerjoin(VERSIONS, SAME_VERSION)).where(STANDS)
        row = self.connection.execute(statement.order_by(ALIGNMENTS.c.version.desc()).limit(1)).first()
        if row is None:
            return None
        return unpack_alignment(row.packed, row.version, where=f"alignment {row.version} of track section {section!r}")

    def add_alignment(
        self, alignment: TrackAlignment, *, same_since: int | None = None, recorded_ns: int | None = None
    ) -> int:
        """Store an alignment as the next version of its section and return that; ``alignment.version`` is not read.

        The content of the newest version again changes nothing and returns its version; of a registered one, that of
        the newest that was registered: it does not come before what the fleet has found since, on it or without it.
        Without a time it counts as registered by the operator. ``same_since`` is the oldest version from which it does
        not differ materially, itself where left out.
        """
        serialise(self.connection, Subject.TRACKS)
        self.section(alignment.section)
        packed = pack_alignment(alignment)
        digest = hashlib.sha256(packed).hexdigest()
        of_section = ALIGNMENTS.c.section == alignment.section
        comparable = VERSIONS.c.version.is_(None) if recorded_ns is None else STANDS
        newest = self.connection.execute(
            select(ALIGNMENTS.c.version, ALIGNMENTS.c.content_digest)
            .select_from(ALIGNMENTS.outerjoin(VERSIONS, SAME_VERSION))
            .where(of_section, comparable)
            .order_by(ALIGNMENTS.c.version.desc())
            .limit(1)
        ).first()
        if newest is not None and newest.content_digest == digest:
            return int(newest.version)
        version = 1 + (self.connection.scalar(select(func.max(ALIGNMENTS.c.version)).where(of_section)) or 0)
        values = {"section": alignment.section, "version": version}
        content = {"points": len(alignment.s), "content_digest": digest, "packed": packed}
        self.connection.execute(insert(ALIGNMENTS).values(**values, status=str(alignment.status), **content))
        if recorded_ns is not None:
            std = alignment.alignment_std[np.isfinite(alignment.alignment_std)]
            of_version = {
                "source": alignment.source,
                "same_since": version if same_since is None else same_since,
                "cut_off_m": float(alignment.cutoff_wavelength) if np.isfinite(alignment.cutoff_wavelength) else None,
                "scale_std": float(alignment.scale_std),
                "gauge_known": bool(alignment.gauge_known),
                "alignment_std_m": null_if_nan(float(np.median(std))) if len(std) else None,
                "recorded_ns": recorded_ns,
            }
            self.connection.execute(insert(VERSIONS).values(**values, **of_version))
        self.subjects.raised(SubjectKind.SECTION, alignment.section, Facet.ALIGNMENT)
        return version

    def in_force(self, section: str) -> AlignmentRecord | None:
        """Return which version of a section's alignment is in force: the newest not superseded; without arrays."""
        standing = RECORDS.where(ALIGNMENTS.c.section == section, STANDS)
        row = self.connection.execute(standing.order_by(ALIGNMENTS.c.version.desc()).limit(1)).first()
        return None if row is None else _alignment_record(row)

    def standings(self) -> Mapping[str, SectionStanding]:
        """Return by code which versions each section has that has some: a few statements for all."""
        return self.once.one("standings", None, self._standings)

    def _standings(self) -> Mapping[str, SectionStanding]:
        newest = select(ALIGNMENTS.c.section, func.max(ALIGNMENTS.c.version).label("version"))
        newest = newest.select_from(ALIGNMENTS.outerjoin(VERSIONS, SAME_VERSION)).group_by(ALIGNMENTS.c.section)
        standing = newest.where(STANDS).subquery()
        same = and_(standing.c.section == ALIGNMENTS.c.section, standing.c.version == ALIGNMENTS.c.version)
        rows = self.connection.execute(RECORDS.where(exists().where(same)))
        in_force = {row.section: _alignment_record(row) for row in rows}
        registered = {
            row.section: row.version for row in self.connection.execute(newest.where(VERSIONS.c.version.is_(None)))
        }
        latest = select(LAYOUTS.c.section, func.max(LAYOUTS.c.version).label("version")).group_by(LAYOUTS.c.section)
        layouts = {row.section: row.version for row in self.connection.execute(latest)}
        return {
            code: SectionStanding(in_force.get(code), registered.get(code), layouts.get(code))
            for code in sorted({*in_force, *registered, *layouts})
        }

    def registered(self, section: str) -> int | None:
        """Return the newest version of the alignment of a section that the operator registered; None without one."""
        version: int | None = self.connection.scalar(_registered(section))
        return version

    def same_content(self, section: str, version: int, alignment: TrackAlignment, same_since: int) -> bool:
        """Whether a version stands, was estimated, and has this content and this oldest version like it."""
        statement = select(ALIGNMENTS.c.content_digest).join_from(ALIGNMENTS, VERSIONS, SAME_VERSION)
        key = (ALIGNMENTS.c.section == section, ALIGNMENTS.c.version == version)
        stored = self.connection.scalar(statement.where(*key, STANDS, VERSIONS.c.same_since == same_since))
        return stored is not None and stored == hashlib.sha256(pack_alignment(alignment)).hexdigest()

    def supersede(self, section: str, kept: Collection[int], recorded_ns: int) -> int:
        """Mark a section's estimated versions but for those kept as superseded: they stay for what they made."""
        gone = (VERSIONS.c.section == section, STANDS, VERSIONS.c.version.not_in(sorted(kept)))
        count = int(self.connection.execute(update(VERSIONS).where(*gone).values(superseded_ns=recorded_ns)).rowcount)
        if count:
            self.subjects.raised(SubjectKind.SECTION, section, Facet.ALIGNMENT)
        return count

    def versions(self, section: str, after: int | None, limit: int) -> Sequence[AlignmentRecord]:
        """Return at most ``limit`` versions of a section behind version ``after``, oldest first."""
        statement = RECORDS.where(ALIGNMENTS.c.section == section, *given(after, ALIGNMENTS.c.version.__gt__))
        rows = self.connection.execute(statement.order_by(ALIGNMENTS.c.version).limit(limit))
        return [_alignment_record(row) for row in rows]

    def report(self, section: str, version: int | None = None) -> TrackReport | None:
        """Return the report of the last epoch of a section, or the one of the run that made ``version``."""
        statement = select(REPORTS).where(REPORTS.c.section == section)
        if version is not None:
            statement = statement.where(REPORTS.c.version == version, REPORTS.c.made)
        else:
            last = select(EPOCHS.c.report).where(EPOCHS.c.section == section).order_by(EPOCHS.c.number.desc()).limit(1)
            statement = statement.where(*equal(REPORTS, report_id=self.connection.scalar(last)))
        row = self.connection.execute(statement.order_by(REPORTS.c.report_id.desc()).limit(1)).first()
        return None if row is None else value_of_row(TrackReport, row)

    def add_report(self, report: TrackReport) -> int:
        """Append what a run found of a section; return its number."""
        serialise(self.connection, Subject.TRACKS)
        statement = insert(REPORTS).values(columns_of(report, "report_id")).returning(REPORTS.c.report_id)
        return int(self.connection.execute(statement).scalar_one())

    def position(self, wheelset: str, start_ns: int) -> WindowPosition | None:
        """Return where a window was, if that has been looked at."""
        return self.positions([(wheelset, start_ns)]).get((wheelset, start_ns))

    def positions(self, keys: Sequence[WindowKey]) -> Mapping[WindowKey, WindowPosition]:
        """Return by wheelset and start where those of some windows were that have been looked at."""
        rows = (row for some in batches(keys) for row in self.connection.execute(OF_WINDOWS, {"keys": some}))
        return {(row.wheelset, row.start_ns): value_of_row(WindowPosition, row) for row in rows}

    def put_positions(self, positions: Sequence[WindowPosition]) -> Mapping[WindowKey, WindowPosition | None]:
        """Store where windows were, in the place of what was known; return that of those of which it has changed."""
        by_key = {(position.wheelset, position.start_ns): position for position in positions}
        before = self.positions(list(by_key))
        changed = {key: position for key, position in by_key.items() if before.get(key) != position}
        put_rows(self.connection, POSITIONS, [columns_of(changed[key]) for key in sorted(changed)])
        return {key: before.get(key) for key in changed}

    def forget_positions_of(self, keys: Sequence[WindowKey]) -> None:
        """Forget where some windows were."""
        on = select(WINDOWS.c.track_section).where(keys_given(WINDOWS))
        for some in batches(keys):
            for section in self.connection.scalars(on, {"keys": some}):
                self.subjects.places(section)
            self.connection.execute(delete(POSITIONS).where(keys_given(POSITIONS)), {"keys": some})

    def forget_positions(self, section: str) -> int:
        """Forget where a section's windows were, and compute its epochs from the first; return of how many."""
        EpochStore(self.connection, self.subjects).start_again(section)
        of_section = exists().where(same_window(WINDOWS, POSITIONS), WINDOWS.c.track_section == section)
        return int(self.connection.execute(delete(POSITIONS).where(of_section)).rowcount)

    def layout(self, section: str, version: int | None = None) -> TrackLayout | None:
        """Return one version of the layout of a section, or the newest; None where there is none."""
        version = self.layout_version(section) if version is None else version
        if version is None:
            return None
        return self.once.one("layout", (section, version), partial(self._layout, section, version))

    def _layout(self, section: str, version: int) -> TrackLayout | None:
        packed = self.connection.scalar(
            select(LAYOUTS.c.packed).where(*equal(LAYOUTS, section=section, version=version))
        )
        where = f"layout {version} of track section {section!r}"
        return None if packed is None else unpack_layout(packed, version, where=where)

    def given(self, section: str) -> tuple[int | None, int | None]:
        """Return the versions of a section's alignment and layout as :meth:`registered` and :meth:`layout_version`."""
        layout = select(func.max(LAYOUTS.c.version)).where(LAYOUTS.c.section == section)
        row = self.connection.execute(select(_registered(section).scalar_subquery(), layout.scalar_subquery())).one()
        self.once.remember("layout version", {section: (row[1],)})
        return row[0], row[1]

    def layout_version(self, section: str) -> int | None:
        """Return the newest version of the layout of a section without reading it; None where there is none."""
        newest = select(func.max(LAYOUTS.c.version)).where(LAYOUTS.c.section == section)
        return self.once.one("layout version", section, partial(self.connection.scalar, newest))

    def add_layout(self, layout: TrackLayout) -> int:
        """Store a layout as the next version and return that; the content of the newest again changes nothing."""
        serialise(self.connection, Subject.TRACKS)
        self.section(layout.section)
        packed = pack_layout(layout)
        digest = hashlib.sha256(packed).hexdigest()
        of_section = select(LAYOUTS.c.version, LAYOUTS.c.content_digest).where(LAYOUTS.c.section == layout.section)
        newest = self.connection.execute(of_section.order_by(LAYOUTS.c.version.desc()).limit(1)).first()
        if newest is not None and newest.content_digest == digest:
            return int(newest.version)
        version = 1 if newest is None else int(newest.version) + 1
        content = {"points": len(layout.s), "content_digest": digest, "packed": packed}
        self.connection.execute(insert(LAYOUTS).values(section=layout.section, version=version, **content))
        self.subjects.section_on_file(layout.section)
        return version

    def _sections(self, statement: Select[Any]) -> Sequence[TrackSectionRecord]:
        return [TrackSectionRecord(*row) for row in self.connection.execute(statement)]


def _registered(section: str) -> Select[Any]:
    return (
        select(func.max(ALIGNMENTS.c.version))
        .select_from(ALIGNMENTS.outerjoin(VERSIONS, SAME_VERSION))
        .where(ALIGNMENTS.c.section == section, VERSIONS.c.version.is_(None))
    )


def _alignment_record(row: Any) -> AlignmentRecord:  # noqa: ANN401 - a row of RECORDS
    return value_of_row(AlignmentRecord, row, cut_off_m=np.inf if row.cut_off_m is None else row.cut_off_m)


def free_numbers(history: RegistryHistoryStore, records: Sequence[TrackSectionRecord], recorded_ns: int | None) -> None:
    """Give up the numbers of sections that will get another one: sections may exchange theirs."""
    connection = history.connection
    serialise(connection, Subject.TRACKS)
    for record in records:
        was = connection.execute(select(SECTIONS).where(SECTIONS.c.code == record.code)).mappings().first()
        if was is not None and was["number"] > 0 and was["number"] != record.number:
            key, decision = RecordKey(RecordKind.SECTION, record.code), Decision(recorded_ns=recorded_ns)
            history.note(key, RecordAction.CHANGED, dict(was), decision)
            give_up_number(connection, record.code)


def give_up_number(connection: Connection, code: str) -> None:
    """Give a section a number that is on no bus."""
    lowest = connection.scalar(select(func.min(SECTIONS.c.number))) or 0
    connection.execute(update(SECTIONS).where(SECTIONS.c.code == code).values(number=min(lowest, 0) - 1))
