"""Bin tables that are not needed any more: of a roll-up whose windows are all old, and which holds their sums."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, and_, delete, exists, func, or_, select, update

from estimation.values.roll_up import APART
from estimation.values.windows import DueStage, WindowState
from fleet_db.due import DUE
from fleet_db.rows import table_of
from fleet_db.tables.track import TrackEpochRow, TrackEpochWindowRow, WindowPositionRow
from fleet_db.tables.windows import RollUpRow, RollUpStateRow, WindowBinTableRow, WindowRow

WINDOWS, TABLES, ROLL_UPS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(RollUpRow)
EPOCHS, MEMBERS, POSITIONS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow), table_of(WindowPositionRow)
STATES = table_of(RollUpStateRow)
OF_ROLL_UP = and_(
    TABLES.c.wheelset == ROLL_UPS.c.wheelset,
    TABLES.c.start_ns.between(ROLL_UPS.c.first_ns, ROLL_UPS.c.last_ns),
    or_(
        ROLL_UPS.c.table_key == TABLES.c.parameter_key, ROLL_UPS.c.table_key.like(TABLES.c.parameter_key + f"{APART}%")
    ),
)
OF_TABLE = and_(WINDOWS.c.wheelset == TABLES.c.wheelset, WINDOWS.c.start_ns == TABLES.c.start_ns)


def expired_tables(connection: Connection, before_ns: int, number: int | None = None) -> Sequence[int]:
    """Return the numbers of roll-ups whose tables may go, in their order.

    Such a roll-up is over: a later one has begun. All its windows are older, and none has samples from which it could
    be estimated again. Its sums are whole: no window of its wheelset from before is due, and it has as many windows as
    there are tables.

    Args:
        before_ns: Their windows start before it, ns UTC.
        number: Of the one that is looked at; None: all are.
    """
    later = ROLL_UPS.alias("later")
    over = exists().where(later.c.wheelset == ROLL_UPS.c.wheelset, later.c.first_ns > ROLL_UPS.c.last_ns)
    with_samples = exists().where(OF_ROLL_UP, OF_TABLE, WINDOWS.c.samples_purged_ns.is_(None))
    of_stage = (DUE.c.stage == DueStage.SUMS.value, DUE.c.wheelset == ROLL_UPS.c.wheelset)
    due = exists().where(*of_stage, DUE.c.start_ns < before_ns)
    made = exists().where(STATES.c.wheelset == ROLL_UPS.c.wheelset, STATES.c.rules != "")
    tables = select(func.count()).select_from(TABLES).where(OF_ROLL_UP).scalar_subquery()
    statement = select(ROLL_UPS.c.number).where(~ROLL_UPS.c.sealed, ROLL_UPS.c.last_ns < before_ns, over, made)
    statement = statement.where(~due, ~with_samples, tables == ROLL_UPS.c.windows)
    if number is not None:
        statement = statement.where(ROLL_UPS.c.number == number)
    return list(connection.scalars(statement.order_by(ROLL_UPS.c.number)))


def seal(connection: Connection, roll_up: int, now_ns: int) -> int:
    """Delete the tables of a roll-up, which holds their sums from now on alone; return how many.

    Where its windows were, and of which epochs, goes with them: no alignment is computed from them again.
    """
    this = ROLL_UPS.c.number == roll_up
    row = connection.execute(select(ROLL_UPS.c.wheelset, ROLL_UPS.c.first_ns, ROLL_UPS.c.last_ns).where(this)).one()
    own = exists().where(this, OF_ROLL_UP)
    of_it = (WINDOWS.c.wheelset == row.wheelset, exists().where(OF_TABLE, this, OF_ROLL_UP))
    connection.execute(update(ROLL_UPS).where(this).values(sealed=True))
    connection.execute(update(WINDOWS).where(*of_it).values(table_purged_ns=now_ns))
    count = int(connection.execute(delete(TABLES).where(TABLES.c.wheelset == row.wheelset, own)).rowcount)
    _forget_places(connection, row.wheelset, row.first_ns, row.last_ns)
    return count


def _forget_places(connection: Connection, wheelset: str, first_ns: int, last_ns: int) -> None:
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
