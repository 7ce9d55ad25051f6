"""Deleting what has been kept long enough, in bounded batches, each with its record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Row,
    and_,
    bindparam,
    delete,
    exists,
    func,
    insert,
    or_,
    select,
    update,
)

from estimation.jobs.job import Job, JobContext
from estimation.values.reasons import ReasonCode
from estimation.values.runs import TRIED_AGAIN, JobOutcome
from estimation.values.windows import DueStage, WindowState
from fleet_db.due import is_due
from fleet_db.keeping.exclusive import keeping_alone
from fleet_db.keeping.expired_tables import expired_tables, seal
from fleet_db.keeping.kept_files import LEAST_AGE_S, SAMPLES, orphaned_recordings, orphaned_samples
from fleet_db.keeping.retention import DAY_NS, Kept, Retention
from fleet_db.raw import RawStore
from fleet_db.raw_files import unlink_old
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.alerts import WebhookDeliveryRow
from fleet_db.tables.operation import AuditRow, IdempotencyRow, JobRunRow
from fleet_db.tables.recordings import PurgeRow
from fleet_db.tables.results import ResultRow
from fleet_db.tables.track import TrackEpochRow, TrackEpochWindowRow, TrackReportRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow
from fleet_db.telemetry import WindowFiles
from fleet_db.webhook_records import DeliveryState

WINDOWS, TABLES = table_of(WindowRow), table_of(WindowBinTableRow)
EPOCHS, MEMBERS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow)
WAITING = (ReasonCode.ALIGNMENT_UNKNOWN, ReasonCode.CLASS_UNKNOWN, ReasonCode.FILE_DAMAGED, *TRIED_AGAIN)
"""Reasons for which a window was refused until something comes that it needs its samples for."""


def expired_samples(connection: Connection, before_ns: int, limit: int) -> Sequence[Row[Any, Any, Any, Any]]:
    """Return windows whose samples may go, oldest first: wheelset, start_ns, content_digest, sample_bytes.

    A window is estimated and its table summed, or it is refused for good. It is of no epoch of an alignment that may be
    computed again when a recording comes late: nor of one that identified nothing, until a later one has.

    Args:
        before_ns: They start before it, ns UTC.
    """
    summed = and_(WINDOWS.c.state == WindowState.ESTIMATED.value, ~is_due(DueStage.SUMS, WINDOWS))
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
        .where(WINDOWS.c.samples_purged_ns.is_(None), WINDOWS.c.start_ns < before_ns, or_(summed, refused), ~needed)
        .order_by(WINDOWS.c.start_ns)
        .limit(limit)
    ).all()


def mark_purged(connection: Connection, windows: Sequence[Row[Any, Any, Any, Any]], now_ns: int) -> None:
    """Store that the samples of windows are gone, in the transaction that found them."""
    same = (WINDOWS.c.wheelset == bindparam("of_wheelset"), WINDOWS.c.start_ns == bindparam("of_start_ns"))
    keys = [{"of_wheelset": one.wheelset, "of_start_ns": one.start_ns} for one in windows]
    connection.execute(update(WINDOWS).where(*same).values(samples_purged_ns=now_ns), keys)


RUNS, KEYS, PURGES = table_of(JobRunRow), table_of(IdempotencyRow), table_of(PurgeRow)
ENTRIES, DELIVERIES = table_of(AuditRow), table_of(WebhookDeliveryRow)
RESULTS, REPORTS = table_of(ResultRow), table_of(TrackReportRow)
BATCH = 1000  # rows a transaction: others wait for a fraction of a second

BY_DATA = frozenset(
    {
        Kept.SUPERSEDED_ESTIMATES,
        Kept.EVERY_ESTIMATE,
        Kept.TRACK_REPORTS,
        Kept.RECORDINGS,
        Kept.WINDOW_SAMPLES,
        Kept.WINDOW_BIN_TABLES,
    }
)
"""Kinds whose age ends a day after the newest data: a clock of ours that is ahead makes nothing old."""

Checkpoint = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Purged:
    """What a purge deleted of one kind: rows or files, and their bytes where they are files."""

    kind: Kept
    items: int
    item_bytes: int = 0


def purge(
    storage: SqlStorage, raw: RawStore, retention: Retention, now_ns: int, checkpoint: Checkpoint
) -> list[Purged]:
    """Delete what has been kept long enough; return how much of each kind.

    Every batch is a transaction of its own with its record, so that a purge which ends early has done a part.

    Args:
        checkpoint: Called between batches; it may raise to end the purge.

    Raises:
        ConflictError: A backup, restore or other purge is running.
        StorageError, PassingFaultError: The database, a directory or the store of raw recordings cannot be used.
    """
    with keeping_alone(storage.engine):
        with storage.read() as unit:
            newest_ns = unit.chunks.newest_ns()
        found = []
        for kind in Kept:
            counted_ns = now_ns if newest_ns is None or kind not in BY_DATA else min(now_ns, newest_ns + DAY_NS)
            before_ns = retention.before_ns(kind, counted_ns)
            if before_ns is not None:
                found.append(_purge_kind(storage, raw, kind, before_ns, now_ns, checkpoint))
        return found


def _purge_kind(
    storage: SqlStorage, raw: RawStore, kind: Kept, before_ns: int, now_ns: int, checkpoint: Checkpoint
) -> Purged:
    if kind is Kept.ORPHANED_FILES:
        return _purge_orphans(storage, raw, before_ns, now_ns)
    if kind is Kept.RECORDINGS:
        return _purge_recordings(storage, raw, before_ns, now_ns, checkpoint)
    if kind is Kept.WINDOW_SAMPLES:
        return _purge_samples(storage, before_ns, now_ns, checkpoint)
    if kind is Kept.EVERY_ESTIMATE:
        return _thin_estimates(storage, before_ns, now_ns, checkpoint)
    if kind is Kept.WINDOW_BIN_TABLES:
        return _purge_tables(storage, before_ns, now_ns, checkpoint)
    items = 0
    for expired in _expired(kind, before_ns):
        while True:
            checkpoint()
            with storage.write() as unit:
                count = _delete(unit.connection, expired)
                if count:
                    record_purge(unit.connection, Purged(kind, count), before_ns, now_ns)
            items += count
            if count < BATCH:
                break
    return Purged(kind, items)


def record_purge(connection: Connection, purged: Purged, before_ns: int, now_ns: int) -> None:
    """Store what was deleted, in the transaction that deletes it: all of its kind from before is gone."""
    values = {"kind": purged.kind.value, "items": purged.items, "item_bytes": purged.item_bytes}
    connection.execute(insert(PURGES).values(**values, before_ns=before_ns, purged_ns=now_ns))


def purged_before(connection: Connection, kind: Kept) -> int | None:
    """Return the time before which a kind has been deleted; None where nothing has."""
    found: int | None = connection.scalar(select(func.max(PURGES.c.before_ns)).where(PURGES.c.kind == kind.value))
    return found


@dataclass(frozen=True, slots=True)
class _Expired:
    """Rows of a table to delete: its key, and which of them."""

    key: Column[Any]
    where: ColumnElement[bool]


def _delete(connection: Connection, expired: _Expired) -> int:
    """Delete one batch; return how many rows it was."""
    keys = list(connection.scalars(select(expired.key).where(expired.where).limit(BATCH)))
    if keys:
        connection.execute(delete(expired.key.table).where(expired.key.in_(keys)))
    return len(keys)


def _expired(kind: Kept, before_ns: int) -> Sequence[_Expired]:
    """Return the expired rows of a kind, by table."""
    if kind is Kept.IDEMPOTENCY_KEYS:
        return [_Expired(KEYS.c.key, KEYS.c.recorded_ns < before_ns)]
    if kind is Kept.AUDIT:
        return [_Expired(ENTRIES.c.entry_id, ENTRIES.c.at_ns < before_ns)]
    if kind is Kept.WEBHOOK_DELIVERIES:
        ended = and_(DELIVERIES.c.state != DeliveryState.WAITING.value, DELIVERIES.c.last_ns < before_ns)
        return [_Expired(DELIVERIES.c.delivery_id, ended)]
    if kind in {Kept.JOB_RUNS, Kept.FAILED_JOB_RUNS}:
        later = RUNS.alias("later")
        same = (later.c.job == RUNS.c.job, later.c.outcome == RUNS.c.outcome)
        good = RUNS.c.outcome == JobOutcome.SUCCEEDED.value
        ended = and_(good if kind is Kept.JOB_RUNS else ~good, RUNS.c.finished_ns < before_ns)
        return [_Expired(RUNS.c.run_id, and_(ended, exists().where(*same, later.c.run_id > RUNS.c.run_id)))]
    if kind is Kept.TRACK_REPORTS:
        return [_replaced(REPORTS.c.report_id, ("section", "version"), before_ns)]
    return [_Expired(RESULTS.c.result_id, RESULTS.c.superseded_ns < before_ns)]


def _replaced(number: Column[Any], key: Sequence[str], before_ns: int) -> _Expired:
    """Return the rows that a later one of the same key had replaced before a time."""
    table = number.table
    later = table.alias("later")
    same = [later.c[name].is_not_distinct_from(table.c[name]) for name in key]
    return _Expired(number, exists().where(*same, later.c[number.name] > number, later.c.recorded_ns < before_ns))


def _purge_recordings(
    storage: SqlStorage, raw: RawStore, before_ns: int, now_ns: int, checkpoint: Checkpoint
) -> Purged:
    """Delete the raw bytes of decoded recordings: first the rows say so, then the bytes go."""
    items = size = 0
    while True:
        checkpoint()
        with storage.write() as unit:
            batch = unit.chunks.purge(before_ns, now_ns, BATCH)
            part = Purged(Kept.RECORDINGS, len(batch), sum(record.size_bytes for record in batch))
            if batch:
                record_purge(unit.connection, part, before_ns, now_ns)
        for record in batch:
            raw.remove(record.digest, record.suffix)
        items, size = items + part.items, size + part.item_bytes
        if len(batch) < BATCH:
            return Purged(Kept.RECORDINGS, items, size)


def _purge_samples(storage: SqlStorage, before_ns: int, now_ns: int, checkpoint: Checkpoint) -> Purged:
    """Delete the sample files of windows: first the rows say so, then the files go.

    A file that was used again meanwhile stays; where no row refers to it, it goes as an orphan.
    """
    files = WindowFiles(storage.data_dir / SAMPLES)
    items = size = 0
    while True:
        checkpoint()
        with storage.write() as unit:
            batch = expired_samples(unit.connection, before_ns, BATCH)
            part = Purged(Kept.WINDOW_SAMPLES, len(batch), sum(one.sample_bytes for one in batch))
            if batch:
                mark_purged(unit.connection, batch, now_ns)
                record_purge(unit.connection, part, before_ns, now_ns)
        for one in batch:
            unlink_old(files.path(one.content_digest), LEAST_AGE_S)
        items, size = items + part.items, size + part.item_bytes
        if len(batch) < BATCH:
            return Purged(Kept.WINDOW_SAMPLES, items, size)


def _purge_tables(storage: SqlStorage, before_ns: int, now_ns: int, checkpoint: Checkpoint) -> Purged:
    """Delete the bin tables of roll-ups that are whole and old, one roll-up a transaction."""
    items = 0
    with storage.read() as unit:
        found = expired_tables(unit.connection, before_ns)
    for number in found:
        checkpoint()
        with storage.write() as unit:
            if not expired_tables(unit.connection, before_ns, number):  # something has been added to it meanwhile
                continue
            count = seal(unit.connection, number, now_ns)
            record_purge(unit.connection, Purged(Kept.WINDOW_BIN_TABLES, count), before_ns, now_ns)
        items += count
    return Purged(Kept.WINDOW_BIN_TABLES, items)


def _thin_estimates(storage: SqlStorage, before_ns: int, now_ns: int, checkpoint: Checkpoint) -> Purged:
    """Delete estimates of whole days, but the last of each day; days that were thinned before are not looked at."""
    before_ns -= before_ns % DAY_NS
    items = 0
    with storage.read() as unit:
        thinned_ns = purged_before(unit.connection, Kept.EVERY_ESTIMATE) or 0
        numbers = replaced_within_a_day(unit.connection, thinned_ns, before_ns)
    batches = [numbers[first : first + BATCH] for first in range(0, len(numbers), BATCH)]
    for place, batch in enumerate(batches, start=1):
        checkpoint()
        with storage.write() as unit:
            count = unit.connection.execute(delete(RESULTS).where(RESULTS.c.result_id.in_(batch))).rowcount
            done_ns = before_ns if place == len(batches) else thinned_ns
            record_purge(unit.connection, Purged(Kept.EVERY_ESTIMATE, count), done_ns, now_ns)
        items += count
    return Purged(Kept.EVERY_ESTIMATE, items)


def replaced_within_a_day(connection: Connection, from_ns: int, before_ns: int) -> Sequence[int]:
    """Return the numbers of results that another of the same part followed on the same day, UTC."""
    end_of_day = RESULTS.c.recorded_ns - RESULTS.c.recorded_ns % DAY_NS + DAY_NS
    within = (RESULTS.c.recorded_ns >= from_ns, RESULTS.c.recorded_ns < before_ns)
    found = select(RESULTS.c.result_id).where(*within, RESULTS.c.superseded_ns < end_of_day)
    return list(connection.scalars(found.order_by(RESULTS.c.result_id)))


def _purge_orphans(storage: SqlStorage, raw: RawStore, before_ns: int, now_ns: int) -> Purged:
    """Delete files of windows that no row refers to, what killed processes left, and recordings that were purged."""
    age_s = max((now_ns - before_ns) / DAY_NS * 86_400.0, LEAST_AGE_S)
    with storage.read() as unit:
        gone = unit.chunks.purged()  # others that no row refers to may be those of a newer database
    recordings = [one for one in orphaned_recordings(storage, raw, age_s) if not one.digest or one.digest in gone]
    sizes = [unlink_old(storage.data_dir / path, age_s) for path in orphaned_samples(storage, age_s)]
    deleted = [size for size in (*sizes, *(raw.remove_old(one, age_s) for one in recordings)) if size is not None]
    purged = Purged(Kept.ORPHANED_FILES, len(deleted), sum(deleted))
    if deleted:
        with storage.write() as unit:
            record_purge(unit.connection, purged, before_ns, now_ns)
    return purged


EVERY_S = 86_400.0


def purge_job(retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage]) -> Job:
    """Return the job."""
    run = partial(_run, retention, raw, storage_of)
    return Job("purge", "Delete what has been kept long enough", every_s=EVERY_S, run=run)


def _run(
    retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage], context: JobContext
) -> Mapping[str, int]:
    done = purge(storage_of(context), raw, retention, context.clock.now_ns(), partial(context.checkpoint, 0, 0))
    return {one.kind.value: one.items for one in done}
