"""What is received is decoded, a bounded number of receipts at a time, by any number of workers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from estimation.values.reasons import ReasonCode, code_of
from fleet_db.decoding_locks import TryVehicle, decoding_locks
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.receiver import ChunkReceipt, Receiver

AT_ONCE = 100
"""Receipts in memory; the log of one is read at a time, in a process of its own."""


@dataclass(slots=True)
class DecodedChunks:
    """How many were decoded, and how many could not be: these are rejected, in quarantine, or wait for something."""

    decoded: int = 0
    others: int = 0


def decode_received(
    storage: SqlStorage,
    receiver: Receiver,
    holder: str,
    checkpoint: Callable[[int, int], None],
    vehicle: str | None = None,
) -> DecodedChunks:
    """Decode the chunks that wait for a worker when this begins or come meanwhile, but for those of other workers.

    Args:
        checkpoint: Called between two chunks with (done, of how many as far as known); it may raise to end the work.
    """
    counts, after = DecodedChunks(), (-1, "")
    with decoding_locks(storage, holder) as try_vehicle:
        while True:
            with storage.read() as unit:
                batch = unit.chunks.undecoded(AT_ONCE, after, vehicle)
                total = unit.chunks.undecoded_size().count
            for record in batch:
                _decode(storage, receiver, try_vehicle, record, counts)
                after = (record.recorded_ns, record.digest)
                done = counts.decoded + counts.others
                checkpoint(done, done + total)
            if len(batch) < AT_ONCE:
                return counts


def _decode(
    storage: SqlStorage, receiver: Receiver, try_vehicle: TryVehicle, record: ChunkRecord, counts: DecodedChunks
) -> None:
    with try_vehicle(record.vehicle) as locked:
        if not locked:
            return
        with storage.read() as unit:
            now = unit.chunks.get(record.digest)
        if now is None or code_of(now.reason) is not ReasonCode.WAITS_FOR_DECODING:
            return
        for outcome in receiver.decode([now]):
            good = isinstance(outcome, ChunkReceipt) and outcome.record.state is ChunkState.DECODED
            counts.decoded += good
            counts.others += not good
