"""Windows whose samples are not needed any more: of an old window that is estimated, or refused for good."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, Row, and_, bindparam, exists, or_, select, update

from estimation.values.quarantine import TRIED_AGAIN
from estimation.values.reasons import ReasonCode
from estimation.values.windows import WindowState
from fleet_db.rows import table_of
from fleet_db.tables import TrackEpochRow, TrackEpochWindowRow, WindowBinTableRow, WindowRow

WINDOWS, TABLES = table_of(WindowRow), table_of(WindowBinTableRow)
EPOCHS, MEMBERS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow)
WAITING = (ReasonCode.ALIGNMENT_UNKNOWN, ReasonCode.CLASS_UNKNOWN, ReasonCode.FILE_DAMAGED, *TRIED_AGAIN)
"""Reasons for which a window was refused until something comes that it needs its samples for."""


def expired_samples(connection: Connection, before_ns: int, limit: int) -> Sequence[Row[Any, Any, Any, Any]]:
    """Return windows whose samples may go, oldest first: wheelset, start_ns, content_digest, sample_bytes.

    A window is estimated and rolled up, or refused for good. It is of no epoch of an alignment that may be computed
    again when a recording comes late: nor of one that identified nothing, until a later one has.

    Args:
        before_ns: They start before it, ns UTC.
    """
    rolled = exists().where(
        TABLES.c.wheelset == WINDOWS.c.wheelset, TABLES.c.start_ns == WINDOWS.c.start_ns, TABLES.c.rolled
    )
    estimated = and_(WINDOWS.c.state == WindowState.ESTIMATED.value, rolled)
    waits = WINDOWS.c.reason_code.in_([code.value for code in WAITING])
    refused = and_(WINDOWS.c.state == WindowState.REFUSED.value, WINDOWS.c.reason_code.is_not(None), ~waits)
    over = exists().where(
        EPOCHS.c.section == MEMBERS.c.section,
        EPOCHS.c.number >= MEMBERS.c.epoch,
        ~EPOCHS.c.waits,
        EPOCHS.c.horizon_ns < before_ns,
    )
    needed = exists().where(MEMBERS.c.wheelset == WINDOWS.c.wheelset, MEMBERS.c.start_ns == WINDOWS.c.start_ns, ~over)
    columns = (WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.content_digest, WINDOWS.c.sample_bytes)
    return connection.execute(
        select(*columns)
        .where(WINDOWS.c.samples_purged_ns.is_(None), WINDOWS.c.start_ns < before_ns, or_(estimated, refused), ~needed)
        .order_by(WINDOWS.c.start_ns)
        .limit(limit)
    ).all()


def mark_purged(connection: Connection, windows: Sequence[Row[Any, Any, Any, Any]], now_ns: int) -> None:
    """Store that the samples of windows are gone, in the transaction that found them.

    Args:
        now_ns: Our time, ns UTC.
    """
    same = (WINDOWS.c.wheelset == bindparam("of_wheelset"), WINDOWS.c.start_ns == bindparam("of_start_ns"))
    keys = [{"of_wheelset": one.wheelset, "of_start_ns": one.start_ns} for one in windows]
    connection.execute(update(WINDOWS).where(*same).values(samples_purged_ns=now_ns), keys)
