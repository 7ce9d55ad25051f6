"""What waits to be decoded or assembled: whether more chunks may come, how they are decoded, and the scheduled job.

The job reads raw recordings, so it is defined here and joins the other jobs where all is joined.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

from estimation.jobs.job import JobContext
from estimation.jobs.runner import run as run_stage
from estimation.values.reasons import ReasonCode, code_of
from fleet_db.atomic_files import passing_faults
from fleet_db.locks import TryVehicle, decoding_locks
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.reassembly import ASSEMBLY, HeldRecordings, missing
from ingest.receiver import ChunkReceipt, Receiver

LOOK_EVERY_S = 1.0  # how long what the database said counts; what was taken since is added to it


class Limit(StrEnum):
    """Which limit keeps chunks out."""

    CHUNKS = "chunks"
    BYTES = "bytes"
    DISK = "disk"


@dataclass(frozen=True, slots=True)
class BacklogLimits:
    """How much may wait to be decoded, and how much of the disk stays free."""

    chunks: int
    size_bytes: int
    free_bytes: int  # that no chunk may take


@dataclass(frozen=True, slots=True)
class Behind:
    """A limit that is reached, in a sentence."""

    limit: Limit
    text: str


@dataclass(slots=True)
class BacklogWatch:
    """Says whether a chunk may come; asks database and disk at most once a second."""

    storage: SqlStorage
    folder: Path
    limits: BacklogLimits
    now_s: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _looked_s: float = float("-inf")
    _chunks: int = 0
    _size_bytes: int = 0
    _free_bytes: int = 0

    @property
    def fresh(self) -> bool:
        """Whether :meth:`behind` answers without asking database and disk."""
        return self.now_s() - self._looked_s < LOOK_EVERY_S

    def behind(self, size_bytes: int) -> Behind | None:
        """Return the limit that keeps a chunk out; None where it may come, and counts from now on."""
        with self._lock:
            if not self.fresh:
                with self.storage.read() as unit:
                    waiting = unit.chunks.undecoded_size()
                self._chunks, self._size_bytes = waiting.count, waiting.size_bytes
                self._free_bytes = free_bytes(self.folder)
                self._looked_s = self.now_s()
            found = self._found(size_bytes)
            if found is None:
                self._chunks += 1
                self._size_bytes += size_bytes
                self._free_bytes -= size_bytes
            return found

    def _found(self, size_bytes: int) -> Behind | None:
        limits = self.limits
        if self._chunks >= limits.chunks:
            return Behind(Limit.CHUNKS, f"{self._chunks:,} chunks wait to be decoded, {limits.chunks:,} may")
        if self._size_bytes + size_bytes > limits.size_bytes:
            text = f"{self._size_bytes:,} bytes wait to be decoded, {limits.size_bytes:,} may"
            return Behind(Limit.BYTES, text)
        if self._free_bytes - size_bytes < limits.free_bytes:
            return Behind(Limit.DISK, f"the disk has {self._free_bytes:,} bytes left, {limits.free_bytes:,} stay free")
        return None


def free_bytes(folder: Path) -> int:
    """Return how much room is left where a folder is, or will be made."""
    there = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.is_dir())
    with passing_faults(there):
        return shutil.disk_usage(there).free


AT_ONCE = 100  # receipts in memory; the log of one is read at a time, in a process of its own


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

    ``checkpoint`` is called between two chunks with (done, of how many as far as known); it may raise to end the work.
    """
    counts, after = DecodedChunks(), (-1, "")
    with decoding_locks(storage.engine, holder) as try_vehicle:
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


def assemble_windows(receiver_of: Callable[[JobContext], Receiver], context: JobContext) -> Mapping[str, int]:
    """Assemble windows of stale spans again; decode recordings whose vehicle has come, or that are due again.

    The receiver is asked for only where there is something to do.
    """
    counts = dict.fromkeys(("spans", "decoded", "new", "changed", "removed", "healed", "quarantined"), 0)
    with context.storage.read() as unit:
        counts["spans"] = len(unit.stale_spans.all())
        waiting = list(unit.chunks.of_known_vehicles())
        looked_for = missing(unit)
        received = unit.chunks.undecoded_size().count
        waiting += HeldRecordings(context.storage, context.clock).due(unit)
    if not counts["spans"] and not waiting and not looked_for and not received:
        return counts
    receiver = receiver_of(context)
    receipts = [answer.record for answer in receiver.decode(waiting) if isinstance(answer, ChunkReceipt)]
    counts["decoded"] = sum(record.state is ChunkState.DECODED for record in receipts)
    counts["decoded"] += decode_received(context.storage, receiver, ASSEMBLY, context.checkpoint).decoded
    receiver.reassembler.lost.look()
    made = run_stage(receiver.reassembler.stage, replace(context, executor=None))  # workers have no recordings
    return counts | {name: count for name, count in made.items() if name not in {"vehicles", "results"}}
