"""Files of the data folder that no row refers to: of replaced windows, and what a killed process left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import Connection, select

from estimation.errors import StorageError
from fleet_db.keeping.kept_files import RAW, SAMPLES
from fleet_db.models import ChunkRow, WindowRow
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage

CHUNKS, WINDOWS = table_of(ChunkRow), table_of(WindowRow)
LEAST_AGE_S = 3600.0
"""A file may be older than its row by the length of the transaction that stores it."""


def orphans(storage: SqlStorage, least_age_s: float = LEAST_AGE_S) -> list[Path]:
    """Return the files below ``raw`` and ``windows`` that no row refers to, relative to the data folder.

    Parameters
    ----------
    storage
        Database and data folder.
    least_age_s
        Younger files do not count: their rows may be about to be committed.

    Raises
    ------
    StorageError
        A directory cannot be read.
    """
    files = sorted(_old_files(storage.data_dir, least_age_s))  # before the rows: these only grow more
    with storage.read() as unit:
        known = _referred(unit.connection)
    return [path for path in files if path.name.partition(".")[0] not in known[path.parts[0]]]


def unlink_old(path: Path, least_age_s: float) -> int | None:
    """Delete a file unless it has been written or used again since it was found; return its size, None if it stays.

    Parameters
    ----------
    path
        The file.
    least_age_s
        Age that it must have now.
    """
    try:
        found = path.stat()
        if found.st_mtime > time.time() - least_age_s:
            return None
        path.unlink()
    except FileNotFoundError:
        return None
    return found.st_size


def _old_files(data_dir: Path, least_age_s: float) -> Iterator[Path]:
    """Yield the files that have not been changed for a while; by the clock of the file system and this machine."""
    before = time.time() - least_age_s
    for kind in (RAW, SAMPLES):
        try:
            for path in (data_dir / kind).rglob("*"):
                if path.is_file() and path.stat().st_mtime <= before and not _marker(path):
                    yield path.relative_to(data_dir)
        except FileNotFoundError:
            continue  # replaced or removed meanwhile
        except OSError as error:
            raise StorageError(f"{data_dir / kind}: cannot be read: {error.strerror}") from error


def _marker(path: Path) -> bool:
    """Whether a file marks the directory itself."""
    return path.parent.name in (RAW, SAMPLES) and not path.name.startswith(".incoming-")


def _referred(connection: Connection) -> dict[str, frozenset[str]]:
    """Return the digests of the files that rows refer to, by directory."""
    return {
        RAW: frozenset(connection.scalars(select(CHUNKS.c.digest).where(CHUNKS.c.purged_ns.is_(None)))),
        SAMPLES: frozenset(
            connection.scalars(select(WINDOWS.c.content_digest).where(WINDOWS.c.samples_purged_ns.is_(None)).distinct())
        ),
    }
