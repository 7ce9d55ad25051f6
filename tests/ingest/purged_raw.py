"""Raw recordings purged by their age, as years later."""

from __future__ import annotations

from stored_raw import raw_of

from estimation.values.units import DAY_NS
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import Retention
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage

LATER_NS = 40_000 * DAY_NS


def purge_raw(storage: SqlStorage) -> None:
    """Purge all recordings on file, at a time at which another vehicle has sent newer ones."""
    newer = ChunkRecord(
        "f" * 64, "ANOTHER", ".blf", 1, ChunkState.DECODED, None, LATER_NS, LATER_NS, 0, {}, LATER_NS, LATER_NS
    )
    with storage.write() as unit:
        unit.chunks.put(newer)
    purge(storage, raw_of(storage), Retention(recordings=31.0), LATER_NS, lambda: None)
