"""Recordings that are decoded as if they had just been received, because their vehicle has another bus."""

from __future__ import annotations

from dataclasses import replace

from estimation.errors import ConflictError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import SubjectKind, after_failure
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.stores.chunks import ChosenChunks, ChunkStore
from fleet_db.stores.stage_marks import QuarantineStore

STAGE = "ingest"
MOST = 1_000_000
UNDECODED = (
    (ChunkState.REJECTED, ReasonCode.LOG_DAMAGED),
    (ChunkState.REJECTED, ReasonCode.CLOCK_IMPLAUSIBLE),
    (ChunkState.STORED, ReasonCode.WAITS_FOR_TIME),
)
"""What becomes of a recording that is read with a wrong bus."""


def decode_again(chunks: ChunkStore, record: ChunkRecord, why: str, now_ns: int) -> None:
    """Let a recording be decoded at the next run of the job or ingest."""
    error = ConflictError(why, kind="recording", key=record.digest)
    item = after_failure(None, (SubjectKind.RECORDING, record.digest, STAGE), record.vehicle, error, now_ns)
    QuarantineStore(chunks.connection).put(item)
    reason = Reason(item.code, item.error)
    again = replace(record, state=ChunkState.STORED, reason=reason, first_ns=None, last_ns=None)
    chunks.update(again)


def decode_undecoded(chunks: ChunkStore, vehicle: str, why: str, now_ns: int) -> None:
    """Let the recordings of a vehicle be decoded again that were rejected, or wait for a time."""
    for state, code in UNDECODED:
        for record in chunks.page(ChosenChunks(state=state, vehicle=vehicle, code=code), MOST):
            if record.purged_ns is None:
                decode_again(chunks, record, why, now_ns)
