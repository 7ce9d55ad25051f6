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
from fleet_db.on_file import KeptRecords, OnFile
from fleet_db.read_once import ReadOnce
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
from fleet_db.stores.adhesion import AdhesionStore
from fleet_db.stores.alerts import AlertStore
from fleet_db.stores.assembled import AssembledWindowStore
from fleet_db.stores.bin_tables import BinTableStore
from fleet_db.stores.chunks import ChunkStore, RawScrubStore, RecordingChangeStore
from fleet_db.stores.corrections import CorrectionStore
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.installation import FeedBranchStore, RawMarkStore, RecordedTimeStore, StoredSettingStore
from fleet_db.stores.jobs import JobRunStore, WorkClaimStore
from fleet_db.stores.plausibility import PlausibilityStore
from fleet_db.stores.quarantine import QuarantineStore
from fleet_db.stores.rails import RailsStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import RegistryHistoryStore
from fleet_db.stores.results import ResultStore
from fleet_db.stores.roll_ups import RollUpStore
from fleet_db.stores.sensor_changes import SensorChangeStore
from fleet_db.stores.signatures import SignatureStore
from fleet_db.stores.stage_marks import StageMarkStore
from fleet_db.stores.stale_spans import StaleSpanStore
from fleet_db.stores.suspension import DamperStore, SuspensionStore
from fleet_db.stores.track_epochs import EpochStore
from fleet_db.stores.tracks import TrackStore
from fleet_db.stores.trends import TrendStore
from fleet_db.stores.vehicle_classes import Shipped, no_class
from fleet_db.stores.webhooks import WebhookStore
from fleet_db.stores.windows import WindowStore
from fleet_db.stores.worklist import WorklistStore
from fleet_db.stores.worklist_inputs import WorklistReader
from fleet_db.subjects import Subjects
from fleet_db.telemetry import WindowFiles
from fleet_db.visibility import VISIBLE


@dataclass(slots=True)
class SqlUnitOfWork:
    """One transaction over all stores."""

    connection: Connection
    files: WindowFiles
    writing: bool
    shipped: Shipped = no_class
    kept: KeptRecords | None = None  # of the registry; None where a transaction does not see all of it
    owner: int | None = None  # lease of the process that runs jobs
    done: set[str] = field(default_factory=set)  # of what is claimed: it is free once this is committed
    together: set[str] = field(default_factory=set)  # wheelsets of which a reading transaction reads all together
    subjects: Subjects = field(init=False)
    chunks: ChunkStore = field(init=False)
    settings: StoredSettingStore = field(init=False)
    stale_spans: StaleSpanStore = field(init=False)
    quarantine: QuarantineStore = field(init=False)
    raw_marks: RawMarkStore = field(init=False)
    raw_scrubs: RawScrubStore = field(init=False)
    recording_changes: RecordingChangeStore = field(init=False)
    registry: RegistryStore = field(init=False)
    registry_history: RegistryHistoryStore = field(init=False)
    sensor_changes: SensorChangeStore = field(init=False)
    corrections: CorrectionStore = field(init=False)
    tracks: TrackStore = field(init=False)
    epochs: EpochStore = field(init=False)
    windows: WindowStore = field(init=False)
    assembled: AssembledWindowStore = field(init=False)
    tables: BinTableStore = field(init=False)
    due: WindowDueStore = field(init=False)
    geometries: GeometryStore = field(init=False)
    marks: StageMarkStore = field(init=False)
    results: ResultStore = field(init=False)
    trends: TrendStore = field(init=False)
    suspensions: SuspensionStore = field(init=False)
    adhesion: AdhesionStore = field(init=False)
    dampers: DamperStore = field(init=False)
    signatures: SignatureStore = field(init=False)
    alerts: AlertStore = field(init=False)
    feed_branches: FeedBranchStore = field(init=False)
    jobs: JobRunStore = field(init=False)
    plausibility: PlausibilityStore = field(init=False)
    recorded_times: RecordedTimeStore = field(init=False)
    idempotency: IdempotencyStore = field(init=False)
    worklist: WorklistStore = field(init=False)
    api_keys: ApiKeyStore = field(init=False)
    audit: AuditStore = field(init=False)
    rails: RailsStore = field(init=False)
    roll_ups: RollUpStore = field(init=False)
    webhooks: WebhookStore = field(init=False)
    work_claims: WorkClaimStore = field(init=False)

    def __post_init__(self) -> None:
        connection = self.connection
        self.subjects = Subjects(connection)
        self.chunks = ChunkStore(connection, self.subjects)
        self.settings = StoredSettingStore(connection)
        self.stale_spans = StaleSpanStore(connection)
        self.quarantine = QuarantineStore(connection)
        self.raw_marks = RawMarkStore(connection)
        self.raw_scrubs = RawScrubStore(connection)
        self.recording_changes = RecordingChangeStore(connection)
        once = ReadOnce(not self.writing, self.together)
        on_file = once
        if self.kept is not None:
            on_file = OnFile(not self.writing, self.together, subjects=self.subjects, kept=self.kept)
        # a transaction that changes records reads them as they are in it
        of_registry = once if self.writing else on_file
        self.registry = RegistryStore(connection, self.subjects, self.shipped, once=of_registry)
        self.tracks = TrackStore(connection, self.subjects, once)
        self.registry_history = RegistryHistoryStore(connection, self.subjects)
        self.sensor_changes = SensorChangeStore(connection, self.subjects)
        self.corrections = CorrectionStore(
            connection, self.registry, self.tracks, self.registry_history, self.sensor_changes
        )
        self.epochs = EpochStore(connection, self.subjects)
        self.windows = WindowStore(connection, self.subjects, self.files, once)
        self.assembled = AssembledWindowStore(connection, self.subjects, self.files)
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
        self.alerts = AlertStore(connection, self.writing, self.subjects, once)
        self.plausibility = PlausibilityStore(connection, self.windows)
        self.recorded_times = RecordedTimeStore(connection)
        self.feed_branches = FeedBranchStore(connection)
        self.jobs = JobRunStore(connection, self.owner)
        self.idempotency = IdempotencyStore(connection)
        shown = replace(self.registry, once=on_file)
        reader = WorklistReader(connection, shown, self.geometries, self.trends)
        self.worklist = WorklistStore(connection, self.subjects, reader)
        self.api_keys = ApiKeyStore(connection)
        self.audit = AuditStore(connection)
        self.rails = RailsStore(connection, self.subjects)
        self.roll_ups = RollUpStore(connection, once)
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
    """Transactions: `write` commits on a clean exit and rolls back on an exception; `read` sees one snapshot.

    Args:
        engine: From ``fleet_db.session.database_engine``; migrated (``fleet_db.migrate.check_head``).
        data_dir: Where the samples of windows are, under ``windows``.
        shipped: The classes of the package, for vehicles whose class is not registered.
        patience_s: How long a writing transaction on SQLite waits for that of another process.
        visible_fleets: Codes of the fleets that reading transactions see; None for all.
        lease: Without which nothing is committed; None where none is needed.
        claims: What is claimed under it and worked on; None where it is not for claims.
        owner: Lease of the process that runs jobs, with which those of its work end; None where there is none.
        unended: Leases of this process that could not be ended yet.
        kept: What this process has read of the registry.
        reading: Of reading transactions; None is made from ``engine``.
    """

    engine: Engine
    data_dir: Path
    shipped: Shipped = no_class
    patience_s: float = BUSY_TIMEOUT_MS / 1000
    visible_fleets: frozenset[str] | None = None
    lease: Lease | None = None
    claims: Claims | None = None
    owner: int | None = None
    unended: UnendedLeases = field(default_factory=UnendedLeases, compare=False, repr=False)
    kept: KeptRecords = field(default_factory=KeptRecords, compare=False, repr=False)
    reading: Engine | None = field(default=None, compare=False, repr=False)

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
            unit = SqlUnitOfWork(connection, self._files(), True, self.shipped, self.kept, self.owner)  # noqa: FBT003
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
        """Read one snapshot; nothing can be written.

        Raises:
            StorageError: The database cannot be reached, or something was written.
        """
        bound = {} if self.visible_fleets is None else {VISIBLE: self.visible_fleets}
        with (
            translate_errors(),
            (self.reading or self.engine).connect().execution_options(**bound) as connection,
            dropped_on_failure(connection),
            snapshot(connection),
        ):
            kept = self.kept if self.visible_fleets is None else None
            yield SqlUnitOfWork(connection, self._files(), False, self.shipped, kept)  # noqa: FBT003

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
        own = self.lease if self.owner is not None and owner in {None, self.owner} else None
        left, unfenced = self.unended.left(), replace(self, lease=None, claims=None)
        try:
            with unfenced.write() as writing:
                writing.work_claims.bound(length_s)
                for one in left:
                    writing.work_claims.end_late(one)
                lease = own or Lease(
                    writing.work_claims.lease(holder, round(length_s * 1e9), owner, unit), holder, length_s
                )
                claimed = writing.work_claims.take(lease.number, stage, keys, alone=alone)
        except ConflictError:  # there is no lease of that number any more
            raise LeaseLostError(holder) from None
        self.unended.ended(left)
        claims = Claims(stage, set(claimed.keys))
        try:
            with nullcontext() if own else prolonged(partial(self._prolong, lease.number), length_s):
                yield replace(self, lease=lease, claims=claims), claimed
        finally:
            try:
                unfenced._end_claims(lease.number, claims, alone=own is None)  # noqa: SLF001 - of this class
            except StorageError:  # out of reach
                self.unended.add(UnendedLease(lease.number, stage, claimed.begun_ns, alone=own is None))

    def _end_claims(self, lease: int, claims: Claims, *, alone: bool) -> None:
        if not alone and not claims.keys:
            return
        with self.write() as unit:
            if alone:
                unit.work_claims.end(lease)
            else:
                unit.work_claims.forget(lease, claims.stage, claims.keys)

    def lease_lost(self) -> bool:
        """Return whether the lease of this storage has ended.

        Raises:
            StorageError: The database cannot be asked.
        """
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
