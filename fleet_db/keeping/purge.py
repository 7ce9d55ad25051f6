"""Deleting what has been kept long enough, in bounded batches, each with its record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from sqlalchemy import Column, ColumnElement, Connection, Row, and_, delete, exists, func, insert, or_, select, update

from estimation.jobs.job import Job, JobContext
from estimation.values.reasons import ReasonCode
from estimation.values.roll_up import APART
from estimation.values.runs import TRIED_AGAIN, JobOutcome
from estimation.values.units import DAY_NS
from estimation.values.windows import DueStage, WindowState
from fleet_db.atomic_files import unlink_old
from fleet_db.due import DUE, is_due
from fleet_db.keeping.kept_files import LEAST_AGE_S, SAMPLES, orphaned_recordings, orphaned_samples
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.locks import keeping_alone
from fleet_db.raw import RawStore
from fleet_db.records import DeliveryState
from fleet_db.rows import batches, equal, replace_all, same_window, table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.tables.alerts import WebhookDeliveryRow
from fleet_db.tables.operation import AuditRow, IdempotencyRow, JobRunRow, ResultRow
from fleet_db.tables.recordings import PurgeRow
from fleet_db.tables.track import TrackEpochRow, TrackEpochWindowRow, TrackReportRow, WindowPositionRow
from fleet_db.tables.windows import RollUpRow, RollUpStateRow, WindowBinTableRow, WindowRow
from fleet_db.telemetry import WindowFiles

WINDOWS, TABLES = table_of(WindowRow), table_of(WindowBinTableRow)
EPOCHS, MEMBERS = table_of(TrackEpochRow), table_of(TrackEpochWindowRow)
ROLL_UPS, STATES, POSITIONS = table_of(RollUpRow), table_of(RollUpStateRow), table_of(WindowPositionRow)
OF_ROLL_UP = and_(
    TABLES.c.wheelset == ROLL_UPS.c.wheelset,
    TABLES.c.start_ns.between(ROLL_UPS.c.first_ns, ROLL_UPS.c.last_ns),
    or_(
        ROLL_UPS.c.table_key == TABLES.c.parameter_key, ROLL_UPS.c.table_key.like(TABLES.c.parameter_key + f"{APART}%")
    ),
)
OF_TABLE = same_window(WINDOWS, TABLES)


def expired_tables(connection: Connection, before_ns: int, number: int | None = None) -> Sequence[int]:
    """Return the numbers of roll-ups whose tables may go, in their order.

    Such a roll-up is over: a later one has begun. All its windows are older, and none has samples from which it could
    be estimated again. Its sums are whole: no window of its wheelset from before is due, and it has as many windows as
    there are tables.
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
    statement = statement.where(*equal(ROLL_UPS, number=number))
    return list(connection.scalars(statement.order_by(ROLL_UPS.c.number)))


def seal(connection: Connection, roll_up: int, now_ns: int) -> int:
    """Delete the tables of a roll-up, which holds their sums from now on alone; return how many.

    Where its windows were, and of which epochs, goes with them: no alignment is computed from them again.
    """
    this = ROLL_UPS.c.number == roll_up
    row = connection.execute(select(ROLL_UPS.c.wheelset, ROLL_UPS.c.first_ns, ROLL_UPS.c.last_ns).where(this)).one()
    is_summed = exists().where(this, OF_ROLL_UP)
    of_it = (WINDOWS.c.wheelset == row.wheelset, exists().where(OF_TABLE, this, OF_ROLL_UP))
    connection.execute(update(ROLL_UPS).where(this).values(sealed=True))
    connection.execute(update(WINDOWS).where(*of_it).values(table_purged_ns=now_ns))
    count = int(connection.execute(delete(TABLES).where(TABLES.c.wheelset == row.wheelset, is_summed)).rowcount)
    _forget_places(connection, row.wheelset, row.first_ns, row.last_ns)
    return count


def _forget_places(connection: Connection, wheelset: str, first_ns: int, last_ns: int) -> None:
    """Delete where windows were that cannot be estimated again, and of which epochs; an epoch counts the others."""
    ended = or_(WINDOWS.c.table_purged_ns.is_not(None), WINDOWS.c.state == WindowState.REFUSED.value)
    purged = (WINDOWS.c.samples_purged_ns.is_not(None), ended)
    for table in (MEMBERS, POSITIONS):
        within = (table.c.wheelset == wheelset, table.c.start_ns.between(first_ns, last_ns))
        gone = and_(*within, exists().where(same_window(WINDOWS, table), *purged))
        if table is MEMBERS:
            epoch = (MEMBERS.c.section, MEMBERS.c.epoch)
            held = connection.execute(select(*epoch, func.count()).where(gone).group_by(*epoch)).all()
            for section, number, count in held:
                same = (EPOCHS.c.section == section, EPOCHS.c.number == number)
                connection.execute(update(EPOCHS).where(*same).values(windows=EPOCHS.c.windows - count))
        connection.execute(delete(table).where(gone))


WAITING = (ReasonCode.ALIGNMENT_UNKNOWN, ReasonCode.CLASS_UNKNOWN, ReasonCode.FILE_DAMAGED, *TRIED_AGAIN)
"""Reasons for which a window was refused until something comes that it needs its samples for."""


def expired_samples(connection: Connection, before_ns: int, limit: int) -> Sequence[Row[Any, Any, Any, Any]]:
    """Return windows whose samples may go, oldest first: wheelset, start_ns, content_digest, sample_bytes.

    A window is estimated and its table summed, or it is refused for good. It is of no epoch of an alignment that may be
    computed again when a recording comes late: nor of one that identified nothing, until a later one has.
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
    needed = exists().where(same_window(MEMBERS, WINDOWS), ~over)
    columns = (WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.content_digest, WINDOWS.c.sample_bytes)
    return connection.execute(
        select(*columns)
        .where(WINDOWS.c.samples_purged_ns.is_(None), WINDOWS.c.start_ns < before_ns, or_(summed, refused), ~needed)
        .order_by(WINDOWS.c.start_ns)
        .limit(limit)
    ).all()


RUNS, KEYS, PURGES = table_of(JobRunRow), table_of(IdempotencyRow), table_of(PurgeRow)
ENTRIES, DELIVERIES = table_of(AuditRow), table_of(WebhookDeliveryRow)
RESULTS, REPORTS = table_of(ResultRow), table_of(TrackReportRow)
BATCH = 1000  # rows a transaction: others wait for a fraction of a second

BY_DATA = {Kept.SUPERSEDED_ESTIMATES, Kept.EVERY_ESTIMATE, Kept.TRACK_REPORTS}
BY_DATA |= {Kept.RECORDINGS, Kept.WINDOW_SAMPLES, Kept.WINDOW_BIN_TABLES}
"""Kinds whose age ends a day after the newest data: a clock of ours that is ahead makes nothing old."""

Checkpoint = Callable[[], None]
V = TypeVar("V")


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

    Every batch is a transaction of its own with its record, so that a purge which ends early, by ``checkpoint``, has
    done a part. ConflictError: a backup, restore or other purge is running.
    """
    with keeping_alone(storage.engine):
        with storage.read() as unit:
            newest_ns = unit.chunks.newest_ns()
        purged = []
        for kind in Kept:
            counted_ns = now_ns if newest_ns is None or kind not in BY_DATA else min(now_ns, newest_ns + DAY_NS)
            before_ns = retention.before_ns(kind, counted_ns)
            if before_ns is not None:
                purged.append(_Purge(storage, raw, kind, before_ns, now_ns, checkpoint).run())
        return purged


def record_purge(connection: Connection, purged: Purged, before_ns: int, now_ns: int) -> None:
    """Store what was deleted, in the transaction that deletes it: all of its kind from before is gone."""
    values = {"kind": purged.kind.value, "items": purged.items, "item_bytes": purged.item_bytes}
    connection.execute(insert(PURGES).values(**values, before_ns=before_ns, purged_ns=now_ns))


def purged_before(connection: Connection, kind: Kept) -> int | None:
    """Return the time before which a kind has been deleted; None where nothing has."""
    before_ns: int | None = connection.scalar(select(func.max(PURGES.c.before_ns)).where(PURGES.c.kind == kind.value))
    return before_ns


@dataclass(frozen=True, slots=True)
class _Purge:
    """The purge of one kind: what is of before a time."""

    storage: SqlStorage
    raw: RawStore
    kind: Kept
    before_ns: int
    now_ns: int
    checkpoint: Checkpoint

    def run(self) -> Purged:
        """Delete it all."""
        if self.kind is Kept.ORPHANED_FILES:
            return self._orphans()
        if self.kind is Kept.RECORDINGS:
            return self._batches(
                lambda unit: unit.chunks.purge(self.before_ns, self.now_ns, BATCH),
                lambda record: record.size_bytes,
                lambda record: self.raw.remove(record.digest, record.suffix),
            )
        if self.kind is Kept.WINDOW_SAMPLES:  # a file that was used again meanwhile stays, and goes as an orphan
            files = WindowFiles(self.storage.data_dir / SAMPLES)
            return self._batches(
                self._samples,
                lambda window: int(window.sample_bytes),
                lambda window: unlink_old(files.path(window.content_digest), LEAST_AGE_S),
            )
        if self.kind is Kept.EVERY_ESTIMATE:
            return self._thin_estimates()
        if self.kind is Kept.WINDOW_BIN_TABLES:
            return self._tables()
        key, expired = _expired(self.kind, self.before_ns)
        return self._batches(partial(_delete, key, expired), lambda _: 0, lambda _: None)

    def _batches(
        self, take: Callable[[SqlUnitOfWork], Sequence[V]], bytes_of: Callable[[V], int], remove: Callable[[V], object]
    ) -> Purged:
        """Delete batches until one is not full: first the rows say so, then the bytes go."""
        items = size = 0
        while True:
            self.checkpoint()
            with self.storage.write() as unit:
                batch = take(unit)
                part = Purged(self.kind, len(batch), sum(map(bytes_of, batch)))
                if batch:
                    record_purge(unit.connection, part, self.before_ns, self.now_ns)
            for item in batch:
                remove(item)
            items, size = items + part.items, size + part.item_bytes
            if len(batch) < BATCH:
                return Purged(self.kind, items, size)

    def _samples(self, unit: SqlUnitOfWork) -> Sequence[Row[Any, Any, Any, Any]]:
        windows = expired_samples(unit.connection, self.before_ns, BATCH)
        keys = [{"wheelset": window.wheelset, "start_ns": window.start_ns} for window in windows]
        replace_all(unit.connection, WINDOWS, [{**key, "samples_purged_ns": self.now_ns} for key in keys])
        return windows

    def _tables(self) -> Purged:
        items = 0
        with self.storage.read() as unit:
            roll_ups = expired_tables(unit.connection, self.before_ns)
        for number in roll_ups:
            self.checkpoint()
            with self.storage.write() as unit:
                # something may have been added to it meanwhile
                if not expired_tables(unit.connection, self.before_ns, number):
                    continue
                count = seal(unit.connection, number, self.now_ns)
                record_purge(unit.connection, Purged(self.kind, count), self.before_ns, self.now_ns)
            items += count
        return Purged(self.kind, items)

    def _thin_estimates(self) -> Purged:
        """Delete estimates of whole days, but the last of each day; days that were thinned before are not looked at."""
        before_ns = self.before_ns - self.before_ns % DAY_NS
        items = 0
        with self.storage.read() as unit:
            thinned_ns = purged_before(unit.connection, self.kind) or 0
            numbers = replaced_within_a_day(unit.connection, thinned_ns, before_ns)
        parts = list(batches(numbers, BATCH))
        for place, batch in enumerate(parts, start=1):
            self.checkpoint()
            with self.storage.write() as unit:
                count = unit.connection.execute(delete(RESULTS).where(RESULTS.c.result_id.in_(batch))).rowcount
                done_ns = before_ns if place == len(parts) else thinned_ns
                record_purge(unit.connection, Purged(self.kind, count), done_ns, self.now_ns)
            items += count
        return Purged(self.kind, items)

    def _orphans(self) -> Purged:
        """Delete files that no row refers to, what killed processes left, and recordings that were purged."""
        age_s = max((self.now_ns - self.before_ns) / DAY_NS * 86_400.0, LEAST_AGE_S)
        with self.storage.read() as unit:
            gone = unit.chunks.purged()  # others that no row refers to may be those of a newer database
        recordings = orphaned_recordings(self.storage, self.raw, age_s)
        sizes = [unlink_old(self.storage.data_dir / path, age_s) for path in orphaned_samples(self.storage, age_s)]
        sizes += [self.raw.remove_old(file, age_s) for file in recordings if not file.digest or file.digest in gone]
        deleted = [size for size in sizes if size is not None]
        purged = Purged(self.kind, len(deleted), sum(deleted))
        if deleted:
            with self.storage.write() as unit:
                record_purge(unit.connection, purged, self.before_ns, self.now_ns)
        return purged


def _delete(key: Column[Any], expired: ColumnElement[bool], unit: SqlUnitOfWork) -> Sequence[Any]:
    """Delete one batch of the rows of a table, which has this key; return their keys."""
    keys = list(unit.connection.scalars(select(key).where(expired).limit(BATCH)))
    if keys:
        unit.connection.execute(delete(key.table).where(key.in_(keys)))
    return keys


def _expired(kind: Kept, before_ns: int) -> tuple[Column[Any], ColumnElement[bool]]:
    if kind is Kept.IDEMPOTENCY_KEYS:
        return KEYS.c.key, KEYS.c.recorded_ns < before_ns
    if kind is Kept.AUDIT:
        return ENTRIES.c.entry_id, ENTRIES.c.at_ns < before_ns
    if kind is Kept.WEBHOOK_DELIVERIES:
        ended = and_(DELIVERIES.c.state != DeliveryState.WAITING.value, DELIVERIES.c.last_ns < before_ns)
        return DELIVERIES.c.delivery_id, ended
    if kind in {Kept.JOB_RUNS, Kept.FAILED_JOB_RUNS}:
        later = RUNS.alias("later")
        same = (later.c.job == RUNS.c.job, later.c.outcome == RUNS.c.outcome)
        good = RUNS.c.outcome == JobOutcome.SUCCEEDED.value
        ended = and_(good if kind is Kept.JOB_RUNS else ~good, RUNS.c.finished_ns < before_ns)
        return RUNS.c.run_id, and_(ended, exists().where(*same, later.c.run_id > RUNS.c.run_id))
    if kind is Kept.TRACK_REPORTS:  # those that a later one of the same section and version had replaced
        other = REPORTS.alias("later")
        same = (other.c.section == REPORTS.c.section, other.c.version.is_not_distinct_from(REPORTS.c.version))
        followed = exists().where(*same, other.c.report_id > REPORTS.c.report_id, other.c.recorded_ns < before_ns)
        return REPORTS.c.report_id, followed
    return RESULTS.c.result_id, RESULTS.c.superseded_ns < before_ns


def replaced_within_a_day(connection: Connection, from_ns: int, before_ns: int) -> Sequence[int]:
    """Return the numbers of results that another of the same part followed on the same day, UTC."""
    end_of_day = RESULTS.c.recorded_ns - RESULTS.c.recorded_ns % DAY_NS + DAY_NS
    within = (RESULTS.c.recorded_ns >= from_ns, RESULTS.c.recorded_ns < before_ns)
    replaced = select(RESULTS.c.result_id).where(*within, RESULTS.c.superseded_ns < end_of_day)
    return list(connection.scalars(replaced.order_by(RESULTS.c.result_id)))


EVERY_S = 86_400.0


def purge_job(retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage]) -> Job:
    """Return the job."""
    run = partial(_run, retention, raw, storage_of)
    return Job("purge", "Delete what has been kept long enough", every_s=EVERY_S, run=run)


def _run(
    retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage], context: JobContext
) -> Mapping[str, int]:
    done = purge(storage_of(context), raw, retention, context.clock.now_ns(), partial(context.checkpoint, 0, 0))
    return {purged.kind.value: purged.items for purged in done}
