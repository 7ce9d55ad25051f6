"""Versions of geometries and trends beside a newer one of the same day: of old days the last is enough."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Column, Connection, Table, delete, func, select

from fleet_db.keeping.retention import DAY_NS
from fleet_db.rows import table_of
from fleet_db.tables import GeometryRow, TrendRow

GEOMETRIES, TRENDS = table_of(GeometryRow), table_of(TrendRow)
KEYS: dict[Table, tuple[str, ...]] = {
    GEOMETRIES: ("wheelset", "baseline", "baseline_interval"),
    TRENDS: ("wheelset", "baseline", "quantity"),
}
NUMBERS: dict[Table, Column[int]] = {GEOMETRIES: GEOMETRIES.c.geometry_id, TRENDS: TRENDS.c.trend_id}


def replaced_within_a_day(connection: Connection, table: Table, from_ns: int, before_ns: int) -> Sequence[int]:
    """Return the numbers of estimates that another of the same key replaced on the same day, UTC.

    Args:
        table: Of geometries or trends.
        from_ns, before_ns: Begins of days between which they were recorded, ns UTC.
    """
    number, day = NUMBERS[table], table.c.recorded_ns - table.c.recorded_ns % DAY_NS
    newest_first = func.row_number().over(
        partition_by=[*(table.c[name] for name in KEYS[table]), day], order_by=number.desc()
    )
    within = (table.c.recorded_ns >= from_ns, table.c.recorded_ns < before_ns)
    ranked = select(number.label("number"), newest_first.label("place")).where(*within).subquery()
    return list(connection.scalars(select(ranked.c.number).where(ranked.c.place > 1).order_by(ranked.c.number)))


def forget_estimates(connection: Connection, table: Table, numbers: Sequence[int]) -> int:
    """Delete estimates; return how many there were.

    Args:
        table: Of geometries or trends.
    """
    return int(connection.execute(delete(table).where(NUMBERS[table].in_(numbers))).rowcount)
