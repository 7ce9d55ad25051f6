"""What has changed under the epochs of a section, found by comparing all of its windows: the alignment job does not."""

from __future__ import annotations

from sqlalchemy import Connection, and_, func, or_, select

from fleet_db.due import EPOCHS, MEMBERS, OF_WINDOW, PLACED_MEMBER, POSITIONS, WINDOWS

OF_EPOCH = and_(MEMBERS.c.section == EPOCHS.c.section, MEMBERS.c.epoch == EPOCHS.c.number)
WITH_SAMPLES = WINDOWS.c.samples_purged_ns.is_(None)
Key = tuple[str, int]


def placed(connection: Connection, section: str) -> dict[Key, int]:
    """Return by key the epoch of each window whose position is stored."""
    columns = (MEMBERS.c.wheelset, MEMBERS.c.start_ns, MEMBERS.c.epoch)
    found = select(*columns).select_from(MEMBERS.join(POSITIONS, PLACED_MEMBER)).where(MEMBERS.c.section == section)
    return {(row.wheelset, row.start_ns): row.epoch for row in connection.execute(found)}


def first_changed(connection: Connection, section: str, before: dict[Key, int]) -> int | None:
    """Return the first epoch that is not as its windows are now; None where all are.

    Args:
        before: From :func:`placed`, when the section was at rest.
    """
    from_ns = _changed_from(connection, section)
    held = _held(connection, section)
    forgotten = {before[key] for key in before.keys() - placed(connection, section).keys() if key in held}
    again = forgotten | _torn(connection, section)
    rows = connection.execute(select(EPOCHS.c.number, EPOCHS.c.horizon_ns).where(EPOCHS.c.section == section))
    changed = [row.number for row in rows if row.number in again or (from_ns is not None and from_ns <= row.horizon_ns)]
    return min(changed, default=None)


def _changed_from(connection: Connection, section: str) -> int | None:
    """Return the start of the first window that is new, changed or gone."""
    changed = or_(
        MEMBERS.c.wheelset.is_(None),
        MEMBERS.c.section != section,
        MEMBERS.c.content_digest != WINDOWS.c.content_digest,
        MEMBERS.c.mileage_km != WINDOWS.c.mileage_km,
        MEMBERS.c.vehicle != WINDOWS.c.vehicle,
    )
    come = (
        select(func.min(WINDOWS.c.start_ns))
        .select_from(WINDOWS.outerjoin(MEMBERS, OF_WINDOW))
        .where(WINDOWS.c.track_section == section, changed, WITH_SAMPLES)
    )
    gone = (
        select(func.min(MEMBERS.c.start_ns))
        .select_from(MEMBERS.outerjoin(WINDOWS, OF_WINDOW))
        .where(MEMBERS.c.section == section, WINDOWS.c.track_section.is_distinct_from(section))
    )
    found = [connection.scalar(statement) for statement in (come, gone)]
    if found[0] is not None:
        purged = select(func.max(WINDOWS.c.start_ns)).where(WINDOWS.c.track_section == section, ~WITH_SAMPLES)
        horizon_ns = connection.scalar(purged)
        if horizon_ns is not None and found[0] <= horizon_ns:
            held = or_(WINDOWS.c.start_ns > horizon_ns, MEMBERS.c.wheelset.is_not(None))
            found[0] = connection.scalar(come.where(held))
    return min((start_ns for start_ns in found if start_ns is not None), default=None)


def _held(connection: Connection, section: str) -> set[Key]:
    found = select(MEMBERS.c.wheelset, MEMBERS.c.start_ns).where(MEMBERS.c.section == section)
    return {(row.wheelset, row.start_ns) for row in connection.execute(found)}


def _torn(connection: Connection, section: str) -> set[int]:
    """Return the epochs that have lost windows to others."""
    statement = (
        select(EPOCHS.c.number)
        .select_from(EPOCHS.outerjoin(MEMBERS, OF_EPOCH))
        .where(EPOCHS.c.section == section)
        .group_by(EPOCHS.c.number, EPOCHS.c.windows)
        .having(func.count(MEMBERS.c.wheelset) != EPOCHS.c.windows)
    )
    return set(connection.scalars(statement))
