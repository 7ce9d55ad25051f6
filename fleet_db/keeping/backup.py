"""A backup of database and files while everything runs, verified as it is written."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, Integer, Table, delete, func, insert, select, text, update

from estimation.errors import InputError, StorageError
from fleet_db.atomic_files import sha256_of, write_atomically
from fleet_db.keeping.kept_files import (
    RAW,
    Holdings,
    Kept,
    KeptFile,
    KeptRecording,
    Progress,
    copy_all,
    kept_files,
    kept_recordings,
    lines_of,
    not_listed,
)
from fleet_db.locks import keeping_alone
from fleet_db.migrate import check_head, head, upgrade
from fleet_db.raw import FileRawStore, RawStore, recording_name
from fleet_db.rows import key_given, key_of
from fleet_db.session import IMMEDIATE, database_engine, read_only_engine, translate_errors
from fleet_db.storage import SqlStorage
from fleet_db.tables import Base

FORMAT = "treadwatch-backup-1"
PREFIX, SUFFIX = "backup-", ".json"


@dataclass(frozen=True, slots=True)
class Manifest:
    """One backup of a folder, whose recordings and windows they share; written last: one without it never counts."""

    name: str  # the time of the backup, which is in the names of its files
    migration: str  # of the database
    database_sha256: str
    database_bytes: int
    rows: Mapping[str, int]  # by table
    raw_files: int  # that the rows refer to
    window_files: int  # likewise
    file_bytes: int  # of what the backup is to hold
    windows_kept: bool  # whether window files are in the backup; if not, they are made again from the recordings
    missing: tuple[str, ...]  # files that the rows refer to and that were not there, or damaged
    recordings_kept: bool  # if not, their digests are in a file beside it, and their bytes in the store
    raw_store: str  # where the recordings were

    def database_file(self, folder: Path) -> Path:
        """Return where the database of this backup is."""
        return folder / f"database-{self.name}.sqlite3"


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a backup that is whole."""
    content = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1).encode()
    write_atomically(folder / f"{PREFIX}{manifest.name}{SUFFIX}", content + b"\n", durable=True)


def read_manifest(folder: Path, name: str | None = None) -> Manifest:
    """Return the manifest of a backup, of the newest where none is named; InputError: none, or a damaged one."""
    names = sorted(path.name.removeprefix(PREFIX).removesuffix(SUFFIX) for path in folder.glob(f"{PREFIX}*{SUFFIX}"))
    if not names:
        raise InputError("holds no finished backup", file=folder)
    chosen = names[-1] if name is None else name
    if chosen not in names:
        raise InputError(f"holds no backup {chosen!r}; there are {', '.join(names)}", file=folder)
    path = folder / f"{PREFIX}{chosen}{SUFFIX}"
    try:
        fields = json.loads(path.read_bytes())
        written_as = fields.pop("format")
        manifest = Manifest(**{**fields, "missing": tuple(fields["missing"])})
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError("is no manifest of a backup", file=path) from error
    if written_as != FORMAT:
        raise InputError(f"has format {written_as!r}; this version reads {FORMAT!r}", file=path)
    return manifest


BATCH = 2000


def row_counts(connection: Connection) -> dict[str, int]:
    """Return the number of rows of every table."""
    return {
        table.name: int(connection.execute(select(func.count()).select_from(table)).scalar_one())
        for table in Base.metadata.sorted_tables
    }


def copy_rows(source: Connection, target: Connection) -> dict[str, int]:
    """Make every table hold the rows of another database, and no others; return their numbers by table."""
    for table in reversed(Base.metadata.sorted_tables):
        target.execute(delete(table))
    counts = {table.name: _copy_table(source, target, table) for table in Base.metadata.sorted_tables}
    if target.dialect.name == "postgresql":
        for table in Base.metadata.sorted_tables:
            _continue_numbers(target, table)
    return counts


def _copy_table(source: Connection, target: Connection, table: Table) -> int:
    """Copy one table; references of its rows to each other are filled in when all rows are there."""
    inner = [column.name for column in table.columns if any(key.column.table is table for key in column.foreign_keys)]
    statement = select(table).order_by(*table.primary_key)
    read = source.execution_options(stream_results=True, yield_per=BATCH).execute(statement)
    count = 0
    later: list[dict[str, Any]] = []
    for rows in read.mappings().partitions():
        count += len(rows)
        referring = [row for row in rows if any(row[name] is not None for name in inner)]
        later += [key_of(table, dict(row)) | {name: row[name] for name in inner} for row in referring]
        target.execute(insert(table), [{**row, **dict.fromkeys(inner)} for row in rows])
    if later:
        target.execute(update(table).where(key_given(table)), later)
    return count


def _continue_numbers(target: Connection, table: Table) -> None:
    """Let PostgreSQL number new rows after those that were copied."""
    keys = list(table.primary_key)
    if len(keys) != 1 or not isinstance(keys[0].type, Integer):
        return
    name, key = table.name, keys[0].name
    sequence = target.scalar(text("SELECT pg_get_serial_sequence(:name, :key)"), {"name": name, "key": key})
    largest = target.scalar(select(func.max(keys[0])))
    if sequence is not None and largest is not None:
        last = {"sequence": sequence, "last": largest}
        target.execute(text("SELECT setval(CAST(:sequence AS regclass), :last)"), last)


@dataclass(frozen=True, slots=True)
class BackupPlan:
    """What a backup holds beside the database."""

    windows: bool = True  # whether window files; without them a restore makes them again from the recordings
    recordings: bool | None = None  # None: where the store has no copies of its own; of others their digests are kept


EVERYTHING = BackupPlan()


def back_up(
    storage: SqlStorage, raw: RawStore, folder: Path, now_ns: int, *, plan: BackupPlan = EVERYTHING, progress: Progress
) -> Manifest:
    """Write a backup into a folder and return its manifest, which is written last.

    The database comes first, as one snapshot, then the files that it refers to: files are added before the rows that
    refer to them, and only a purge deletes them, which waits for a backup. Files that an earlier backup of the folder
    has already are not copied again.

    Raises:
        ConflictError: Another backup, restore or purge is running.
        MigrationError: The database is not at the migration of this version.
    """
    check_head(storage.engine)
    seconds, rest = divmod(now_ns, 1_000_000_000)
    name = f"{datetime.fromtimestamp(seconds, UTC):%Y%m%dT%H%M%S}.{rest // 1_000_000:03d}Z"  # in the order of time
    with keeping_alone(storage.engine):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"{folder}: cannot be made: {error.strerror}") from error
        database = folder / f"database-{name}.sqlite3"
        part = database.with_suffix(".part")
        try:
            _snapshot(storage.engine, part)
            part.replace(database)
        finally:
            for leftover in folder.glob(f"{part.name}*"):
                leftover.unlink()
        rows, recordings, files = _contents(database, windows=plan.windows)
        copied = raw.saved_by_backup if plan.recordings is None else plan.recordings
        wrong: list[tuple[Kept, str]] = []
        if not copied:
            progress(0, len(recordings))
            wrong += not_listed(recordings, raw)
            listed = "".join(f"{file.digest}  {recording_name(file.digest, file.suffix)}\n" for file in recordings)
            # as `sha256sum --check` reads it
            write_atomically(folder / f"recordings-{name}.sha256", listed.encode(), durable=True)
        to_copy: list[Kept] = [*(recordings if copied else ()), *files]
        here = Holdings(storage.data_dir, raw)
        wrong += copy_all(to_copy, here, Holdings(folder, FileRawStore(folder / RAW)), progress)
        manifest = Manifest(
            name=name,
            migration=head(),
            database_sha256=sha256_of(database),
            database_bytes=database.stat().st_size,
            rows=rows,
            raw_files=len(recordings),
            window_files=len(files),
            file_bytes=sum(file.size for file in to_copy),
            windows_kept=plan.windows,
            missing=lines_of(wrong, here),
            recordings_kept=copied,
            raw_store=raw.url,
        )
        write_manifest(folder, manifest)
    return manifest


def _snapshot(engine: Engine, target: Path) -> None:
    """Write all rows, as one snapshot, to a new SQLite file that is whole without a log beside it."""
    if engine.dialect.name == "sqlite":
        with translate_errors(), engine.connect() as connection, closing(sqlite3.connect(target)) as copy:
            driver = connection.connection.driver_connection
            assert isinstance(driver, sqlite3.Connection)
            driver.backup(copy)
    else:
        _copied(engine, target)
    without_log(target)


def without_log(database: Path) -> Path:
    """Return the file after its write-ahead log went into it."""
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    return database


def _copied(engine: Engine, target: Path) -> None:
    url = f"sqlite:///{target.resolve()}"
    upgrade(url)
    new = database_engine(url)
    try:
        with (
            translate_errors(),
            engine.connect().execution_options(isolation_level="REPEATABLE READ") as source,
            source.begin(),
            new.connect().execution_options(**IMMEDIATE) as writing,
            writing.begin(),
        ):
            copy_rows(source, writing)
    finally:
        new.dispose()


def _contents(database: Path, *, windows: bool) -> tuple[dict[str, int], list[KeptRecording], list[KeptFile]]:
    engine = read_only_engine(database)
    try:
        with translate_errors(), engine.connect() as connection:
            files = list(kept_files(connection)) if windows else []
            return row_counts(connection), list(kept_recordings(connection)), files
    finally:
        engine.dispose()
