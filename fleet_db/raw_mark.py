"""Whether the store of raw recordings is that of this database, or a bare place where a folder should be mounted.

A mark in the store is known to the database. A store without it is marked where it cannot be another one: the database
has no receipt yet, or recordings of its receipts are in the store (after a restore).
"""

from __future__ import annotations

import uuid

from estimation.errors import PassingFaultError
from fleet_db.raw import RawStore
from fleet_db.storage import SqlStorage, SqlUnitOfWork

LOOKED_FOR = 10
"""So many of the oldest and of the newest receipts are looked for in a store without the mark."""


def check_raw_store(storage: SqlStorage, raw: RawStore, now_ns: int) -> str:
    """Return the mark of the store of raw recordings; mark it at its first use.

    Raises:
        PassingFaultError: The store is not that of this database: not mounted, or another one; or it cannot be read or
            written.
    """
    found = raw.read_mark()
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
        raw.write_mark(mark)
    return mark


def not_mounted(raw: RawStore) -> PassingFaultError:
    """Return the refusal of a store that is not that of the database."""
    reason = (
        "holds no recording of this database and not its mark: is it mounted? Is it the right one?"
        " Nothing is written there until it is the store of the recordings again"
    )
    return PassingFaultError(reason, file=raw.url)


def _belongs(unit: SqlUnitOfWork, raw: RawStore) -> bool:
    some = unit.chunks.ends(LOOKED_FOR)
    return not some or any(raw.holds(record.digest, record.suffix) for record in some)
