"""Where the bytes of a deployment are, by kind, and what a wheelset adds in a year."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    Integer,
    LargeBinary,
    Table,
    cast,
    func,
    inspect,
    literal_column,
    select,
    text,
)
from sqlalchemy.exc import OperationalError

from estimation.errors import StorageError
from estimation.values.units import DAY_NS, HOUR_NS
from fleet_db.keeping.kept_files import SAMPLES
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.raw import RawStore, RawTotal, total_of
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.base import Base
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.registry import VehicleRow, WheelsetRow
from fleet_db.tables.windows import WindowRow

EXACT_BYTES = 256 << 20
"""An SQLite file up to this size is read page by page (dbstat); of a larger one rows are sampled."""
SAMPLED_ROWS = 200
ROW_OVERHEAD = 10  # bytes of a row's header and number
ENTRY_OVERHEAD = 12  # bytes of an entry of an index


@dataclass(frozen=True, slots=True)
class TableSize:
    """Rows of a table, bytes of the table with what is stored beside it, bytes of its indexes."""

    rows: int
    table_bytes: int
    index_bytes: int
    estimated: bool


@dataclass(frozen=True, slots=True)
class DatabaseSize:
    """Every table of ours, and bytes that are allocated and empty."""

    tables: Mapping[str, TableSize]
    free_bytes: int


_SIZES = text("""
    SELECT c.relname AS name, CASE WHEN c.reltuples < 0 THEN coalesce(s.n_live_tup, 0) ELSE c.reltuples END,
           pg_table_size(c.oid), pg_indexes_size(c.oid)
    FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace LEFT JOIN pg_stat_user_tables s ON s.relid = c.oid
    WHERE c.relkind = 'r' AND n.nspname = current_schema()
""")


def database_size(connection: Connection, exact_bytes: int = EXACT_BYTES) -> DatabaseSize:
    """Return the size of every table.

    PostgreSQL keeps sizes and row counts itself. In SQLite the pages of a small file are counted; of a large one a
    few rows are read at even distances, and their mean is scaled to the size of the file.
    """
    if connection.dialect.name == "postgresql":
        sizes = [row for row in connection.execute(_SIZES) if row[0] in Base.metadata.tables]
        tables = {
            name: TableSize(int(rows), int(table), int(indexes), estimated=True) for name, rows, table, indexes in sizes
        }
        return DatabaseSize(tables, 0)
    pragmas = ("page_count", "page_size", "freelist_count")
    pages, size, free = (int(connection.scalar(text(f"PRAGMA {name}")) or 0) for name in pragmas)
    counted = _by_page(connection) if pages * size <= exact_bytes else None
    if counted is not None:
        return DatabaseSize(counted, free * size)
    return DatabaseSize(_by_sample(connection, (pages - free) * size, size), free * size)


def _by_page(connection: Connection) -> dict[str, TableSize] | None:
    """Return the sizes by counting pages; None where SQLite was built without ``dbstat``."""
    try:
        rows = connection.execute(text("SELECT name, sum(pgsize) FROM dbstat WHERE aggregate = TRUE GROUP BY 1"))
    except OperationalError:
        return None
    taken = {str(name): int(size) for name, size in rows}
    tables = {}
    for table in _existing(connection):
        of_table = text("SELECT name FROM sqlite_master WHERE type = 'index' AND tbl_name = :table")
        indexes = connection.scalars(of_table, {"table": table.name})
        index_bytes = sum(taken.get(str(index), 0) for index in indexes)
        count = int(connection.scalar(select(func.count()).select_from(table)) or 0)
        tables[table.name] = TableSize(count, taken.get(table.name, 0), index_bytes, estimated=False)
    return tables


def _by_sample(connection: Connection, used_bytes: int, page_bytes: int) -> dict[str, TableSize]:
    """Return sizes that add up to the file: a page for each table and index, the rest by the lengths of rows."""
    raw = {table: _sampled(connection, table) for table in _existing(connection)}
    pages = {table: 1 + len(_indexes(table)) for table in raw}
    whole = sum(size.table_bytes + size.index_bytes for size in raw.values())
    scale = max(used_bytes - sum(pages.values()) * page_bytes, 0) / whole if whole else 0.0
    return {
        table.name: TableSize(
            size.rows,
            page_bytes + round(size.table_bytes * scale),
            (pages[table] - 1) * page_bytes + round(size.index_bytes * scale),
            estimated=True,
        )
        for table, size in raw.items()
    }


def _indexes(table: Table) -> list[list[Column[Any]]]:
    """Return the columns of each index, with that of the key."""
    return [list(table.primary_key.columns), *(list(index.columns) for index in table.indexes)]


def _sampled(connection: Connection, table: Table) -> TableSize:
    """Return the size of an SQLite table by the lengths of rows at even distances."""
    number = literal_column("rowid", Integer)
    first, last = (connection.scalar(select(end(number)).select_from(table)) for end in (func.min, func.max))
    if first is None or last is None:
        return TableSize(0, 0, 0, estimated=True)
    columns = list(table.columns)
    lengths = [func.coalesce(func.length(cast(column, LargeBinary)), 0) for column in columns]
    step, rows, place = max((last - first) // SAMPLED_ROWS, 1), last - first + 1, first
    sampled: list[tuple[int, ...]] = []
    while place <= last:
        statement = select(number, *lengths).select_from(table).where(number >= place).order_by(number).limit(1)
        here, *of_columns = connection.execute(statement).one()
        sampled.append(tuple(of_columns))
        place = max(place + step, here + 1)
    sums = [sum(of_column) for of_column in zip(*sampled, strict=True)]
    mean = {column.name: total / len(sampled) for column, total in zip(columns, sums, strict=True)}
    entry = sum(ENTRY_OVERHEAD + sum(mean[column.name] for column in columns) for columns in _indexes(table))
    return TableSize(rows, round(rows * (ROW_OVERHEAD + sum(mean.values()))), round(rows * entry), estimated=True)


def _existing(connection: Connection) -> list[Table]:
    there = set(inspect(connection).get_table_names())
    return [table for table in Base.metadata.sorted_tables if table.name in there]


WINDOWS, CHUNKS = table_of(WindowRow), table_of(ChunkRow)
WHEELSETS, VEHICLES = table_of(WheelsetRow), table_of(VehicleRow)
YEAR_DAYS = 365.0
KEPT_TABLES: Mapping[str, Kept] = {"bin tables": Kept.WINDOW_BIN_TABLES}
LOOKED_AT_FILES = 20_000
"""Files whose size is read; of more, whole subdirectories are left out. Names are digests, so that any are like all."""
LOOKED_AT_WHEELSETS = 50
LOOKED_AT_RECORDINGS = 500
RATE_DAYS = 30
OTHER = "other"

TABLES: Mapping[str, tuple[str, ...]] = {
    "windows": ("windows", "window_positions"),
    "bin tables": ("window_bin_tables",),
    "roll-ups": ("roll_ups", "window_due", "roll_up_states", "rolling_sums"),
    "results": ("results", "wheelset_bins"),
    "signatures": ("wear_signatures",),
    "dampers": ("window_dampers",),
    "alignments": ("track_alignments", "track_versions", "track_reports", "track_epochs", "track_epoch_windows"),
    "receipts": ("chunks", "raw_marks", "recording_changes", "quarantine", "stale_spans"),
    "alerts and worklist": ("alerts", "alert_events", "worklist_entries", "worklist_alerts", "webhook_deliveries"),
    "audit and runs": ("audit_entries", "job_runs", "registry_events", "idempotency_keys", "purges"),
}
"""Tables by kind; those of no kind are ``other``: registry, settings."""


@dataclass(frozen=True, slots=True)
class StoredKind:
    """What there is of one kind."""

    kind: str
    items: int  # rows, or files
    item_bytes: int  # of rows or files
    index_bytes: int  # of the indexes of the rows
    estimated: bool  # whether items or bytes were sampled or are the database's own estimate
    days: float | None  # how long it is kept; None for ever
    wheelset_year_bytes: int | None  # of one wheelset, at its running rate and these days; None where nothing has run

    @property
    def bytes(self) -> int:
        """Of items and indexes."""
        return self.item_bytes + self.index_bytes


@dataclass(frozen=True, slots=True)
class Running:
    """How much the fleet runs: wheelsets and vehicles with data, hours of a window, of all, and of a wheelset's day."""

    wheelsets: int
    vehicles: int
    window_hours: float
    wheelset_hours: float
    hours_per_day: float


@dataclass(frozen=True, slots=True)
class StoredBytes:
    """Everything that is stored, by kind, with the running that it came from."""

    kinds: tuple[StoredKind, ...]
    running: Running
    free_bytes: int

    @property
    def total(self) -> int:
        """Bytes of all kinds."""
        return sum(kind.bytes for kind in self.kinds)


def stored_bytes(
    storage: SqlStorage, raw: RawStore, retention: Retention, hours_per_day: float | None = None
) -> StoredBytes:
    """Return where the bytes are, for wheelsets that run so much a day; None: as in the last days of data."""
    with storage.read() as unit:
        size = database_size(unit.connection, EXACT_BYTES)
        running = _running(unit.connection, size.tables["windows"].rows, hours_per_day)
        raw_hour = _raw_bytes_per_hour(unit.connection, running)
    year = _Year(running, retention)
    kinds = [_of_tables(kind, size.tables, year) for kind in (*TABLES, OTHER)]
    folder = storage.data_dir / SAMPLES
    try:
        samples = total_of(folder, LOOKED_AT_FILES)
    except OSError as error:
        raise StorageError(f"{folder}: cannot be read: {error.strerror}") from error
    window_bytes = samples.size_bytes / samples.items if samples.items else 0.0
    per_hour = window_bytes / running.window_hours if running.window_hours else 0.0
    kinds.append(_of_files("samples of windows", samples, Kept.WINDOW_SAMPLES, per_hour, year))
    kinds.append(_of_files("raw recordings", raw.total(LOOKED_AT_FILES), Kept.RECORDINGS, raw_hour, year))
    return StoredBytes(tuple(sorted(kinds, key=lambda kind: -kind.bytes)), running, size.free_bytes)


@dataclass(frozen=True, slots=True)
class _Year:
    running: Running
    retention: Retention

    def kept(self, bytes_per_hour: float, kind: Kept | None) -> int | None:
        """Return the bytes of a year of one wheelset that are still there at its end."""
        if not self.running.wheelset_hours:
            return None
        days = None if kind is None else getattr(self.retention, kind.value)
        counted = YEAR_DAYS if days is None else min(days, YEAR_DAYS)
        return round(bytes_per_hour * self.running.hours_per_day * counted)


def _of_tables(kind: str, sizes: Mapping[str, TableSize], year: _Year) -> StoredKind:
    listed = {name for names in TABLES.values() for name in names}
    names = [name for name in sizes if name not in listed] if kind == OTHER else TABLES[kind]
    tables = [sizes[name] for name in names if name in sizes]
    item_bytes, index_bytes = sum(table.table_bytes for table in tables), sum(table.index_bytes for table in tables)
    items = sum(table.rows for table in tables)
    hours = year.running.wheelset_hours
    per_hour = (item_bytes + index_bytes) / hours if hours and kind != OTHER else 0.0
    kept = KEPT_TABLES.get(kind)
    if kept is not None and hours:  # of what is there, for windows outlive their tables
        per_hour = (item_bytes + index_bytes) / items / year.running.window_hours if items else 0.0
    days = None if kept is None else getattr(year.retention, kept.value)
    estimated = any(table.estimated for table in tables)
    return StoredKind(kind, items, item_bytes, index_bytes, estimated, days, year.kept(per_hour, kept))


def _of_files(kind: str, files: RawTotal, kept: Kept, per_hour: float, year: _Year) -> StoredKind:
    days = getattr(year.retention, kept.value)
    return StoredKind(kind, files.items, files.size_bytes, 0, files.estimated, days, year.kept(per_hour, kept))


def _running(connection: Connection, windows: int, hours_per_day: float | None) -> Running:
    there = select(WHEELSETS.c.serial).where(select(WINDOWS.c.start_ns).where(WINDOWS.c.wheelset == WHEELSETS.c.serial)
                                             .exists())  # fmt: skip
    serials = list(connection.scalars(there.order_by(WHEELSETS.c.serial)))
    chosen = serials[:: max(len(serials) // LOOKED_AT_WHEELSETS, 1)]
    lengths, rates = [], []
    for serial in chosen:
        its_own = WINDOWS.c.wheelset == serial
        last = connection.execute(
            select(WINDOWS.c.start_ns, WINDOWS.c.length_ns).where(its_own).order_by(WINDOWS.c.start_ns.desc()).limit(1)
        ).one()
        first = connection.scalar(select(func.min(WINDOWS.c.start_ns)).where(its_own)) or 0
        from_ns = max(first, last.start_ns - RATE_DAYS * DAY_NS)
        count = connection.scalar(select(func.count()).where(its_own, WINDOWS.c.start_ns >= from_ns)) or 0
        days = max((last.start_ns + last.length_ns - from_ns) / DAY_NS, 1.0)
        lengths.append(last.length_ns / HOUR_NS)
        rates.append(count * last.length_ns / HOUR_NS / days)
    hours = sum(lengths) / len(lengths) if lengths else 0.0
    rate = sum(rates) / len(rates) if rates else 0.0
    own_recordings = select(CHUNKS.c.digest).where(CHUNKS.c.vehicle == VEHICLES.c.code).exists()
    vehicles = int(connection.scalar(select(func.count()).select_from(VEHICLES).where(own_recordings)) or 0)
    return Running(len(serials), vehicles, hours, windows * hours, rate if hours_per_day is None else hours_per_day)


def _raw_bytes_per_hour(connection: Connection, running: Running) -> float:
    newest = (
        select(CHUNKS.c.size_bytes, (CHUNKS.c.last_ns - CHUNKS.c.first_ns).label("length_ns"))
        .where(CHUNKS.c.first_ns.is_not(None))
        .order_by(CHUNKS.c.received_ns.desc())
        .limit(LOOKED_AT_RECORDINGS)
    )
    recordings = connection.execute(newest).all()
    hours = float(sum(row.length_ns for row in recordings)) / HOUR_NS
    if not hours or not running.wheelsets:
        return 0.0
    return float(sum(row.size_bytes for row in recordings)) / hours * running.vehicles / running.wheelsets
