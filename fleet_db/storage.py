"""Transactions over all stores, on SQLite or PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine

from estimation.errors import StorageError
from estimation.values.runs import Claimed, JobTrigger
from fleet_db import locks
from fleet_db.changes import Changes
from fleet_db.due import WindowDueStore
from fleet_db.locks import (
    Lease,
    UnendedLease,
    UnendedLeases,
    file_scheduler_lock,
    lock_scheduler,
    postgresql_session,
    prolonged,
    serialise_vehicle,
    single_writer,
)
from fleet_db.session import BUSY_TIMEOUT_MS, IMMEDIATE, sqlite_file, translate_errors
from fleet_db.stores.adhesion import AdhesionStore
from fleet_db.stores.alerts import AlertStore
from fleet_db.stores.api_keys import ApiKeyStore
from fleet_db.stores.assembled import AssembledWindowStore
from fleet_db.stores.audit import AuditStore
from fleet_db.stores.bin_tables import BinTableStore
from fleet_db.stores.chunks import ChunkStore
from fleet_db.stores.corrections import CorrectionStore
from fleet_db.stores.dampers import DamperStore
from fleet_db.stores.feed_branches import FeedBranchStore
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.idempotency import IdempotencyStore
from fleet_db.stores.jobs import JobRunStore
from fleet_db.stores.looks import LookStore
from fleet_db.stores.plausibility import PlausibilityStore
from fleet_db.stores.quarantine import QuarantineStore
from fleet_db.stores.rails import RailsStore
from fleet_db.stores.raw_marks import RawMarkStore
from fleet_db.stores.raw_scrubs import RawScrubStore
from fleet_db.stores.recorded_times import RecordedTimeStore
from fleet_db.stores.recording_changes import RecordingChangeStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import RegistryHistoryStore
from fleet_db.stores.results import ResultStore
from fleet_db.stores.roll_ups import RollUpStore
from fleet_db.stores.section_looks import SectionLookStore
from fleet_db.stores.sensor_changes import SensorChangeStore
from fleet_db.stores.settings import StoredSettingStore
from fleet_db.stores.signatures import SignatureStore
from fleet_db.stores.stage_marks import StageMarkStore
from fleet_db.stores.stale_spans import StaleSpanStore
from fleet_db.stores.suspension import SuspensionStore
from fleet_db.stores.track_epochs import EpochStore
from fleet_db.stores.tracks import TrackStore
from fleet_db.stores.trends import TrendStore
from fleet_db.stores.vehicle_classes import Shipped, no_class
from fleet_db.stores.webhooks import WebhookStore
from fleet_db.stores.windows import WindowStore
from fleet_db.stores.work_claims import WorkClaimStore
from fleet_db.stores.worklist import WorklistStore
from fleet_db.stores.worklist_inputs import WorklistReader
from fleet_db.subjects import Subjects
from fleet_db.telemetry import WindowFiles
from fleet_db.visibility import VISIBLE

SNAPSHOT = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}


@dataclass(slots=True)
class SqlUnitOfWork:
    """One transaction over all stores; the jobs see of it what ``estimation.storage.UnitOfWork`` lists."""

    connection: Connection
    files: WindowFiles
    writing: bool
    shipped: Shipped = no_class
    owner: int | None = None  # token of the process that runs jobs
    subjects: Subjects = field(init=False)
    changes: Changes = field(init=False)
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
    looks: LookStore = field(init=False)
    section_looks: SectionLookStore = field(init=False)
    rails: RailsStore = field(init=False)
    roll_ups: RollUpStore = field(init=False)
    webhooks: WebhookStore = field(init=False)
    work_claims: WorkClaimStore = field(init=False)

    def __post_init__(self) -> None:
        connection = self.connection
        self.subjects = Subjects(connection)
        self.changes = Changes(connection, self.subjects)
        self.chunks = ChunkStore(connection)
        self.settings = StoredSettingStore(connection)
        self.stale_spans = StaleSpanStore(connection)
        self.quarantine = QuarantineStore(connection)
        self.raw_marks = RawMarkStore(connection)
        self.raw_scrubs = RawScrubStore(connection)
        self.recording_changes = RecordingChangeStore(connection)
        self.registry = RegistryStore(connection, self.changes, self.shipped)
        self.tracks = TrackStore(connection, self.changes)
        self.registry_history = RegistryHistoryStore(connection, self.changes)
        self.sensor_changes = SensorChangeStore(connection, self.changes)
        self.corrections = CorrectionStore(
            connection, self.registry, self.tracks, self.registry_history, self.sensor_changes
        )
        self.epochs = EpochStore(connection, self.changes)
        self.windows = WindowStore(connection, self.changes, self.files)
        self.assembled = AssembledWindowStore(connection, self.changes, self.files)
        self.tables = BinTableStore(connection, self.changes)
        self.due = WindowDueStore(connection)
        self.marks = StageMarkStore(connection, self.subjects, self.due)
        self.results = ResultStore(connection, self.changes)
        self.geometries = GeometryStore(connection, self.results)
        self.trends = TrendStore(self.results, self.geometries)
        self.suspensions = SuspensionStore(connection)
        self.adhesion = AdhesionStore(connection)
        self.dampers = DamperStore(connection, self.changes)
        self.signatures = SignatureStore(connection)
        self.alerts = AlertStore(connection, self.writing, self.changes)
        self.plausibility = PlausibilityStore(connection, self.windows)
        self.recorded_times = RecordedTimeStore(connection)
        self.feed_branches = FeedBranchStore(connection)
        self.jobs = JobRunStore(connection, self.owner)
        self.idempotency = IdempotencyStore(connection)
        reader = WorklistReader(connection, self.registry, self.geometries, self.trends)
        self.worklist = WorklistStore(connection, self.changes, reader)
        self.api_keys = ApiKeyStore(connection)
        self.audit = AuditStore(connection)
        self.looks = LookStore(connection, self.changes)
        self.section_looks = SectionLookStore(connection)
        self.rails = RailsStore(connection, self.subjects)
        self.roll_ups = RollUpStore(connection)
        self.webhooks = WebhookStore(connection)
        self.work_claims = WorkClaimStore(connection)

    def finish(self) -> None:
        """Let what follows from the changes follow, as the last of the transaction: see ``Changes``."""
        self.changes.flush()
        self.worklist.refresh(self.changes.take_shown())

    def assemble_alone(self, vehicle: str) -> None:
        """Let nobody else store windows or receipts of a vehicle until this transaction has ended.

        To be called first in the transaction; what is read after it is what the one before has left.
        """
        serialise_vehicle(self.connection, vehicle)


@dataclass(frozen=True, slots=True)
class SqlStorage:
    """Implements ``estimation.storage.Storage``.

    Args:
        engine: From ``fleet_db.session.database_engine``; migrated (``fleet_db.migrate.check_head``).
        data_dir: Where the samples of windows are, under ``windows``.
        shipped: The classes of the package, for vehicles whose class is not registered.
        patience_s: How long a writing transaction on SQLite waits for that of another process.
        visible_fleets: Codes of the fleets that reading transactions see; None for all.
        lease: Without which nothing is committed; None where none is needed.
        works_for: Token of the process that runs the job and started this one; with it leases end. None where there is
            none.
        unended: Leases of this process that could not be ended yet.
    """

    engine: Engine
    data_dir: Path
    shipped: Shipped = no_class
    patience_s: float = BUSY_TIMEOUT_MS / 1000
    visible_fleets: frozenset[str] | None = None
    lease: Lease | None = None
    works_for: int | None = None
    unended: UnendedLeases = field(default_factory=UnendedLeases, compare=False, repr=False)

    def seen_by(self, fleets: frozenset[str] | None) -> SqlStorage:
        """Return the storage whose reading transactions see only these fleets.

        Args:
            fleets: Codes; None for all.
        """
        return self if fleets is None else replace(self, visible_fleets=fleets)

    @contextmanager
    def write(self) -> Iterator[SqlUnitOfWork]:
        """Commit on a clean exit, roll back on an exception.

        Raises:
            ConflictError: A constraint of the database refused it.
            BusyError: Another writer holds it too long.
            LeaseLostError: The lease that this storage was made with has ended.
            StorageError: The database cannot be reached.
        """
        with (
            translate_errors(),
            self._write_lock(),
            self.engine.connect().execution_options(**IMMEDIATE) as connection,
            connection.begin(),
        ):
            unit = SqlUnitOfWork(connection, self._files(), writing=True, shipped=self.shipped, owner=self.owner_token)
            if self.lease is not None:
                unit.work_claims.bound(self.lease.length_s)
            yield unit
            unit.finish()
            if self.lease is not None:
                unit.work_claims.check(self.lease.number, self.lease.holder)

    @contextmanager
    def read(self) -> Iterator[SqlUnitOfWork]:
        """Read one snapshot; nothing can be written.

        Raises:
            StorageError: The database cannot be reached, or something was written.
        """
        bound = {} if self.visible_fleets is None else {VISIBLE: self.visible_fleets}
        with (
            translate_errors(),
            self.engine.connect().execution_options(**bound) as connection,
            _read_only(connection) as reading,
        ):
            yield SqlUnitOfWork(reading, self._files(), writing=False, shipped=self.shipped)

    @contextmanager
    def owned(self, kind: JobTrigger, holder: str, now_ns: int) -> Iterator[OwnedStorage]:
        """Own the runs that are started with the storage that is yielded; nothing is committed once they are not.

        Args:
            holder: Name of the process, such as host and number.

        Raises:
            AlreadyRunningError: On entry: another process is the scheduler; names the holder.
            ClaimLostError: In transactions of the storage: the claim was lost meanwhile.
            StorageError: The database cannot be reached.
        """
        file = sqlite_file(self.engine)
        claim = self._postgresql_claim(kind, holder, now_ns) if file is None else self._file_claim(kind, holder, now_ns)
        with claim as token:
            same = (self.engine, self.data_dir, self.shipped, self.patience_s)
            storage = OwnedStorage(*same, unended=self.unended, token=token, holder=holder)
            try:
                yield storage
            finally:
                with suppress(StorageError), self.write() as unit:  # out of reach: whoever looks next removes it
                    locks.remove(unit.connection, token)

    @contextmanager
    def leased(
        self, stage: str, keys: Sequence[str], holder: str, length_s: float, *, alone: bool = False
    ) -> Iterator[tuple[SqlStorage, Claimed]]:
        """Claim what is free and yield a storage that commits nothing once the claim has ended.

        The claim is prolonged until the block ends, and forgotten then, however it ends. Where the process is killed
        or stands still it ends by itself after ``length_s``. Where the database is out of reach at the end, it ends
        with the next one of this process.

        Args:
            stage: Of the work, such as the name of a job.
            holder: Name of the process, such as host and number.
            length_s: Of the lease, s.
            alone: Whether also what workers have ended at is claimed.

        Raises:
            LeaseLostError: In transactions of the storage: the lease has ended meanwhile.
            StorageError: The database cannot be reached.
        """
        left = self.unended.left()
        with self.write() as unit:
            for one in left:
                unit.work_claims.end_late(one)
            number = unit.work_claims.lease(holder, round(length_s * 1e9), self.owner_token or self.works_for)
            claimed = unit.work_claims.take(number, stage, keys, alone=alone)
        self.unended.ended(left)
        try:
            with prolonged(partial(self._prolong, number), length_s):
                yield replace(self, lease=Lease(number, holder, length_s)), claimed
        finally:
            try:
                with self.write() as unit:
                    unit.work_claims.end(number)
            except StorageError:  # out of reach
                self.unended.add(UnendedLease(number, stage, claimed.begun_ns))

    def lease_lost(self) -> bool:
        """Return whether the lease of this storage has ended; False where the database cannot be asked."""
        if self.lease is None:
            return False
        try:
            with self.read() as unit:
                return not unit.work_claims.holds(self.lease.number)
        except StorageError:
            return False

    def _prolong(self, lease: int) -> bool:
        with SqlStorage.write(self) as unit:
            return unit.work_claims.prolong(lease)

    @contextmanager
    def _file_claim(self, kind: JobTrigger, holder: str, now_ns: int) -> Iterator[int]:
        file = Path(str(self.engine.url.database))
        only = file_scheduler_lock(file.with_name(f"{file.name}.scheduler-lock"), holder)
        with only if kind is JobTrigger.SCHEDULE else nullcontext(), ExitStack() as held:
            with self.write() as unit:
                token = locks.add(unit.connection, kind, holder, now_ns)
                held.enter_context(locks.file_owner_lock(locks.lock_file(self.engine, token)))
            yield token

    @contextmanager
    def _postgresql_claim(self, kind: JobTrigger, holder: str, now_ns: int) -> Iterator[int]:
        with translate_errors(), postgresql_session(self.engine, holder) as session:
            if kind is JobTrigger.SCHEDULE:
                lock_scheduler(session)
            with self.write() as unit:
                token = locks.add(unit.connection, kind, holder, now_ns)
                locks.lock_owner(session, token)
            yield token

    @property
    def owner_token(self) -> int | None:
        """Token of the process that owns the runs that are started here, if any."""
        return None

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()

    def _write_lock(self) -> AbstractContextManager[None]:
        file = sqlite_file(self.engine)
        if file is None:
            return nullcontext()
        return single_writer(file.with_name(f"{file.name}.writer-lock"), self.patience_s)

    def _files(self) -> WindowFiles:
        return WindowFiles(self.data_dir / "windows")


@dataclass(frozen=True, slots=True)
class OwnedStorage(SqlStorage):
    """Storage of a process that runs jobs: commits nothing once that is no longer so. See :meth:`SqlStorage.owned`."""

    _: KW_ONLY
    token: int
    holder: str

    @contextmanager
    def write(self) -> Iterator[SqlUnitOfWork]:
        """Commit on a clean exit while the claim holds, roll back on an exception.

        Raises:
            ClaimLostError: The claim was lost; nothing was committed.
            ConflictError, StorageError: As :meth:`SqlStorage.write`.
        """
        with SqlStorage.write(self) as unit:
            yield unit
            unit.finish()
            locks.check_claim(unit.connection, self.token, self.holder)

    @property
    def owner_token(self) -> int:
        """Token of this process."""
        return self.token

    def holds(self) -> bool:
        """Return whether the claim holds and the connection with its lock is alive."""
        try:
            with self.read() as unit:
                return self.token in locks.living(unit.connection, [self.token]) and locks.has_claim(
                    unit.connection, self.token
                )
        except StorageError:
            return False


@contextmanager
def _read_only(connection: Connection) -> Iterator[Connection]:
    if connection.dialect.name != "sqlite":
        # committed: the driver forgets with a rollback what the server has prepared, and nothing was written
        with connection.execution_options(**SNAPSHOT).begin():
            yield connection
        return
    with connection.begin() as transaction:
        connection.exec_driver_sql("PRAGMA query_only = ON")
        try:
            yield connection
        finally:
            connection.exec_driver_sql("PRAGMA query_only = OFF")
            transaction.rollback()
