"""Second opinions of a fleet whose windows are all looked at: rows of one wheelset, copied to all.

Signatures, creep forces, dampers, and conicities by section, with what was concluded of them; and the friction of one
section for every section. Packed values have their first ``KEPT_BYTES`` alone: no idle run reads them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Insert, Table, case, func, insert, literal, select

from estimation.jobs import refresh_rails, refresh_signatures
from estimation.jobs.job import JobContext
from estimation.jobs.steps.signature_windows import ASSUMED
from estimation.values.registry import Mounting
from estimation.values.runs import Mark
from estimation.values.units import DAY_NS
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.windows import (
    RailCellRow,
    SectionAdhesionRow,
    WearSignatureRow,
    WindowAdhesionRow,
    WindowDamperRow,
)

KEPT_BYTES = 500
CREEP, DAMPERS = table_of(WindowAdhesionRow), table_of(WindowDamperRow)
SIGNATURES, CELLS = table_of(WearSignatureRow), table_of(RailCellRow)
OF_SECTIONS = ((table_of(SectionAdhesionRow), "track_section"),)


def opinions_copied(mounting: Mounting, model: Mounting, sections: Sequence[str]) -> Iterator[Insert]:
    """Yield statements that give a wheelset the second opinions of the model.

    Args:
        sections: Codes of those that the wheelset runs on, one after the other by day.
    """
    wheelset, vehicle = literal(mounting.wheelset), literal(mounting.vehicle)
    for table, section in ((CREEP, "track_section"), (SIGNATURES, "section")):
        day = (table.c.start_ns // DAY_NS) % len(sections)
        place = case(*((day == at, literal(code)) for at, code in enumerate(sections)))
        yield _copy(table, {"wheelset": wheelset, "vehicle": vehicle, section: place}, _same(table, model))
    gear: dict[str, ColumnElement[Any]] = {"vehicle": vehicle, "first_axle": literal(mounting.axle)}
    yield _copy(DAMPERS, {"wheelset": wheelset, **gear}, _same(DAMPERS, model))
    by_interval = CELLS.c.mileage_interval % len(sections)
    place = case(*((by_interval == at, literal(code)) for at, code in enumerate(sections)))
    yield _copy(CELLS, {"wheelset": wheelset, "section": place}, _same(CELLS, model))


def put_friction(connection: Connection, sections: Sequence[str]) -> None:
    """Give sections the friction of the model's section, and what was found of its rails."""
    for table, name in OF_SECTIONS:
        model = connection.scalar(select(func.min(table.c[name])))
        for code in sections:
            connection.execute(_copy(table, {name: literal(code)}, table.c[name] == model))


def note_opinions(context: JobContext, storage: SqlStorage) -> None:
    """Note that the jobs of the second opinions have looked at everything, as they do it themselves.

    Args:
        storage: With the second opinions of all wheelsets.
    """
    with storage.read() as unit:
        seen = {}
        for stage in (refresh_rails.OF_WHEELSETS, refresh_rails.OF_ALL, ASSUMED, refresh_signatures.OF_ALL):
            inputs = stage.inputs(context)
            due = unit.marks.due(inputs, context.clock.now_ns())
            seen[inputs] = {subject: Mark(state.seen, "") for subject, state in due.items()}
    with storage.write() as unit:
        for inputs, marks in seen.items():
            unit.marks.note(inputs, marks)


def _same(table: Table, model: Mounting) -> ColumnElement[bool]:
    return table.c.wheelset == model.wheelset


def _copy(table: Table, own: Mapping[str, ColumnElement[Any]], rows: ColumnElement[bool]) -> Insert:
    names = [column.name for column in table.columns]
    cut = {"packed": func.substr(table.c.packed, 1, KEPT_BYTES)} if "packed" in names else {}
    values: dict[str, ColumnElement[Any]] = {**cut, **own}
    return insert(table).from_select(names, select(*(values.get(name, table.c[name]) for name in names)).where(rows))
