"""What the alignment job has to look at: windows that no epoch holds as they are now, and epochs that have lost some.

A window that is new or changed is listed (``fleet_db.due``). An epoch is stale when a window that it holds has gone, or
where that was has been forgotten; both are said in the transaction that changes the window.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, bindparam, select, tuple_, update

from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.windows import DueStage, WindowKey
from fleet_db.due import BATCH, list_due
from fleet_db.rows import table_of
from fleet_db.subjects import Subjects
from fleet_db.tables.track import TrackEpochRow, TrackEpochWindowRow, WindowPositionRow
from fleet_db.tables.windows import WindowRow

EPOCHS, MEMBERS, WINDOWS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow), table_of(WindowRow)
POSITIONS = table_of(WindowPositionRow)
OF_WINDOW = and_(MEMBERS.c.wheelset == WINDOWS.c.wheelset, MEMBERS.c.start_ns == WINDOWS.c.start_ns)
PLACED = and_(
    POSITIONS.c.wheelset == MEMBERS.c.wheelset,
    POSITIONS.c.start_ns == MEMBERS.c.start_ns,
    POSITIONS.c.content_digest == MEMBERS.c.content_digest,
)
OF_EPOCH = (MEMBERS.c.section, MEMBERS.c.epoch)


def come(subjects: Subjects, sections: Mapping[WindowKey, str | None]) -> None:
    """List windows that are new or others now; after they are stored.

    Args:
        sections: That the windows are on, by key; those on none are no concern of an alignment.
    """
    keys = sorted(key for key, section in sections.items() if section is not None)
    for first in range(0, len(keys), BATCH):
        own = tuple_(WINDOWS.c.wheelset, WINDOWS.c.start_ns).in_(keys[first : first + BATCH])
        list_due(subjects.connection, DueStage.ALIGNMENT, own)
    raise_sections(subjects, sections.values())


def raise_sections(subjects: Subjects, sections: Collection[str | None]) -> None:
    """Let the windows of sections have another version; None is no section."""
    for section in set(sections) - {None}:
        subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)


def left(subjects: Subjects, keys: Sequence[WindowKey]) -> None:
    """Let epochs be computed again whose windows are gone or on another section; after these are."""
    _stale(subjects, _left(), keys)


def unplaced(subjects: Subjects, keys: Sequence[WindowKey]) -> None:
    """Let epochs be computed again that have found where some windows were; before that is forgotten."""
    _stale(subjects, _placed(), keys)


def unplaced_where(subjects: Subjects, chosen: ColumnElement[bool]) -> None:
    """Do as :func:`unplaced` for windows that a condition chooses."""
    placed = MEMBERS.join(POSITIONS, PLACED).join(WINDOWS, OF_WINDOW)
    found = subjects.connection.execute(select(*OF_EPOCH).select_from(placed).where(chosen).distinct())
    stale(subjects, [(row.section, row.epoch) for row in found])


def stale(subjects: Subjects, epochs: Sequence[tuple[str, int]]) -> None:
    """Let epochs be computed again, each by section and number."""
    if epochs:
        own = tuple_(EPOCHS.c.section, EPOCHS.c.number).in_(sorted(epochs))
        subjects.connection.execute(update(EPOCHS).where(own).values(stale=True))
    for section in {section for section, _ in epochs}:
        subjects.raised(SubjectKind.SECTION, section, Facet.WINDOWS)


def _stale(subjects: Subjects, statement: Select[Any], keys: Sequence[WindowKey]) -> None:
    ordered, epochs = sorted(keys), set[tuple[str, int]]()
    for first in range(0, len(ordered), BATCH):
        found = subjects.connection.execute(statement, {"keys": ordered[first : first + BATCH]})
        epochs.update((row.section, row.epoch) for row in found)
    stale(subjects, sorted(epochs))


@cache
def _left() -> Select[Any]:
    elsewhere = WINDOWS.c.track_section.is_distinct_from(MEMBERS.c.section)
    return select(*OF_EPOCH).select_from(MEMBERS.outerjoin(WINDOWS, OF_WINDOW)).where(_given(), elsewhere).distinct()


@cache
def _placed() -> Select[Any]:
    return select(*OF_EPOCH).select_from(MEMBERS.join(POSITIONS, PLACED)).where(_given()).distinct()


def _given() -> ColumnElement[bool]:
    return tuple_(MEMBERS.c.wheelset, MEMBERS.c.start_ns).in_(bindparam("keys", expanding=True))
