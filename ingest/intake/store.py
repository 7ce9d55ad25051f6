"""Finished files become recordings with a receipt, many in one transaction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.errors import ConflictError
from estimation.storage import Clock
from fleet_db.raw import IncomingFile, RawStore
from fleet_db.raw_files import check_raw_store
from fleet_db.receipts import ChunkRecord
from fleet_db.storage import SqlStorage
from ingest.deleted import DeletedRecordings
from ingest.intake.chunk import Chunk
from ingest.receipts import Announce, enter_receipt, of_another_vehicle, to_nobody


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
    """Stores arrivals: their bytes in the raw store first, then all receipts in one transaction.

    Args:
        storage, raw: Where receipts and bytes go.
    """

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
            StorageError: The database cannot be reached: the same.
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
