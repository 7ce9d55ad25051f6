"""Bin tables that are not needed any more: of a roll-up whose windows are all old, and which holds their sums."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Column, Connection, ScalarSelect, Table, and_, delete, exists, func, or_, select, update

from estimation.values.windows import WindowState
from fleet_db.keeping.retention import DAY_NS
from fleet_db.rows import table_of
from fleet_db.tables import (
    GeometryRow,
    RollUpRow,
    RollUpStateRow,
    TakenTableRow,
    TrackEpochRow,
    TrackEpochWindowRow,
    TrendRow,
    WindowBinTableRow,
    WindowPositionRow,
    WindowRow,
)

WINDOWS, TABLES, ROLL_UPS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(RollUpRow)
EPOCHS, MEMBERS, POSITIONS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow), table_of(WindowPositionRow)
STATES, TAKEN = table_of(RollUpStateRow), table_of(TakenTableRow)
OF_ROLL_UP = TABLES.c.roll_up == ROLL_UPS.c.number
OF_TABLE = and_(WINDOWS.c.wheelset == TABLES.c.wheelset, WINDOWS.c.start_ns == TABLES.c.start_ns)


def expired_tables(connection: Connection, before_ns: int, number: int | None = None) -> Sequence[int]:
    """Return the numbers of roll-ups whose tables may go, in their order.

    All windows of such a roll-up are older, and none has samples from which it could be estimated again; its sums are
    whole: no table of its wheelset from before waits to be added, none is to be taken away, and it has as many windows
    as there are tables.

    Args:
        before_ns: Their windows start before it, ns UTC.
        number: Of the one that is looked at; None: all are.
    """
    same = TABLES.c.wheelset == ROLL_UPS.c.wheelset
    older = exists().where(same, OF_ROLL_UP, TABLES.c.start_ns < before_ns)
    younger = exists().where(same, OF_ROLL_UP, TABLES.c.start_ns >= before_ns)
    with_samples = exists().where(same, OF_ROLL_UP, OF_TABLE, WINDOWS.c.samples_purged_ns.is_(None))
    waiting = exists().where(same, ~TABLES.c.rolled, TABLES.c.start_ns < before_ns)
    taken = exists().where(TAKEN.c.wheelset == ROLL_UPS.c.wheelset)
    made = exists().where(STATES.c.wheelset == ROLL_UPS.c.wheelset, STATES.c.rules != "")
    tables = select(func.count()).select_from(TABLES).where(same, OF_ROLL_UP).scalar_subquery()
    whole = or_(ROLL_UPS.c.sealed, tables == ROLL_UPS.c.windows)
    statement = select(ROLL_UPS.c.number).where(ROLL_UPS.c.plain.is_not(None), made, older, ~younger)
    statement = statement.where(~waiting, ~taken, ~with_samples, whole)
    if number is not None:
        statement = statement.where(ROLL_UPS.c.number == number)
    return list(connection.scalars(statement.order_by(ROLL_UPS.c.number)))


def seal(connection: Connection, roll_up: int, now_ns: int) -> int:
    """Delete the tables of a roll-up, which holds their sums from now on alone; return how many.

    Where its windows were, and of which epochs, goes with them: no alignment is computed from them again.
    """
    span = select(func.min(TABLES.c.start_ns), func.max(TABLES.c.start_ns)).where(TABLES.c.roll_up == roll_up)
    first_ns, last_ns = connection.execute(span).one()
    of_it = exists().where(OF_TABLE, TABLES.c.roll_up == roll_up)
    connection.execute(update(ROLL_UPS).where(ROLL_UPS.c.number == roll_up).values(sealed=True))
    wheelset = select(ROLL_UPS.c.wheelset).where(ROLL_UPS.c.number == roll_up).scalar_subquery()
    connection.execute(update(WINDOWS).where(WINDOWS.c.wheelset == wheelset, of_it).values(table_purged_ns=now_ns))
    count = int(connection.execute(delete(TABLES).where(TABLES.c.roll_up == roll_up)).rowcount)
    if count:
        _forget_places(connection, wheelset, first_ns, last_ns)
    return count


def _forget_places(connection: Connection, wheelset: ScalarSelect[str], first_ns: int, last_ns: int) -> None:
    """Delete where windows were that cannot be estimated again, and of which epochs; an epoch counts the others."""
    ended = or_(WINDOWS.c.table_purged_ns.is_not(None), WINDOWS.c.state == WindowState.REFUSED.value)
    purged = (WINDOWS.c.samples_purged_ns.is_not(None), ended)
    for table in (MEMBERS, POSITIONS):
        of_window = (WINDOWS.c.wheelset == table.c.wheelset, WINDOWS.c.start_ns == table.c.start_ns)
        within = (table.c.wheelset == wheelset, table.c.start_ns.between(first_ns, last_ns))
        gone = and_(*within, exists().where(*of_window, *purged))
        if table is MEMBERS:
            epoch = (MEMBERS.c.section, MEMBERS.c.epoch)
            held = connection.execute(select(*epoch, func.count()).where(gone).group_by(*epoch)).all()
            for section, number, count in held:
                same = (EPOCHS.c.section == section, EPOCHS.c.number == number)
                connection.execute(update(EPOCHS).where(*same).values(windows=EPOCHS.c.windows - count))
        connection.execute(delete(table).where(gone))


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
