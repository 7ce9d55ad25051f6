"""Transactions over all stores, on SQLite or PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import Connection, Engine

from fleet_db.changes import Changes
from fleet_db.locks import file_scheduler_lock, postgresql_scheduler_lock, serialise_vehicle, single_writer
from fleet_db.session import BUSY_TIMEOUT_MS, IMMEDIATE, sqlite_file, translate_errors
from fleet_db.stores.alerts import AlertStore
from fleet_db.stores.assembled import AssembledWindowStore
from fleet_db.stores.bin_tables import BinTableStore
from fleet_db.stores.chunks import ChunkStore
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.idempotency import IdempotencyStore
from fleet_db.stores.jobs import JobRunStore
from fleet_db.stores.quarantine import QuarantineStore
from fleet_db.stores.raw_marks import RawMarkStore
from fleet_db.stores.recorded_times import RecordedTimeStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.stale_spans import StaleSpanStore
from fleet_db.stores.suspension import SuspensionStore
from fleet_db.stores.tracks import TrackStore
from fleet_db.stores.trends import TrendStore
from fleet_db.stores.vehicle_classes import Shipped, no_class
from fleet_db.stores.windows import WindowStore
from fleet_db.telemetry import WindowFiles

SNAPSHOT = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}


@dataclass(slots=True)
class SqlUnitOfWork:
    """One transaction over all stores; the jobs see of it what ``estimation.storage.UnitOfWork`` lists."""

    connection: Connection
    files: WindowFiles
    writing: bool
    shipped: Shipped = no_class
    changes: Changes = field(init=False)
    chunks: ChunkStore = field(init=False)
    stale_spans: StaleSpanStore = field(init=False)
    quarantine: QuarantineStore = field(init=False)
    raw_marks: RawMarkStore = field(init=False)
    registry: RegistryStore = field(init=False)
    tracks: TrackStore = field(init=False)
    windows: WindowStore = field(init=False)
    assembled: AssembledWindowStore = field(init=False)
    tables: BinTableStore = field(init=False)
    geometries: GeometryStore = field(init=False)
    trends: TrendStore = field(init=False)
    suspensions: SuspensionStore = field(init=False)
    alerts: AlertStore = field(init=False)
    jobs: JobRunStore = field(init=False)
    recorded_times: RecordedTimeStore = field(init=False)
    idempotency: IdempotencyStore = field(init=False)

    def __post_init__(self) -> None:
        connection = self.connection
        self.changes = Changes(connection)
        self.chunks = ChunkStore(connection)
        self.stale_spans = StaleSpanStore(connection)
        self.quarantine = QuarantineStore(connection)
        self.raw_marks = RawMarkStore(connection)
        self.registry = RegistryStore(connection, self.changes, self.shipped)
        self.tracks = TrackStore(connection)
        self.windows = WindowStore(connection, self.changes, self.files)
        self.assembled = AssembledWindowStore(connection, self.changes, self.files)
        self.tables = BinTableStore(connection, self.changes)
        self.geometries = GeometryStore(connection, self.changes)
        self.trends = TrendStore(connection)
        self.suspensions = SuspensionStore(connection)
        self.alerts = AlertStore(connection, self.writing, self.changes)
        self.jobs = JobRunStore(connection)
        self.recorded_times = RecordedTimeStore(connection)
        self.idempotency = IdempotencyStore(connection)

    def assemble_alone(self, vehicle: str) -> None:
        """Let nobody else store windows or receipts of a vehicle until this transaction has ended.

        To be called first in the transaction; what is read after it is what the one before has left.
        """
        serialise_vehicle(self.connection, vehicle)


@dataclass(frozen=True, slots=True)
class SqlStorage:
    """Implements ``estimation.storage.Storage``.

    Parameters
    ----------
    engine
        From ``fleet_db.session.database_engine``; migrated (``fleet_db.migrate.check_head``).
    data_dir
        Where the samples of windows are, under ``windows``.
    shipped
        The classes of the package, for vehicles whose class is not registered.
    """

    engine: Engine
    data_dir: Path
    shipped: Shipped = no_class

    @contextmanager
    def write(self) -> Iterator[SqlUnitOfWork]:
        """Commit on a clean exit, roll back on an exception.

        Raises
        ------
        ConflictError
            A constraint of the database refused it.
        StorageError
            The database cannot be reached, or another writer holds it too long.
        """
        with (
            translate_errors(),
            self._write_lock(),
            self.engine.connect().execution_options(**IMMEDIATE) as connection,
            connection.begin(),
        ):
            unit = SqlUnitOfWork(connection, self._files(), writing=True, shipped=self.shipped)
            yield unit
            unit.changes.flush()

    @contextmanager
    def read(self) -> Iterator[SqlUnitOfWork]:
        """Read one snapshot; nothing can be written.

        Raises
        ------
        StorageError
            The database cannot be reached, or something was written.
        """
        with translate_errors(), self.engine.connect() as connection, _read_only(connection) as reading:
            yield SqlUnitOfWork(reading, self._files(), writing=False, shipped=self.shipped)

    def scheduler_lock(self, holder: str) -> AbstractContextManager[None]:
        """Hold the lock of the one scheduler of this database.

        Raises
        ------
        AlreadyRunningError
            On entry: another process holds it; names the holder.
        """
        file = sqlite_file(self.engine)
        if file is None:
            return _translate_errors_of(postgresql_scheduler_lock(self.engine, holder))
        return file_scheduler_lock(file.with_name(f"{file.name}.scheduler-lock"), holder)

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()

    def _write_lock(self) -> AbstractContextManager[None]:
        file = sqlite_file(self.engine)
        if file is None:
            return nullcontext()
        return single_writer(file.with_name(f"{file.name}.writer-lock"), BUSY_TIMEOUT_MS / 1000)

    def _files(self) -> WindowFiles:
        return WindowFiles(self.data_dir / "windows")


@contextmanager
def _read_only(connection: Connection) -> Iterator[Connection]:
    if connection.dialect.name != "sqlite":
        with connection.execution_options(**SNAPSHOT).begin() as transaction:
            yield connection
            transaction.rollback()
        return
    with connection.begin() as transaction:
        connection.exec_driver_sql("PRAGMA query_only = ON")
        try:
            yield connection
        finally:
            connection.exec_driver_sql("PRAGMA query_only = OFF")
            transaction.rollback()


@contextmanager
def _translate_errors_of(lock: AbstractContextManager[None]) -> Iterator[None]:
    with translate_errors(), lock:
        yield
