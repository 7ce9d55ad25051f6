"""Chunks: their receipts as a sender needs them."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from api.schemas.common import Links, Representation
from api.schemas.quarantine import without_folders
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.quarantine import TRIED_AGAIN
from estimation.values.reasons import ReasonCode
from fleet_db.receipts import ChunkRecord, ChunkState


class ChunkProgress(StrEnum):
    """Where a chunk stands."""

    RECEIVED = "received"  # stored; not decoded yet
    ASSEMBLED = "assembled"  # its windows are made
    QUARANTINED = "quarantined"  # it could not be decoded
    SET_ASIDE = "set_aside"
    DELETED = "deleted"


class Chunk(Representation):
    """The receipt of a chunk: its bytes are on the disk, and it will be decoded without being sent again."""

    sha256: str = Field(description="Of its bytes: its identity.", examples=["ab" * 32])
    vehicle: str = Field(description="Code of the vehicle that it came for; it need not be registered.")
    format: str = Field(description="Of its bytes.", examples=["blf"])
    file_name: str | None = Field(description="Under which it came.")
    size_bytes: int = Field(description="Of its bytes as they came.")
    received_at: Timestamp = Field(description="When its receipt was committed, by our clock.")
    sender: str | None = Field(description="Who sent it; null where access is open, or it came another way.")
    state: ChunkProgress = Field(
        description="`received`: stored, not decoded yet. `assembled`: its windows are made. `quarantined`: it could"
        " not be decoded, see the reason; the bytes are kept. `set_aside`, `deleted`: by hand."
    )
    reason: str | None = Field(description="Why it is in this state; null where there is nothing to say.")
    reason_code: ReasonCode | None = Field(description="Why it is in this state; null where there is nothing to say.")
    links: Links


def chunk(record: ChunkRecord) -> Chunk:
    """Return the representation of a receipt."""
    return Chunk(
        sha256=record.digest,
        vehicle=record.vehicle,
        format=record.suffix.removeprefix("."),
        file_name=record.file_name,
        size_bytes=record.size_bytes,
        received_at=to_rfc3339(record.received_ns),
        sender=record.sender,
        state=progress(record),
        reason=None if record.reason is None else without_folders(record.reason.text),
        reason_code=None if record.reason is None else record.reason.code,
        links={
            "self": f"/v1/chunks/{record.digest}",
            "recording": f"/v1/recordings/{record.digest}",
            "vehicle": f"/v1/vehicles/{segment(record.vehicle)}",
        },
    )


def progress(record: ChunkRecord) -> ChunkProgress:
    """Return where a chunk stands."""
    if record.state is ChunkState.DECODED:
        return ChunkProgress.ASSEMBLED
    if record.state in {ChunkState.SET_ASIDE, ChunkState.DELETED}:
        return ChunkProgress(record.state.value)
    failed = record.reason is not None and record.reason.code in TRIED_AGAIN
    return ChunkProgress.QUARANTINED if failed or record.state is ChunkState.REJECTED else ChunkProgress.RECEIVED
