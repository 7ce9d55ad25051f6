"""A backup becomes an installation again: into an empty database and a data folder, verified."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Engine, exists, inspect, select

from estimation.errors import ConflictError, InputError, StorageError
from fleet_db.atomic_files import sha256_of, sync_directory, synchronise
from fleet_db.keeping.backup import Manifest, copy_rows, read_manifest, row_counts, without_log
from fleet_db.keeping.kept_files import (
    RAW,
    Holdings,
    Kept,
    KeptFile,
    Progress,
    copy_all,
    kept_files,
    kept_recordings,
    lines_of,
    not_listed,
)
from fleet_db.locks import keeping_alone
from fleet_db.migrate import check_upgradable, known_revisions, refusal, upgrade
from fleet_db.raw import FileRawStore, RawStore
from fleet_db.rows import table_of
from fleet_db.session import IMMEDIATE, database_engine, read_only_engine, sqlite_file, translate_errors
from fleet_db.stores.assembled import StaleSpanStore
from fleet_db.stores.installation import FeedBranchStore
from fleet_db.tables import Base
from fleet_db.tables.windows import WindowRow

WINDOWS = table_of(WindowRow)
CONTENT = ("fleets", "vehicles", "wheelsets", "track_sections", "chunks")
CAUSE = "restored without the files of its windows"


@dataclass(frozen=True, slots=True)
class Restored:
    """What a restore did."""

    manifest: Manifest  # of the backup
    rows: dict[str, int]  # by table, as they are now
    files: int  # number of files that are there
    missing: tuple[str, ...]  # files that the backup does not hold, or only damaged; each with whose it is
    stale_vehicles: tuple[str, ...]  # vehicles whose windows are made again from their recordings


@dataclass(frozen=True, slots=True)
class Installation:
    """What is to be filled: URL of the database, data folder, store of raw recordings."""

    url: str
    data_dir: Path
    raw: RawStore


def restore(into: Installation, folder: Path, name: str | None = None, *, progress: Progress) -> Restored:
    """Restore a backup; files first, then all rows in one step, so that an interrupted restore can be repeated.

    The database must be without content, SQLite or PostgreSQL whatever the backup was made of. Files in the data folder
    and recordings in the store stay. Without a name it is the newest backup.

    Raises:
        InputError: There is no such backup, its database is damaged, or it is of a version that no upgrade leads from.
        ConflictError: The database has content, or another backup, restore or purge is running.
        MigrationError: No upgrade of this version leads from the migration of the database.
    """
    manifest = read_manifest(folder, name)
    _check(manifest, folder)
    engine = database_engine(into.url)
    try:
        with keeping_alone(engine):
            _check_without_content(engine)
            return _restored(engine, into, folder, manifest, progress)
    finally:
        engine.dispose()


def _check(manifest: Manifest, folder: Path) -> None:
    database = manifest.database_file(folder)
    if not database.is_file():
        raise InputError("the database of the backup is missing", file=database)
    if sha256_of(database) != manifest.database_sha256:
        reason = "the database of the backup is damaged: it has another sha256 than its manifest"
        raise InputError(reason, file=database)
    if manifest.migration not in known_revisions():
        raise InputError(str(refusal(manifest.migration)), file=database)


def _check_without_content(engine: Engine) -> None:
    file = sqlite_file(engine)
    if file is not None and not file.exists():
        return
    with translate_errors(), engine.connect() as connection:
        check_upgradable(connection)
        there = set(inspect(connection).get_table_names()) & set(CONTENT)
        tables = [Base.metadata.tables[name] for name in sorted(there)]
        full = [table.name for table in tables if connection.scalar(select(exists().select_from(table)))]
    if full:
        reason = f"the database has content ({', '.join(full)}); restore into an empty one"
        raise ConflictError(reason, kind="database", key=full[0])


def _restored(engine: Engine, into: Installation, folder: Path, manifest: Manifest, progress: Progress) -> Restored:
    into.data_dir.mkdir(parents=True, exist_ok=True)
    with _at_this_version(manifest, folder, into.data_dir) as database:
        reading = read_only_engine(database)
        try:
            with translate_errors(), reading.connect() as source:
                recordings = list(kept_recordings(source))
                files = list(kept_files(source)) if manifest.windows_kept else []
                lost = [] if manifest.recordings_kept else not_listed(recordings, into.raw)
                skipped = 0 if manifest.recordings_kept else len(recordings)
                to_copy: list[Kept] = [*recordings[skipped:], *files]
                here, saved = Holdings(into.data_dir, into.raw), Holdings(folder, FileRawStore(folder / RAW))
                lost += copy_all(to_copy, saved, here, lambda done, total: progress(done + skipped, total + skipped))
                stale = _stale(source, manifest, [file for file, _ in lost if isinstance(file, KeptFile)])
                rows = _store_rows(engine, into.url, source, database, stale)
        finally:
            reading.dispose()
    return Restored(manifest, rows, len(recordings) + len(files) - len(lost), lines_of(lost, here), stale)


@contextmanager
def _at_this_version(manifest: Manifest, folder: Path, data_dir: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix=".restoring-", dir=data_dir) as name:
        database = Path(name) / "database.sqlite3"
        shutil.copyfile(manifest.database_file(folder), database)
        upgrade(f"sqlite:///{database.resolve()}")
        yield without_log(database)


def _stale(source: Connection, manifest: Manifest, lost: list[KeptFile]) -> tuple[str, ...]:
    kept = WINDOWS.c.samples_purged_ns.is_(None)
    statement = select(WINDOWS.c.vehicle).where(kept).distinct().order_by(WINDOWS.c.vehicle)
    if manifest.windows_kept:
        digests = [file.digest for file in lost]
        statement = statement.where(WINDOWS.c.content_digest.in_(digests))
    return tuple(source.scalars(statement))


def _store_rows(engine: Engine, url: str, source: Connection, database: Path, stale: tuple[str, ...]) -> dict[str, int]:
    file = sqlite_file(engine)
    if file is None:
        upgrade(url)
        with translate_errors(), engine.connect() as target, target.begin():
            copy_rows(source, target)
            return _finished(target, stale)
    engine.dispose()
    part = file.with_name(f".{file.name}.restoring")
    try:
        shutil.copyfile(database, part)
        new = database_engine(f"sqlite:///{part.resolve()}")
        try:
            with translate_errors(), new.connect().execution_options(**IMMEDIATE) as target, target.begin():
                rows = _finished(target, stale)
        finally:
            new.dispose()
        synchronise(without_log(part))
        for leftover in ("-wal", "-shm"):
            file.with_name(f"{file.name}{leftover}").unlink(missing_ok=True)
        part.replace(file)
        sync_directory(file.parent)
    except OSError as error:
        raise StorageError(f"{file}: cannot be written: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)
    return rows


def _finished(target: Connection, stale: tuple[str, ...]) -> dict[str, int]:
    """Let windows without files be made again and begin a branch of the feed; return the numbers of rows."""
    spans = StaleSpanStore(target)
    for vehicle in stale:
        spans.add(vehicle, None, None, CAUSE)
    FeedBranchStore(target).begin(time.time_ns())  # cursors that are behind the backup are refused from now on
    return row_counts(target)
