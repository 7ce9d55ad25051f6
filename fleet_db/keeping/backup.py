"""A backup of database and files while everything runs, verified as it is written."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from sqlalchemy import Engine

from estimation.errors import StorageError
from fleet_db.keeping.copied_rows import copy_rows, row_counts
from fleet_db.keeping.exclusive import keeping_alone
from fleet_db.keeping.kept_files import RAW, KeptFile, copy_kept, kept_files
from fleet_db.keeping.manifest import Manifest, backup_name, sha256_of, write_manifest
from fleet_db.migrate import upgrade
from fleet_db.revisions import check_head, head
from fleet_db.session import IMMEDIATE, database_engine, read_only_engine, translate_errors
from fleet_db.storage import SqlStorage

Progress = Callable[[int, int], None]


def back_up(storage: SqlStorage, folder: Path, now_ns: int, *, windows: bool = True, progress: Progress) -> Manifest:
    """Write a backup into a folder and return its manifest, which is written last.

    The database comes first, as one snapshot, then the files that it refers to: files are added before the rows that
    refer to them, and only a purge deletes them, which waits for a backup. Files that an earlier backup of the folder
    has already are not copied again.

    Parameters
    ----------
    storage
        What is backed up.
    folder
        Of the backups; made if it is not there.
    now_ns
        Our time, ns UTC.
    windows
        Whether window files are backed up, too; without them a restore makes them again from the recordings.
    progress
        Called with (done, total) files.

    Raises
    ------
    ConflictError
        Another backup, restore or purge is running.
    MigrationError
        The database is not at the migration of this version.
    StorageError
        The database or a file cannot be read or written; the folder holds no manifest then.
    """
    check_head(storage.engine)
    name = backup_name(now_ns)
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
        rows, files = _contents(database, windows=windows)
        missing = _copy_files(files, storage.data_dir, folder, progress)
        raw = sum(file.kind == RAW for file in files)
        manifest = Manifest(
            name=name,
            migration=head(),
            database_sha256=sha256_of(database),
            database_bytes=database.stat().st_size,
            rows=rows,
            raw_files=raw,
            window_files=len(files) - raw,
            file_bytes=sum(file.size for file in files),
            windows_kept=windows,
            missing=tuple(missing),
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
    with closing(sqlite3.connect(target)) as copy:
        copy.execute("PRAGMA journal_mode = DELETE")


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


def _contents(database: Path, *, windows: bool) -> tuple[dict[str, int], list[KeptFile]]:
    """Return the rows by table and the files that a database file refers to."""
    engine = read_only_engine(database)
    try:
        with translate_errors(), engine.connect() as connection:
            return row_counts(connection), list(kept_files(connection, windows=windows))
    finally:
        engine.dispose()


def _copy_files(files: list[KeptFile], source: Path, target: Path, progress: Progress) -> list[str]:
    """Copy files; return those that are not there, or damaged, each with what is wrong."""
    missing = []
    for done, file in enumerate(files, start=1):
        fault = copy_kept(file, source, target)
        if fault is not None:
            missing.append(f"{file.path} {fault} ({file.owner})")
        progress(done, len(files))
    return missing
