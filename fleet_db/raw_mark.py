"""Whether the folder of raw recordings is that of this database, or the bare place where it should be mounted.

A file in the folder holds a mark that the database knows. A folder without it is marked where it cannot be a bare
mount point: the database has no receipt yet, or recordings of its receipts are in the folder (after a restore, or of an
earlier version).
"""

from __future__ import annotations

import uuid
from pathlib import Path

from estimation.errors import PassingFaultError
from fleet_db.atomic_files import write_atomically
from fleet_db.passing import passing_faults
from fleet_db.raw import RawStore
from fleet_db.storage import SqlStorage, SqlUnitOfWork

MARK_FILE = "treadwatch-raw-store"
LOOKED_FOR = 10
"""So many of the oldest and of the newest receipts are looked for in a folder without the mark."""


def check_raw_store(storage: SqlStorage, raw: RawStore, now_ns: int) -> str:
    """Return the mark of the folder of raw recordings; mark it at its first use.

    Parameters
    ----------
    storage
        The database.
    raw
        The folder.
    now_ns
        Our time.

    Raises
    ------
    PassingFaultError
        The folder is not that of this database: not mounted, or another one; or it cannot be read or written.
    """
    found = stored_mark(raw)
    with storage.read() as unit:
        known = unit.raw_marks.get()
        if found is not None and found == known:
            return found
        if not _belongs(unit, raw):
            raise not_mounted(raw)
    with storage.write() as unit:
        mark = found or unit.raw_marks.get() or uuid.uuid4().hex
        if unit.raw_marks.get() != mark:
            unit.raw_marks.set(mark, now_ns)
    if found is None:
        with passing_faults(raw.directory):
            write_atomically(_file(raw), f"{mark}\n".encode(), durable=True)
    return mark


def stored_mark(raw: RawStore) -> str | None:
    """Return the mark that is in the folder; None where there is none.

    Raises
    ------
    PassingFaultError
        The folder cannot be read.
    """
    with passing_faults(raw.directory):
        try:
            return _file(raw).read_text(encoding="ascii", errors="replace").strip() or None
        except FileNotFoundError:
            return None


def not_mounted(raw: RawStore) -> PassingFaultError:
    """Return the refusal of a folder that is not that of the database."""
    reason = (
        "holds no recording of this database and not its mark: is it mounted?"
        " Nothing is written there until it is the folder of the recordings again"
    )
    return PassingFaultError(reason, file=raw.directory)


def _belongs(unit: SqlUnitOfWork, raw: RawStore) -> bool:
    some = unit.chunks.ends(LOOKED_FOR)
    return not some or any(raw.path(record.digest, record.suffix).is_file() for record in some)


def _file(raw: RawStore) -> Path:
    return raw.directory / MARK_FILE
