"""Finished files become recordings with a receipt, many in one transaction."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from estimation.errors import BusyError, ConflictError
from estimation.storage import Clock
from fleet_db.raw import IncomingFile, RawStore, check_raw_store
from fleet_db.records import ChunkRecord
from fleet_db.storage import SqlStorage
from ingest.receipts import Announce, Chunk, DeletedRecordings, enter_receipt, of_another_vehicle, to_nobody


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

        Raises:
            PassingFaultError: The raw store cannot take them now: nothing has a receipt.
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
                    found, known = enter_receipt(unit, record, self._deleted)
                except ConflictError as error:  # deleted a moment ago: what was placed is an orphan
                    answers[number] = error
                    continue
                wrong = found.vehicle != record.vehicle
                refusal = of_another_vehicle(found, record.vehicle, record.file_name or record.digest)
                answers[number] = refusal if wrong else Stored(found, known)
        for answer in answers.values():
            if isinstance(answer, Stored):
                self._announce(answer.record)
        for arrival in arrivals:
            arrival.file.discard()
        return [answers[number] for number in range(len(arrivals))]

    def _refuse_deleted(self, arrivals: Sequence[Arrival], answers: dict[int, Stored | ConflictError]) -> None:
        with self._storage.read() as unit:
            found = unit.chunks.of_digests([arrival.file.digest for arrival in arrivals])
        for number, arrival in enumerate(arrivals):
            if arrival.file.digest in found:
                try:
                    self._deleted.refuse(found[arrival.file.digest])
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
        """Hand an arrival over; what is returned ends with its committed receipt, or with why there is none.

        Args:
            arrival: Its file must stay where it is until then.
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
