"""Versions of results beside a newer one of the same day: of old days the last is enough."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Column, Connection, Table, delete, func, select

from fleet_db.keeping.retention import DAY_NS
from fleet_db.rows import table_of
from fleet_db.tables import GeometryRow, ResultRow

GEOMETRIES, RESULTS = table_of(GeometryRow), table_of(ResultRow)
NUMBERS: dict[Table, Column[int]] = {GEOMETRIES: GEOMETRIES.c.geometry_id, RESULTS: RESULTS.c.result_id}


def replaced_within_a_day(connection: Connection, table: Table, from_ns: int, before_ns: int) -> Sequence[int]:
    """Return the numbers of estimates that another of the same key replaced on the same day, UTC.

    Args:
        table: Of geometries or other results.
        from_ns, before_ns: Begins of days between which they were recorded, ns UTC.
    """
    number, day = NUMBERS[table], table.c.recorded_ns - table.c.recorded_ns % DAY_NS
    within = (table.c.recorded_ns >= from_ns, table.c.recorded_ns < before_ns)
    if table is RESULTS:
        same_day = RESULTS.c.superseded_ns < day + DAY_NS
        return list(connection.scalars(select(number).where(*within, same_day).order_by(number)))
    key = (GEOMETRIES.c.wheelset, GEOMETRIES.c.baseline, GEOMETRIES.c.baseline_interval)
    newest_first = func.row_number().over(partition_by=[*key, day], order_by=number.desc())
    ranked = select(number.label("number"), newest_first.label("place")).where(*within).subquery()
    return list(connection.scalars(select(ranked.c.number).where(ranked.c.place > 1).order_by(ranked.c.number)))


def forget_estimates(connection: Connection, table: Table, numbers: Sequence[int]) -> int:
    """Delete estimates; return how many there were.

    Args:
        table: Of geometries or other results.
    """
    return int(connection.execute(delete(table).where(NUMBERS[table].in_(numbers))).rowcount)
