"""The receipt of a recording whose bytes are safe: entered once, whatever there was under its digest before.

Finished files that come many at a time get their receipts in one transaction.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

from estimation.errors import BusyError, ConflictError
from estimation.storage import Clock
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.raw import IncomingFile, RawStore, check_raw_store
from fleet_db.records import ChunkRecord, ChunkState, RecordingAction, RecordingChange
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.assembly import SpanAssembly, add_stale
from ingest.recordings import Recording

UNDECODABLE = frozenset({ChunkState.REJECTED, ChunkState.SET_ASIDE, ChunkState.DELETED})
"""States of recordings that count for no window."""


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file whose bytes are durable, read if it can be read."""

    path: Path
    vehicle: str
    digest: str
    recording: Recording | Exception


@dataclass(frozen=True, slots=True)
class Decoded:
    """What a recording makes: receipts, its own first, and the windows that it touches, where it has a place."""

    receipts: tuple[ChunkRecord, ...]
    assembly: SpanAssembly | None


TAKE_DELETED = "--take-deleted"  # the option that asks for it


@dataclass(frozen=True, slots=True)
class DeletedRecordings:
    """What is done with recordings that were deleted and come again.

    They are refused, or taken in where somebody (``taken_by``) wants that.
    """

    storage: SqlStorage
    taken_by: str | None

    def receipt(self, digest: str) -> ChunkRecord | None:
        """Return the receipt of a deleted recording; None of any other, and where they are taken in."""
        if self.taken_by is not None:
            return None
        with self.storage.read() as unit:
            record = unit.chunks.get(digest)
        return record if record is not None and record.state is ChunkState.DELETED else None

    def admit(self, digest: str) -> None:
        """Refuse a recording that was deleted, before its bytes are stored."""
        deleted = self.receipt(digest)
        if deleted is not None:
            raise _refusal(deleted)

    def refuse(self, record: ChunkRecord) -> None:
        """Refuse a recording whose receipt says that it was deleted, where that is not wanted again."""
        if self.taken_by is None and record.state is ChunkState.DELETED:
            raise _refusal(record)

    def take_again(self, unit: SqlUnitOfWork, deleted: ChunkRecord, record: ChunkRecord) -> None:
        """Put a new receipt in the place of that of a deleted recording, with its record."""
        if self.taken_by is None:
            raise _refusal(deleted)
        unit.chunks.update(record)
        action = RecordingAction.TAKE_AGAIN
        before, after = (deleted.vehicle, deleted.state), (record.vehicle, record.state)
        change = RecordingChange(
            record.digest, action, record.recorded_ns, self.taken_by, TAKE_DELETED, *before, *after
        )
        unit.recording_changes.add(change)


def _refusal(deleted: ChunkRecord) -> ConflictError:
    why = "deleted" if deleted.reason is None else deleted.reason.text
    reason = f"the recording {deleted.digest[:12]} was {why}; to take it in again, ingest it with {TAKE_DELETED}"
    return ConflictError(reason, kind="recording", key=deleted.digest)


Announce = Callable[[ChunkRecord], None]  # called with each committed receipt; it neither waits nor fails


def to_nobody(_record: ChunkRecord) -> None:
    """Announce a receipt to nobody."""


def enter_receipt(unit: SqlUnitOfWork, record: ChunkRecord, deleted: DeletedRecordings) -> tuple[ChunkRecord, bool]:
    """Store the receipt of a recording, and return what stands there now, and whether it had been there before."""
    if unit.chunks.put(record):
        return record, False
    stored = unit.chunks.get(record.digest)
    assert stored is not None
    if stored.state is ChunkState.DELETED:
        deleted.take_again(unit, stored, record)
        return record, False
    if stored.purged_ns is not None:  # its bytes are there again
        stored = replace(stored, purged_ns=None)
        unit.chunks.update(stored)
        add_stale(
            unit, stored, f"recording {stored.digest[:12]}: received again"
        )  # what changed meanwhile is not in them
    return stored, True


def of_another_vehicle(record: ChunkRecord, vehicle: str, name: str) -> ConflictError:
    """Return the refusal of a recording that another vehicle has sent."""
    digest = record.digest
    reason = (
        f"{name}: the same recording was received from vehicle {record.vehicle};"
        f" where that is wrong: treadwatch recordings reassign {digest[:12]} --vehicle {vehicle}"
    )
    return ConflictError(reason, kind="chunk", key=digest)


WAITING = Reason(ReasonCode.WAITS_FOR_DECODING, "it is received and waits to be decoded")


@dataclass(frozen=True, slots=True)
class Chunk:
    """What a sender says of a chunk."""

    vehicle: str  # code of the vehicle; it need not be registered yet
    suffix: str
    file_name: str
    sender: str | None  # who sent it, or the folder it came through

    def receipt(self, digest: str, size_bytes: int, now_ns: int) -> ChunkRecord:
        """Return its receipt; what is no text in the name of its file is replaced."""
        name = Path(self.file_name).name.encode("utf-8", "replace").decode()
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
            file_name="".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name),
            sender=self.sender,
        )


@dataclass(frozen=True, slots=True)
class Arrival:
    """A chunk whose bytes are received under no name yet."""

    file: IncomingFile
    chunk: Chunk


@dataclass(frozen=True, slots=True)
class Stored:
    """A committed receipt, and whether it had been there before."""

    record: ChunkRecord
    known: bool


class ChunkStorage:
    """Stores arrivals: their bytes in the raw store first, then all receipts in one transaction."""

    def __init__(self, storage: SqlStorage, raw: RawStore, clock: Clock, announce: Announce = to_nobody) -> None:
        self._storage = storage
        self._raw = raw
        self._clock = clock
        self._announce = announce
        self._deleted = DeletedRecordings(storage, None)
        self._mark: str | None = None

    def store(self, arrivals: Sequence[Arrival]) -> list[Stored | ConflictError]:
        """Store arrivals; the answer to each is its receipt, or why it is not taken. What is not needed is deleted.

        Raises PassingFaultError where the raw store cannot take them now: nothing has a receipt then.
        """
        if self._mark is None or self._raw.read_mark() != self._mark:
            self._mark = check_raw_store(self._storage, self._raw, self._clock.now_ns())
        answers: dict[int, Stored | ConflictError] = {}
        self._refuse_deleted(arrivals, answers)
        self._raw.put([arrival.file for number, arrival in enumerate(arrivals) if number not in answers])
        with self._storage.write() as unit:
            now_ns = self._clock.now_ns()
            for number, arrival in enumerate(arrivals):
                if number in answers:
                    continue
                record = arrival.chunk.receipt(arrival.file.digest, arrival.file.size_bytes, now_ns)
                try:
                    stored, known = enter_receipt(unit, record, self._deleted)
                except ConflictError as error:  # deleted a moment ago: what was placed is an orphan
                    answers[number] = error
                    continue
                wrong = stored.vehicle != record.vehicle
                refusal = of_another_vehicle(stored, record.vehicle, record.file_name or record.digest)
                answers[number] = refusal if wrong else Stored(stored, known)
        for answer in answers.values():
            if isinstance(answer, Stored):
                self._announce(answer.record)
        for arrival in arrivals:
            arrival.file.discard()
        return [answers[number] for number in range(len(arrivals))]

    def _refuse_deleted(self, arrivals: Sequence[Arrival], answers: dict[int, Stored | ConflictError]) -> None:
        with self._storage.read() as unit:
            records = unit.chunks.of_digests([arrival.file.digest for arrival in arrivals])
        for number, arrival in enumerate(arrivals):
            if arrival.file.digest in records:
                try:
                    self._deleted.refuse(records[arrival.file.digest])
                except ConflictError as error:
                    answers[number] = error


AT_ONCE = 64  # receipts of one transaction at most


_Waiting = tuple[Arrival, "Future[Stored]"]


class ReceiptGroup:
    """One thread that commits receipts; it starts with the first, and its queue is bounded."""

    def __init__(self, storage: ChunkStorage, most_waiting: int) -> None:
        self._storage = storage
        self._queue: queue.Queue[_Waiting | None] = queue.Queue(maxsize=most_waiting)
        self._starting = threading.Lock()
        self._thread: threading.Thread | None = None

    def put(self, arrival: Arrival) -> Future[Stored]:
        """Hand an arrival over, whose file must stay where it is until the future ends.

        The future ends with the committed receipt, or with why there is none.
        """
        with self._starting:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="receipts", daemon=True)
                self._thread.start()
        stored: Future[Stored] = Future()
        try:
            self._queue.put_nowait((arrival, stored))
        except queue.Full:
            raise BusyError(f"{self._queue.maxsize} chunks wait for their receipts already") from None
        return stored

    def close(self) -> None:
        """Commit what waits, and end."""
        with self._starting:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._queue.put(None)
            thread.join()

    def _run(self) -> None:
        going_on = True
        while going_on:
            batch, going_on = self._gather()
            if batch:
                self._store(batch)

    def _gather(self) -> tuple[list[_Waiting], bool]:
        first = self._queue.get()
        batch: list[_Waiting] = []
        while first is not None:
            if first[1].set_running_or_notify_cancel():
                batch.append(first)
            if len(batch) == AT_ONCE:
                return batch, True
            try:
                first = self._queue.get_nowait()
            except queue.Empty:
                return batch, True
        return batch, False

    def _store(self, batch: list[_Waiting]) -> None:
        try:
            answers = self._storage.store([arrival for arrival, _ in batch])
        except Exception as error:  # noqa: BLE001 - whatever it is, each sender gets it, and the next batch is tried
            for _, stored in batch:
                stored.set_exception(error)
            return
        for (_, stored), answer in zip(batch, answers, strict=True):
            if isinstance(answer, Stored):
                stored.set_result(answer)
            else:
                stored.set_exception(answer)
