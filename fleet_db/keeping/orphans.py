"""Stored things that no row refers to: files of replaced windows, recordings, and what a killed process left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import select

from estimation.errors import StorageError
from fleet_db.keeping.kept_files import SAMPLES
from fleet_db.raw import RawItem, RawStore
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables import ChunkRow, WindowRow

CHUNKS, WINDOWS = table_of(ChunkRow), table_of(WindowRow)
LEAST_AGE_S = 3600.0  # a file may be older than its row by the length of the transaction that stores it


def orphaned_samples(storage: SqlStorage, least_age_s: float = LEAST_AGE_S) -> list[Path]:
    """Return the files of windows that no row refers to, relative to the data folder; younger ones do not count."""
    files = sorted(_old_files(storage.data_dir, least_age_s))  # before the rows: these only grow more
    kept = select(WINDOWS.c.content_digest).where(WINDOWS.c.samples_purged_ns.is_(None)).distinct()
    with storage.read() as unit:
        known = frozenset(unit.connection.scalars(kept))
    return [path for path in files if path.name.partition(".")[0] not in known]


def orphaned_recordings(storage: SqlStorage, raw: RawStore, least_age_s: float = LEAST_AGE_S) -> list[RawItem]:
    """Return what is in the store of raw recordings and no row refers to."""
    before_s = time.time() - least_age_s
    items = sorted((one for one in raw.listed() if one.changed_s <= before_s), key=lambda one: one.place)
    with storage.read() as unit:
        known = frozenset(unit.connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_(None))))
    return [one for one in items if one.digest not in known]


def _old_files(data_dir: Path, least_age_s: float) -> Iterator[Path]:
    """Yield the files that have not been changed for a while; by the clock of the file system and this machine."""
    before, folder = time.time() - least_age_s, data_dir / SAMPLES
    try:
        for path in folder.rglob("*"):
            try:
                if path.parent != folder and path.is_file() and path.stat().st_mtime <= before:
                    yield path.relative_to(data_dir)
            except FileNotFoundError:
                continue  # replaced or removed meanwhile
    except OSError as error:
        raise StorageError(f"{folder}: cannot be read: {error.strerror}") from error
