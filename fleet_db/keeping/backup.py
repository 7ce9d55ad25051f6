"""A backup of database and files while everything runs, verified as it is written."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Engine

from estimation.errors import StorageError
from fleet_db.keeping.exclusive import keeping_alone
from fleet_db.keeping.kept_files import (
    RAW,
    KeptFile,
    KeptRecording,
    copy_kept,
    copy_recording,
    kept_files,
    kept_recordings,
    not_listed,
    write_digests,
)
from fleet_db.keeping.manifest import (
    Manifest,
    backup_name,
    copy_rows,
    digests_file,
    row_counts,
    sha256_of,
    write_manifest,
)
from fleet_db.migrate import check_head, head, upgrade
from fleet_db.raw import RawStore
from fleet_db.raw_files import FileRawStore
from fleet_db.session import IMMEDIATE, database_engine, read_only_engine, translate_errors
from fleet_db.storage import SqlStorage

Progress = Callable[[int, int], None]


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

    Args:
        folder: Of the backups; made if it is not there.
        progress: Called with (done, total) files.

    Raises:
        ConflictError: Another backup, restore or purge is running.
        MigrationError: The database is not at the migration of this version.
        StorageError, PassingFaultError: The database, a file or a recording cannot be read or written; the folder holds
            no manifest then.
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
        rows, recordings, files = _contents(database, windows=plan.windows)
        copied = raw.saved_by_backup if plan.recordings is None else plan.recordings
        missing = _recordings(recordings, raw, folder, name, progress) if not copied else []
        to_copy: list[KeptRecording | KeptFile] = [*(recordings if copied else ()), *files]
        for done, one in enumerate(to_copy, start=1):
            missing += _copied_or_not(one, storage.data_dir, raw, folder)
            progress(done, len(to_copy))
        manifest = Manifest(
            name=name,
            migration=head(),
            database_sha256=sha256_of(database),
            database_bytes=database.stat().st_size,
            rows=rows,
            raw_files=len(recordings),
            window_files=len(files),
            file_bytes=sum(one.size for one in to_copy),
            windows_kept=plan.windows,
            missing=tuple(missing),
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


def _contents(database: Path, *, windows: bool) -> tuple[dict[str, int], list[KeptRecording], list[KeptFile]]:
    """Return the rows by table, and the recordings and files that a database file refers to."""
    engine = read_only_engine(database)
    try:
        with translate_errors(), engine.connect() as connection:
            files = list(kept_files(connection)) if windows else []
            return row_counts(connection), list(kept_recordings(connection)), files
    finally:
        engine.dispose()


def _copied_or_not(one: KeptRecording | KeptFile, data_dir: Path, raw: RawStore, folder: Path) -> list[str]:
    """Copy a recording or file; return a line for one that is not there, or damaged."""
    if isinstance(one, KeptFile):
        place, fault = str(one.path), copy_kept(one, data_dir, folder)
    else:
        place, fault = raw.place(one.digest, one.suffix), copy_recording(one, raw, FileRawStore(folder / RAW))
    return [] if fault is None else [f"{place} {fault} ({one.owner})"]


def _recordings(
    recordings: Sequence[KeptRecording], raw: RawStore, folder: Path, name: str, progress: Progress
) -> list[str]:
    """Write down the digests of recordings that are not copied; return a line for each that their store lacks."""
    progress(0, len(recordings))
    wrong = not_listed(recordings, raw)
    write_digests(digests_file(folder, name), recordings)
    return [f"{raw.place(kept.digest, kept.suffix)} {fault} ({kept.owner})" for kept, fault in wrong]
