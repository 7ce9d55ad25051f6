"""Windows that stages have not made from what they are now: a row only as long as a window is due."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, bindparam, delete, func, literal, select, tuple_
from sqlalchemy.dialects import postgresql, sqlite

from estimation.values.subjects import Due, Mark, StageInputs, WindowFact
from estimation.values.windows import key_of_text, text_of_key
from fleet_db.rows import table_of
from fleet_db.tables import DueWindowRow, WindowRow

DUE, WINDOWS = table_of(DueWindowRow), table_of(WindowRow)
LISTENERS: Mapping[WindowFact, tuple[str, ...]] = {}
"""Stages by the fact of a window after which they look at it."""


@dataclass(frozen=True, slots=True)
class DueWindowStore:
    """The only statements on ``due_windows``, in one transaction."""

    connection: Connection

    def changed(self, fact: WindowFact, windows: ColumnElement[bool]) -> None:
        """List windows for the stages that look at them after a fact, of which they have not seen what they are now.

        Args:
            windows: Condition on the windows; only those with samples are listed.
        """
        for stage in LISTENERS.get(fact, ()):
            self.list_for(stage, windows)

    def list_for(self, stage: str, windows: ColumnElement[bool] | None = None) -> None:
        """List windows with samples for a stage; None is all of them."""
        chosen = [WINDOWS.c.samples_purged_ns.is_(None), *([] if windows is None else [windows])]
        columns = (literal(stage), WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.vehicle)
        section, first = func.coalesce(WINDOWS.c.track_section, ""), literal(1)
        rows = select(*columns, section, first).where(*chosen).order_by(WINDOWS.c.wheelset, WINDOWS.c.start_ns)
        insert = (postgresql if self.connection.dialect.name == "postgresql" else sqlite).insert(DUE)
        listed = insert.from_select([column.name for column in DUE.columns], rows)
        again = {"version": DUE.c.version + 1, "vehicle": listed.excluded.vehicle, "section": listed.excluded.section}
        self.connection.execute(
            listed.on_conflict_do_update(index_elements=["stage", "wheelset", "start_ns"], set_=again)
        )

    def due(self, inputs: StageInputs, keys: Collection[str] | None = None) -> Mapping[str, Due]:
        """Return the windows that are due by key, in the order of vehicle, time and wheelset."""
        statement = select(DUE).where(DUE.c.stage == inputs.stage)
        if keys is not None:
            statement = statement.where(tuple_(DUE.c.wheelset, DUE.c.start_ns).in_([key_of_text(key) for key in keys]))
        rows = self.connection.execute(statement.order_by(DUE.c.vehicle, DUE.c.start_ns, DUE.c.wheelset))
        return {text_of_key(row.wheelset, row.start_ns): Due(row.version) for row in rows}

    def note(self, inputs: StageInputs, marks: Mapping[str, Mark]) -> None:
        """Forget windows that a stage has seen, but those that were listed again meanwhile."""
        names = ("wheelset", "start_ns", "version")
        seen = [dict(zip(names, (*key_of_text(key), mark.seen), strict=True)) for key, mark in marks.items()]
        if seen:
            same = (DUE.c[name] == bindparam(f"of_{name}") for name in names)
            given = [{f"of_{name}": value for name, value in one.items()} for one in seen]
            self.connection.execute(delete(DUE).where(DUE.c.stage == inputs.stage, *same), given)
