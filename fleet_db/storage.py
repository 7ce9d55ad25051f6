"""Transactions over all stores, on SQLite or PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine

from estimation.errors import ConflictError, LeaseLostError, StorageError
from estimation.values.runs import Claimed, JobTrigger
from fleet_db.due import WindowDueStore
from fleet_db.locks import Claims, Lease, UnendedLease, UnendedLeases, prolonged, serialise_vehicle, single_writer
from fleet_db.session import (
    BUSY_TIMEOUT_MS,
    IMMEDIATE,
    dropped_on_failure,
    reading_engine,
    snapshot,
    sqlite_file,
    translate_errors,
)
from fleet_db.stores.access import ApiKeyStore, AuditStore, IdempotencyStore
from fleet_db.stores.alerts import AlertStore
from fleet_db.stores.assembled import AssembledWindowStore, StaleSpanStore
from fleet_db.stores.bin_tables import BinTableStore
from fleet_db.stores.chunks import ChunkStore, RawScrubStore, RecordingChangeStore
from fleet_db.stores.corrections import CorrectionStore
from fleet_db.stores.geometries import GeometryStore, TrendStore
from fleet_db.stores.installation import FeedBranchStore, RawMarkStore, RecordedTimeStore, StoredSettingStore
from fleet_db.stores.jobs import JobRunStore, WorkClaimStore
from fleet_db.stores.opinions import AdhesionStore, DamperStore, RailsStore, SuspensionStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import RegistryHistoryStore, Shipped, no_class
from fleet_db.stores.results import ResultStore
from fleet_db.stores.roll_ups import RollUpStore
from fleet_db.stores.signatures import SignatureStore
from fleet_db.stores.stage_marks import QuarantineStore, StageMarkStore
from fleet_db.stores.track_epochs import EpochStore
from fleet_db.stores.tracks import TrackStore
from fleet_db.stores.webhooks import WebhookStore
from fleet_db.stores.wheelset_events import SensorChangeStore
from fleet_db.stores.window_counts import PlausibilityStore
from fleet_db.stores.windows import WindowStore
from fleet_db.stores.worklist import WorklistReader, WorklistStore
from fleet_db.subjects import KeptRecords, OnFile, ReadOnce, Subjects
from fleet_db.telemetry import WindowFiles
from fleet_db.visibility import bind


class SqlUnitOfWork:
    """One transaction over all stores."""

    def __init__(
        self,
        connection: Connection,
        files: WindowFiles,
        *,
        writing: bool,
        shipped: Shipped = no_class,
        kept: KeptRecords | None = None,  # of the registry; None where a transaction does not see all of it
        owner: int | None = None,  # lease of the process that runs jobs
    ) -> None:
        self.connection = connection
        self._add_stores_of_operation(connection)
        self.done: set[str] = set()  # of what is claimed: it is free once this is committed
        self.together: set[str] = set()  # wheelsets of which a reading transaction reads all together
        self.subjects = Subjects(connection)
        self.chunks = ChunkStore(connection, self.subjects)
        once = ReadOnce(not writing, self.together)
        on_file = once
        if kept is not None:
            on_file = OnFile(not writing, self.together, subjects=self.subjects, kept=kept)
        # a transaction that changes records reads them as they are in it
        self.registry = RegistryStore(connection, self.subjects, shipped, once=once if writing else on_file)
        self.tracks = TrackStore(connection, self.subjects, once)
        self.registry_history = RegistryHistoryStore(connection, self.subjects)
        self.sensor_changes = SensorChangeStore(connection, self.subjects)
        self.corrections = CorrectionStore(
            connection, self.registry, self.tracks, self.registry_history, self.sensor_changes
        )
        self.epochs = EpochStore(connection, self.subjects)
        self.windows = WindowStore(connection, self.subjects, files, once)
        self.assembled = AssembledWindowStore(connection, self.subjects, files)
        self.tables = BinTableStore(connection, self.subjects, once)
        self.due = WindowDueStore(connection, once)
        self.marks = StageMarkStore(connection, self.subjects, self.due, once, on_file)
        self.results = ResultStore(connection, self.subjects, once)
        self.geometries = GeometryStore(connection, self.results, once)
        self.trends = TrendStore(self.results, self.geometries)
        self.suspensions = SuspensionStore(connection, self.subjects)
        self.adhesion = AdhesionStore(connection, self.subjects)
        self.dampers = DamperStore(connection, self.results)
        self.signatures = SignatureStore(connection, self.subjects)
        self.alerts = AlertStore(connection, writing, self.subjects, once)
        self.plausibility = PlausibilityStore(connection, self.windows)
        self.jobs = JobRunStore(connection, owner)
        shown = replace(self.registry, once=on_file)
        reader = WorklistReader(connection, shown, self.geometries, self.trends)
        self.worklist = WorklistStore(connection, self.subjects, reader)
        self.rails = RailsStore(connection, self.subjects)
        self.roll_ups = RollUpStore(connection, once)

    def _add_stores_of_operation(self, connection: Connection) -> None:
        self.settings = StoredSettingStore(connection)
        self.stale_spans = StaleSpanStore(connection)
        self.quarantine = QuarantineStore(connection)
        self.raw_marks = RawMarkStore(connection)
        self.raw_scrubs = RawScrubStore(connection)
        self.recording_changes = RecordingChangeStore(connection)
        self.recorded_times = RecordedTimeStore(connection)
        self.feed_branches = FeedBranchStore(connection)
        self.idempotency = IdempotencyStore(connection)
        self.api_keys = ApiKeyStore(connection)
        self.audit = AuditStore(connection)
        self.webhooks = WebhookStore(connection)
        self.work_claims = WorkClaimStore(connection)

    def finish(self) -> None:
        """Let what follows from the changes follow, as the last of the transaction: see ``Subjects``."""
        self.subjects.flush()
        self.worklist.refresh(self.subjects.take_shown())

    def assemble_alone(self, vehicle: str) -> None:
        """Let nobody else store windows or receipts of a vehicle until this transaction has ended.

        To be called first in the transaction; what is read after it is what the one before has left.
        """
        serialise_vehicle(self.connection, vehicle)


@dataclass(frozen=True, slots=True)
class SqlStorage:
    """Transactions: `write` commits on a clean exit and rolls back on an exception; `read` sees one snapshot."""

    engine: Engine  # of ``fleet_db.session.database_engine``, of a database at the head of the migrations
    data_dir: Path  # where the samples of windows are, under ``windows``
    shipped: Shipped = no_class  # the classes of the package, for vehicles whose class is not registered
    patience_s: float = BUSY_TIMEOUT_MS / 1000  # so long a writing transaction on SQLite waits for another process
    visible_fleets: frozenset[str] | None = None  # codes of those that reading transactions see; None for all
    lease: Lease | None = None  # without which nothing is committed; None where none is needed
    claims: Claims | None = None  # what is claimed under it and worked on; None where it is not for claims
    owner: int | None = None  # lease of the process that runs jobs, with which those of its work end; None for none
    # leases of this process that could not be ended yet, and what it has read of the registry
    unended: UnendedLeases = field(default_factory=UnendedLeases, compare=False, repr=False)
    kept: KeptRecords = field(default_factory=KeptRecords, compare=False, repr=False)
    reading: Engine | None = field(default=None, compare=False, repr=False)  # of reading transactions

    def __post_init__(self) -> None:
        if self.reading is None:
            object.__setattr__(self, "reading", reading_engine(self.engine))

    def seen_by(self, fleets: frozenset[str] | None) -> SqlStorage:
        """Return the storage whose reading transactions see only fleets of these codes; None is all."""
        return self if fleets is None else replace(self, visible_fleets=fleets)

    @contextmanager
    def write(self, *, fenced: bool = True) -> Iterator[SqlUnitOfWork]:
        """Commit on a clean exit, roll back on an exception.

        Args:
            fenced: Whether nothing is committed once the lease of this storage has ended; records of runs are.

        Raises:
            ConflictError: A constraint of the database refused it.
            BusyError: Another writer holds it too long.
            LeaseLostError: The lease that this storage was made with has ended.
            StorageError: The database cannot be reached.
        """
        with (
            self._lost_or_refused(),
            translate_errors(),
            self._write_lock(),
            self.engine.connect().execution_options(**IMMEDIATE) as connection,
            dropped_on_failure(connection),
            connection.begin(),
        ):
            unit = SqlUnitOfWork(
                connection, self._files(), writing=True, shipped=self.shipped, kept=self.kept, owner=self.owner
            )
            if self.lease is not None:
                unit.work_claims.bound(self.lease.length_s)
            yield unit
            unit.finish()
            freed = self._fence(unit) if fenced else frozenset()
        if self.claims is not None:
            self.claims.keys -= freed

    @contextmanager
    def _lost_or_refused(self) -> Iterator[None]:
        """Raise that the lease has ended where others have stored meanwhile what conflicts with this transaction."""
        try:
            yield
        except ConflictError as error:
            if self.lease is not None and self.lease_lost():
                raise LeaseLostError(self.lease.holder) from error
            raise

    def _fence(self, unit: SqlUnitOfWork) -> frozenset[str]:
        """Raise unless the lease is still there; free what is done, and return it."""
        if self.lease is None:
            return frozenset()
        done = frozenset(() if self.claims is None else self.claims.keys & unit.done)
        if self.claims is not None and done:
            unit.work_claims.free(self.lease.number, self.lease.holder, self.claims.stage, done)
        else:
            unit.work_claims.check(self.lease.number, self.lease.holder)
        return done

    @contextmanager
    def read(self) -> Iterator[SqlUnitOfWork]:
        """Read one snapshot; StorageError: the database cannot be reached, or something was written."""
        with (
            translate_errors(),
            (self.reading or self.engine).connect() as connection,
            dropped_on_failure(connection),
            snapshot(connection),
        ):
            if self.visible_fleets is not None:
                bind(connection, self.visible_fleets)
            kept = self.kept if self.visible_fleets is None else None
            yield SqlUnitOfWork(connection, self._files(), writing=False, shipped=self.shipped, kept=kept)

    @contextmanager
    def owned(self, kind: JobTrigger, holder: str, length_s: float) -> Iterator[SqlStorage]:
        """Own the runs that are started with the storage that is yielded; nothing is committed once they are not.

        They are owned under a lease, which is prolonged until the block ends. The scheduler has its place under it.

        Args:
            holder: Name of the process, such as host and number.
            length_s: Of the lease, s.

        Raises:
            AlreadyRunningError: On entry: another process is the scheduler; names the holder.
            LeaseLostError: In transactions of the storage: the lease has ended meanwhile.
            StorageError: The database cannot be reached.
        """
        with self.write() as unit:
            number = unit.work_claims.lease(holder, round(length_s * 1e9))
            if kind is JobTrigger.SCHEDULE:
                unit.work_claims.take_place(number)
        try:
            with prolonged(partial(self._prolong, number), length_s):
                yield replace(self, lease=Lease(number, holder, length_s), owner=number)
        finally:
            with suppress(StorageError), self.write() as unit:  # out of reach: it ends by its time
                unit.work_claims.end(number)

    @contextmanager
    def leased(
        self,
        stage: str,
        keys: Sequence[str],
        holder: str,
        length_s: float,
        *,
        alone: bool = False,
        unit: str | None = None,
        owner: int | None = None,
    ) -> Iterator[tuple[SqlStorage, Claimed]]:
        """Claim what is free and yield a storage that commits nothing once the claim has ended.

        The claim is made under the lease of the process that runs the job where it is this one, else under a lease of
        its own, which is prolonged until the block ends. It is forgotten with the transaction that stores its work
        (``done``), or when the block ends, however it does. Where the process is killed or stands still it ends by
        itself after ``length_s``. Where the database is out of reach at the end, it ends with the next one of this
        process.

        Args:
            stage: Of the work, such as the name of a job.
            holder: Name of the process, such as host and number.
            length_s: Of the lease, s.
            alone: Whether also what workers have ended at is claimed.
            unit: Number of the unit of work; leases under which it was begun before end.
            owner: Lease of the process that runs the job, where it is another one.

        Raises:
            LeaseLostError: In transactions of the storage: the lease has ended meanwhile.
            StorageError: The database cannot be reached.
        """
        process = self.lease if self.owner is not None and owner in {None, self.owner} else None
        unended, unfenced = self.unended.left(), replace(self, lease=None, claims=None)
        try:
            with unfenced.write() as writing:
                writing.work_claims.bound(length_s)
                for earlier in unended:
                    writing.work_claims.end_late(earlier)
                lease = process or Lease(
                    writing.work_claims.lease(holder, round(length_s * 1e9), owner, unit), holder, length_s
                )
                claimed = writing.work_claims.take(lease.number, stage, keys, alone=alone)
        except ConflictError:  # there is no lease of that number any more
            raise LeaseLostError(holder) from None
        self.unended.ended(unended)
        claims = Claims(stage, set(claimed.keys))
        try:
            with nullcontext() if process else prolonged(partial(self._prolong, lease.number), length_s):
                yield replace(self, lease=lease, claims=claims), claimed
        finally:
            try:
                if process is None or claims.keys:
                    with unfenced.write() as writing:
                        if process is None:
                            writing.work_claims.end(lease.number)
                        else:
                            writing.work_claims.forget(lease.number, stage, claims.keys)
            except StorageError:  # out of reach
                self.unended.add(UnendedLease(lease.number, stage, claimed.begun_ns, alone=process is None))

    def lease_lost(self) -> bool:
        """Return whether the lease of this storage has ended; StorageError: the database cannot be asked."""
        if self.lease is None:
            return False
        with self.read() as unit:
            return not unit.work_claims.holds(self.lease.number)

    def _prolong(self, lease: int) -> bool:
        with self.write() as unit:
            return unit.work_claims.prolong(lease)

    def close(self) -> None:
        """Close every connection."""
        for engine in (self.engine, self.reading or self.engine):
            engine.dispose()

    def _write_lock(self) -> AbstractContextManager[None]:
        file = sqlite_file(self.engine)
        if file is None:
            return nullcontext()
        return single_writer(file.with_name(f"{file.name}.writer-lock"), self.patience_s)

    def _files(self) -> WindowFiles:
        return WindowFiles(self.data_dir / "windows")
