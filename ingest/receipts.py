"""The receipt of a recording whose bytes are safe: entered once, whatever there was under its digest before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from estimation.errors import ConflictError
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from ingest.assembly import extent
from ingest.deleted import DeletedRecordings

Announce = Callable[[ChunkRecord], None]
"""Called with each committed receipt; it neither waits nor fails."""


def to_nobody(_record: ChunkRecord) -> None:
    """Announce a receipt to nobody."""


def enter_receipt(unit: SqlUnitOfWork, record: ChunkRecord, deleted: DeletedRecordings) -> tuple[ChunkRecord, bool]:
    """Store the receipt of a recording, and return what stands there now, and whether it had been there before.

    Raises:
        ConflictError: The recording was deleted, and is not wanted again; or it is of another vehicle.
    """
    if unit.chunks.put(record):
        return record, False
    found = unit.chunks.get(record.digest)
    assert found is not None
    if found.state is ChunkState.DELETED:
        deleted.take_again(unit, found, record)
        return record, False
    if found.purged_ns is not None:  # its bytes are there again
        found = replace(found, purged_ns=None)
        unit.chunks.update(found)
        for from_ns, to_ns in extent(found):  # what changed meanwhile has not reached its windows
            unit.stale_spans.add(found.vehicle, from_ns, to_ns + 1, f"recording {found.digest[:12]}: received again")
    return found, True


def of_another_vehicle(found: ChunkRecord, vehicle: str, name: str) -> ConflictError:
    """Return the refusal of a recording that another vehicle has sent."""
    digest = found.digest
    reason = (
        f"{name}: the same recording was received from vehicle {found.vehicle};"
        f" where that is wrong: treadwatch recordings reassign {digest[:12]} --vehicle {vehicle}"
    )
    return ConflictError(reason, kind="chunk", key=digest)
