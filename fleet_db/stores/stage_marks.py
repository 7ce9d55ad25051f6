"""What each stage has seen of its subjects, and which of them are others by now."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Insert,
    Select,
    and_,
    bindparam,
    delete,
    false,
    func,
    literal,
    or_,
    select,
)
from sqlalchemy.dialects import postgresql, sqlite

from estimation.values.runs import SubjectKind
from estimation.values.subjects import EVERYTHING, Due, Mark, StageInputs
from fleet_db.due import WindowDueStore, list_for_settings
from fleet_db.rows import table_of
from fleet_db.subjects import VERSIONS, Subjects
from fleet_db.tables import StageMarkRow

MARKS = table_of(StageMarkRow)
SUM = func.sum(VERSIONS.c.version)


@dataclass(frozen=True, slots=True)
class StageMarkStore:
    """Implements ``estimation.storage.Marks``."""

    connection: Connection
    subjects: Subjects
    windows: WindowDueStore

    def due(self, inputs: StageInputs, now_ns: int, subjects: Collection[str] | None = None) -> Mapping[str, Due]:
        """Return what a stage has not seen as it is now, by subject, in their order; one statement.

        It is due where versions or settings are others, and where the time that its mark names has come.

        Args:
            subjects: Only of these; None is all.
        """
        self.subjects.flush()
        if inputs.kind is SubjectKind.WINDOW:
            return self.windows.due(inputs, subjects)
        if not inputs.facets:
            return self.windows.wheelsets(inputs, subjects)
        rows = self.connection.execute(_due(inputs, now_ns, subjects))
        return {
            row.subject: Due(
                seen=int(row.now),
                made_from=None if row.come else row.made_from,
                marked=row.made_from is not None,
                again_ns=row.again_ns,
            )
            for row in rows
        }

    def count(self, stage: str) -> int:
        """Return how many subjects a stage has seen."""
        return self.connection.scalar(select(func.count()).where(MARKS.c.stage == stage)) or 0

    def note(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        """Note what a stage has seen of subjects; what this transaction raises of its inputs is seen where it rests."""
        if inputs.kind is SubjectKind.WINDOW:
            self.windows.note(inputs, marks)
        elif inputs.facets:
            self._put(inputs, marks)

    def has_settings(self, inputs: StageInputs) -> bool:
        """Return whether a stage that works window by window has looked at all windows with these settings."""
        chosen = (MARKS.c.stage == inputs.stage, MARKS.c.subject == EVERYTHING, MARKS.c.common == inputs.common)
        return self.connection.execute(select(MARKS.c.seen).where(*chosen)).first() is not None

    def list_again(self, inputs: StageInputs) -> None:
        """Let a stage look at the windows that its settings concern."""
        list_for_settings(self.connection, inputs.stage)
        self._put(inputs, {EVERYTHING: Mark(0, "", rests=False)})

    def _put(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        rows = [
            {
                "stage": inputs.stage,
                "subject": subject,
                "seen": mark.seen + (self._raised(inputs, subject) if mark.rests else 0),
                "common": inputs.common,
                "made_from": mark.made_from,
                "again_ns": mark.again_ns,
            }
            for subject, mark in sorted(marks.items())
        ]
        if rows:
            self.connection.execute(_note(self.connection.dialect.name), rows)

    def forget(self, stage: str, subjects: Collection[str]) -> None:
        """Let a stage compute again of these subjects: what it made of them is damaged."""
        self.connection.execute(delete(MARKS).where(MARKS.c.stage == stage, MARKS.c.subject.in_(subjects)))

    def _raised(self, inputs: StageInputs, subject: str) -> int:
        return self.subjects.growth(inputs.facets, None if inputs.together else (inputs.kind, subject))


def _due(inputs: StageInputs, now_ns: int, subjects: Collection[str] | None) -> Select[Any]:
    subject: ColumnElement[str] = literal(EVERYTHING) if inputs.together else VERSIONS.c.subject
    of_stage = and_(MARKS.c.stage == inputs.stage, MARKS.c.subject == subject)
    come = and_(MARKS.c.again_ns.is_not(None), MARKS.c.again_ns <= now_ns)
    marked = (MARKS.c.seen, MARKS.c.common, MARKS.c.made_from, MARKS.c.again_ns)
    columns = (subject.label("subject"), SUM.label("now"), MARKS.c.made_from, MARKS.c.again_ns)
    statement = select(*columns, func.coalesce(come, false()).label("come")).select_from(
        VERSIONS.outerjoin(MARKS, of_stage)
    )
    statement = statement.where(VERSIONS.c.facet.in_(inputs.facets))
    if not inputs.together:
        statement = statement.where(VERSIONS.c.kind == inputs.kind.value)
        if subjects is not None:
            statement = statement.where(VERSIONS.c.subject.in_(subjects))
    changed: ColumnElement[bool] = MARKS.c.common != inputs.common
    if not inputs.inline:
        changed = or_(MARKS.c.seen.is_(None), MARKS.c.seen != SUM, MARKS.c.common != inputs.common, come)
    if inputs.together:
        return statement.group_by(*marked).having(changed)
    return statement.group_by(VERSIONS.c.subject, *marked).having(changed).order_by(VERSIONS.c.subject)


@cache
def _note(dialect: str) -> Insert:
    names = [column.name for column in MARKS.columns]
    insert = (postgresql if dialect == "postgresql" else sqlite).insert(MARKS)
    noted = insert.values({name: bindparam(name) for name in names})
    changed = {name: noted.excluded[name] for name in names if name not in {"stage", "subject"}}
    statement: Insert = noted.on_conflict_do_update(index_elements=["stage", "subject"], set_=changed)
    return statement
