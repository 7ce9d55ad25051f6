"""A chunk as it is handed in: whose it is, what it is called, and its receipt while it waits to be decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from estimation.values.reasons import Reason, ReasonCode
from fleet_db.receipts import ChunkRecord, ChunkState
from ingest.received import printable_name

WAITING = Reason(ReasonCode.WAITS_FOR_DECODING, "it is received and waits to be decoded")


@dataclass(frozen=True, slots=True)
class Chunk:
    """What a sender says of a chunk.

    Attributes:
        vehicle: Code of the vehicle; it need not be registered yet.
        suffix: Of its format, such as ``.blf``.
        file_name: Under which it came.
        sender: Who sent it, or the folder it came through.
    """

    vehicle: str
    suffix: str
    file_name: str
    sender: str | None

    def receipt(self, digest: str, size_bytes: int, now_ns: int) -> ChunkRecord:
        """Return its receipt.

        Args:
            digest, size_bytes: Of its bytes.
        """
        return ChunkRecord(
            digest=digest,
            vehicle=self.vehicle,
            suffix=self.suffix,
            size_bytes=size_bytes,
            state=ChunkState.STORED,
            reason=WAITING,
            first_ns=None,
            last_ns=None,
            frames=0,
            counts={},
            received_ns=now_ns,
            recorded_ns=now_ns,
            file_name=printable_name(Path(self.file_name)),
            sender=self.sender,
        )
