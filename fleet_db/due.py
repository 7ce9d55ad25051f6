"""Windows that a stage has not made from what they are now.

A row exists for as long as its window is due. Listing a window again raises its version, so that a stage removes only
what it has seen. A window that is gone stays listed until the stage has seen that.

For the alignment an epoch is stale as well when a window that it holds has gone, or where that was has been forgotten.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Delete,
    Insert,
    Select,
    String,
    and_,
    bindparam,
    delete,
    exists,
    func,
    literal,
    literal_column,
    or_,
    select,
    true,
    tuple_,
    union_all,
    update,
)

from estimation.values.opinions import CREEP
from estimation.values.quantities import Status
from estimation.values.runs import FAILED, Due, Facet, Mark, StageInputs, SubjectKind
from estimation.values.signatures import OF_OTHERS, SIGNATURES
from estimation.values.track import AlignmentSource
from estimation.values.windows import DueStage, WindowKey, WindowState, key_of_text, text_of_key
from fleet_db.rows import batches, equal, given, grouped, insert_of, reason_columns, same_window, table_of, window_key
from fleet_db.subjects import REGISTRY_VERSION, ReadOnce, Subjects
from fleet_db.tables.track import (
    TrackAlignmentRow,
    TrackEpochRow,
    TrackEpochWindowRow,
    TrackVersionRow,
    WindowPositionRow,
)
from fleet_db.tables.windows import PENDING, WearSignatureRow, WindowAdhesionRow, WindowDueRow, WindowRow

DUE, WINDOWS = table_of(WindowDueRow), table_of(WindowRow)
WINDOW_KEY = window_key(WINDOWS)
OF_WINDOWS = table_of(WearSignatureRow)
SAME_WINDOW = same_window(OF_WINDOWS, WINDOWS)
OF_CREEP = table_of(WindowAdhesionRow)
_LOOKED_AT = select(OF_CREEP.c.with_sums).where(same_window(OF_CREEP, WINDOWS, "content_digest"))
NOT_LOOKED_AT = and_(
    WINDOWS.c.state == WindowState.ESTIMATED.value,
    WINDOWS.c.samples_purged_ns.is_(None),
    WINDOWS.c.track_section.is_not(None),
    ~_LOOKED_AT.exists(),
)
"""Condition on estimated windows on a section whose creep, of these samples, has not been looked at."""
OF_SAMPLES = (SIGNATURES, DueStage.TABLES, DueStage.MILEAGES)
"""Stages that read samples, or what is stored with them."""
POSITIONS, ALIGNMENTS, VERSIONS = table_of(WindowPositionRow), table_of(TrackAlignmentRow), table_of(TrackVersionRow)
NAMED: ColumnElement[str] = literal_column("stages.stage", String)
"""Stage that a window is listed for, in conditions that are of some stages alone."""
IS_PENDING = and_(PENDING)  # word for word that of the index: a parameter would keep SQLite from it
PLACED = exists().where(same_window(POSITIONS, WINDOWS, "content_digest"))
"""Condition that the position of a window was found from its samples."""


@dataclass(frozen=True, slots=True)
class WindowDueStore:
    """The due windows of every stage, in one transaction."""

    connection: Connection
    once: ReadOnce = field(default_factory=ReadOnce)

    def of_wheelset(self, stage: DueStage, wheelset: str) -> Mapping[int, int]:
        """Return start and version of the due windows of a wheelset, oldest first."""

        def read(some: Collection[str]) -> Mapping[str, Sequence[tuple[int, int]]]:
            statement = select(DUE).where(DUE.c.stage == stage.value, DUE.c.wheelset.in_(some))
            rows = self.connection.execute(statement.order_by(DUE.c.start_ns))
            return grouped(rows, lambda row: (row.start_ns, row.version))

        return dict(self.once.of_wheelset(f"due {stage}", wheelset, read) or ())

    def of_section(self, stage: str, section: str, until_ns: int | None = None) -> Mapping[WindowKey, int]:
        """Return the due windows of a section, up to a start, with their versions."""
        of_section = [*equal(DUE, stage=stage, section=section), *given(until_ns, DUE.c.start_ns.__le__)]
        statement = select(DUE).where(*of_section)
        return {(row.wheelset, row.start_ns): row.version for row in self.connection.execute(statement)}

    def remove_seen(self, stage: str, seen: Mapping[WindowKey, int]) -> None:
        """Remove windows that are of the versions that were seen: those that were listed again since stay due."""
        names = ("of_stage", "of_wheelset", "of_start_ns", "of_version")
        if seen:
            rows = [dict(zip(names, (stage, *key, version), strict=True)) for key, version in sorted(seen.items())]
            self.connection.execute(_removal(), rows)

    def due(self, inputs: StageInputs, keys: Collection[str] | None = None) -> Mapping[str, Due]:
        """Return the windows, some or all, that are due by key as text, in the order of vehicle, time and wheelset."""
        statement = select(DUE, REGISTRY_VERSION.label("registry")).where(DUE.c.stage == inputs.stage)
        if inputs.stage == DueStage.TABLES:
            ready = or_(DUE.c.section.not_in(_aligned_by_fleet()), PLACED, WINDOWS.c.state.is_(None))
            statement = statement.outerjoin(WINDOWS, same_window(WINDOWS, DUE)).where(ready)
        if keys is not None:
            statement = statement.where(window_key(DUE).in_([key_of_text(key) for key in keys]))
        rows = self.connection.execute(statement.order_by(DUE.c.vehicle, DUE.c.start_ns, DUE.c.wheelset))
        return {text_of_key(row.wheelset, row.start_ns): Due(row.version, registry=row.registry) for row in rows}

    def list_again(self, stage: str, keys: Sequence[WindowKey]) -> None:
        """Let windows be due still whose entries a stage is about to remove."""
        _list_keys(self.connection, (stage,), keys)

    def note(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        """Remove windows that a stage has seen, but those that were listed again since."""
        self.remove_seen(inputs.stage, {key_of_text(key): mark.seen for key, mark in marks.items()})


def list_due(connection: Connection, stage: str, chosen: ColumnElement[bool], **given: Any) -> None:  # noqa: ANN401
    """List windows on which a condition holds as due, in the transaction that changes them; before it removes them."""
    connection.execute(_listed(connection.dialect.name, (stage,), chosen), given)


def list_to_estimate(connection: Connection, chosen: ColumnElement[bool]) -> None:
    """Let windows with samples wait to be estimated again on which a condition holds, whatever their states."""
    waits = and_(chosen, WINDOWS.c.samples_purged_ns.is_(None))
    _let_wait(connection, waits)
    list_due(connection, DueStage.TABLES, waits)


def list_for_settings(connection: Connection, stage: str) -> None:
    """Let a stage that works window by window look at the windows with samples that other settings concern.

    A bin table carries what it was made with: those that wait are listed, and those at which the estimation failed.
    """
    if stage == DueStage.TABLES:
        failed = and_(WINDOWS.c.reason_code.in_([code.value for code in FAILED]), is_due(DueStage.TABLES, WINDOWS))
        _let_wait(connection, and_(failed, WINDOWS.c.samples_purged_ns.is_(None)))
        list_due(connection, stage, IS_PENDING)
    else:
        list_due(connection, stage, WINDOWS.c.samples_purged_ns.is_(None))


def list_waiting(connection: Connection, keys: Sequence[WindowKey]) -> None:
    """List windows whose state says now that they wait to be estimated.

    Those that are listed keep their version: what has failed is tried again when its time has come.
    """
    _list_keys(connection, (DueStage.TABLES,), keys, raised=False)


def windows_changed(connection: Connection, keys: Sequence[WindowKey], stages: Sequence[str] = OF_SAMPLES) -> None:
    """List windows that are new, or have other samples, for the stages that read these."""
    _list_keys(connection, stages, keys)


def _let_wait(connection: Connection, chosen: ColumnElement[bool]) -> None:
    pending = {"state": WindowState.PENDING.value, **reason_columns(None)}
    connection.execute(update(WINDOWS).where(chosen, WINDOWS.c.state != WindowState.PENDING.value).values(pending))


def _list_keys(
    connection: Connection, stages: Sequence[str], keys: Sequence[WindowKey], *, raised: bool = True
) -> None:
    for some in batches(keys):
        chosen = and_(WINDOW_KEY.in_(some), WINDOWS.c.samples_purged_ns.is_(None))
        connection.execute(_listed(connection.dialect.name, stages, chosen, raised=raised))


def estimated(connection: Connection, keys: Sequence[WindowKey], tabled: Collection[WindowKey] = ()) -> None:
    """List windows that are estimated for the stages that read what the windows beside them are needed for.

    Args:
        tabled: Those that are listed to be summed as well.
    """
    to_sum = set(tabled)
    for some in batches(keys):
        summed = WINDOW_KEY.in_([key for key in some if key in to_sum])
        lacked = [code.value for code in OF_OTHERS]
        signed = select(OF_WINDOWS.c.places).where(SAME_WINDOW, OF_WINDOWS.c.reason_code.in_(lacked))
        lacking = and_(NAMED.in_([SIGNATURES]), WINDOWS.c.samples_purged_ns.is_(None), signed.exists())
        looked_at = and_(NAMED.in_([CREEP]), NOT_LOOKED_AT)
        chosen = and_(WINDOW_KEY.in_(some), or_(lacking, looked_at, and_(NAMED.in_([DueStage.SUMS]), summed)))
        connection.execute(_listed(connection.dialect.name, (SIGNATURES, CREEP, DueStage.SUMS), chosen))


def is_due(stage: DueStage, table: Any) -> ColumnElement[bool]:  # noqa: ANN401 - a table with the key of windows
    """Return the condition that the window of a row, with ``wheelset`` and ``start_ns``, is due."""
    return select(DUE.c.version).where(DUE.c.stage == stage.value, same_window(DUE, table)).exists()


def _listed(dialect: str, stages: Sequence[str], chosen: ColumnElement[bool], *, raised: bool = True) -> Insert:
    columns = ("stage", "wheelset", "start_ns", "vehicle", "section", "version")
    named = union_all(*(select(literal(str(stage)).label("stage")) for stage in stages)).subquery("stages")
    windows: Select[Any] = (
        select(
            NAMED,
            WINDOWS.c.wheelset,
            WINDOWS.c.start_ns,
            WINDOWS.c.vehicle,
            func.coalesce(WINDOWS.c.track_section, ""),
            literal(1),
        )
        .select_from(WINDOWS.join(named, true()))
        .where(chosen)
        .order_by(NAMED, WINDOWS.c.wheelset, WINDOWS.c.start_ns)  # one order of row locks
    )
    new = insert_of(dialect, DUE).from_select(columns, windows)
    again = {"version": DUE.c.version + 1, "vehicle": new.excluded.vehicle, "section": new.excluded.section}
    key = list(DUE.primary_key)
    listed: Insert = new.on_conflict_do_nothing(index_elements=key)
    if raised:
        listed = new.on_conflict_do_update(index_elements=key, set_=again)
    return listed


@cache
def _aligned_by_fleet() -> Select[Any]:
    """Return the sections whose alignment in force came from the fleet: windows wait until they are placed.

    Where nothing is known any more, as after a survey that was wrong, they are refused, with the reason.
    """
    same = and_(VERSIONS.c.section == ALIGNMENTS.c.section, VERSIONS.c.version == ALIGNMENTS.c.version)
    newest = select(ALIGNMENTS.c.section, func.max(ALIGNMENTS.c.version).label("version"))
    newest = newest.select_from(ALIGNMENTS.outerjoin(VERSIONS, same)).where(VERSIONS.c.superseded_ns.is_(None))
    in_force = newest.group_by(ALIGNMENTS.c.section).subquery()
    is_in_force = and_(in_force.c.section == ALIGNMENTS.c.section, in_force.c.version == ALIGNMENTS.c.version)
    of_fleet = (ALIGNMENTS.c.status == Status.ESTIMATED.value, VERSIONS.c.source == AlignmentSource.FLEET.value)
    return select(ALIGNMENTS.c.section).join(VERSIONS, same).join(in_force, is_in_force).where(*of_fleet)


@cache
def _removal() -> Delete:
    same = (DUE.c[name] == bindparam(f"of_{name}") for name in ("stage", "wheelset", "start_ns", "version"))
    return delete(DUE).where(*same)


EPOCHS, MEMBERS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow)
OF_WINDOW = same_window(MEMBERS, WINDOWS)
PLACED_MEMBER = same_window(POSITIONS, MEMBERS, "content_digest")
OF_EPOCH = (MEMBERS.c.section, MEMBERS.c.epoch)


def list_for_alignment(subjects: Subjects, sections: Mapping[WindowKey, str | None]) -> None:
    """List windows (by key, with their section or None) that are new or others now; after they are stored."""
    keys = sorted(key for key, section in sections.items() if section is not None)
    for some in batches(keys):
        list_due(subjects.connection, DueStage.ALIGNMENT, WINDOW_KEY.in_(some))
    raise_sections(subjects, sections.values())


def raise_sections(subjects: Subjects, sections: Collection[str | None]) -> None:
    """Let the windows of sections have another version; None is no section."""
    for section in set(sections) - {None}:
        subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)


def windows_left(subjects: Subjects, keys: Sequence[WindowKey]) -> None:
    """Let epochs be computed again whose windows are gone or on another section; after these are."""
    elsewhere = WINDOWS.c.track_section.is_distinct_from(MEMBERS.c.section)
    held = select(*OF_EPOCH).select_from(MEMBERS.outerjoin(WINDOWS, OF_WINDOW)).where(elsewhere).distinct()
    epochs = set[tuple[str, int]]()
    for some in batches(sorted(keys)):
        of_windows = held.where(window_key(MEMBERS).in_(some))
        epochs.update((row.section, row.epoch) for row in subjects.connection.execute(of_windows))
    stale_epochs(subjects, sorted(epochs))


def positions_forgotten(subjects: Subjects, chosen: ColumnElement[bool]) -> None:
    """Let epochs be computed again that have found where some windows were; before that is forgotten."""
    placed = MEMBERS.join(POSITIONS, PLACED_MEMBER).join(WINDOWS, OF_WINDOW)
    epochs = subjects.connection.execute(select(*OF_EPOCH).select_from(placed).where(chosen).distinct())
    stale_epochs(subjects, [(row.section, row.epoch) for row in epochs])


def stale_epochs(subjects: Subjects, epochs: Sequence[tuple[str, int]]) -> None:
    """Let epochs be computed again, each by section and number."""
    if epochs:
        of_epochs = tuple_(EPOCHS.c.section, EPOCHS.c.number).in_(sorted(epochs))
        subjects.connection.execute(update(EPOCHS).where(of_epochs).values(stale=True))
    for section in {section for section, _ in epochs}:
        subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)
