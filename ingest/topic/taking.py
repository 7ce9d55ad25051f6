"""From a reference to a committed receipt: known already, or new where the bytes are in the raw store."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.errors import ConflictError
from estimation.storage import Clock
from estimation.values.reasons import ReasonCode, code_of
from fleet_db.raw import LostRecordingError, RawStore
from fleet_db.raw_files import check_raw_store
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.deleted import DeletedRecordings
from ingest.intake.backlog import BacklogWatch, Behind
from ingest.intake.store import Chunk
from ingest.receipts import enter_receipt
from ingest.topic.held_references import HeldReferences, missing
from ingest.topic.outcomes import Outcome
from ingest.topic.reference import Reference


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of a reference, and whether its chunk waits to be decoded."""

    outcome: Outcome
    waits: bool = False


@dataclass(frozen=True, slots=True)
class ReferenceTaking:
    """Takes references in."""

    storage: SqlStorage
    raw: RawStore
    clock: Clock
    backlog: BacklogWatch
    sender: str

    @property
    def held(self) -> HeldReferences:
        """The references that could not be taken."""
        return HeldReferences(self.storage, self.clock)

    def take(self, reference: Reference) -> Taken | Behind:
        """Make sure that there is a receipt, and return what was found; or the limit that keeps new receipts out.

        Raises:
            StorageError: The database cannot be reached: nothing has changed.
            PassingFaultError: The store of raw recordings is away, or not that of the database, such as a folder that
                is not mounted: the same.
        """
        with self.storage.read() as unit:
            found = unit.chunks.get(reference.digest)
        if found is None:
            behind = self.backlog.behind(reference.size_bytes)
            return behind if behind is not None else self._new(reference)
        taken = _taken(found, reference, Outcome.KNOWN)
        self.held.release(reference.digest)
        return taken

    def _new(self, reference: Reference) -> Taken:
        """Commit the receipt of a chunk whose bytes are in the raw store; keep the reference where they are not."""
        check_raw_store(self.storage, self.raw, self.clock.now_ns())
        found = self._fault(reference)
        if found is not None:
            outcome, fault = found
            self.held.hold(reference, missing(reference, fault))
            return Taken(outcome)
        chunk = Chunk(reference.vehicle, reference.suffix, reference.file_name, self.sender)
        record = chunk.receipt(reference.digest, reference.size_bytes, self.clock.now_ns())
        try:
            with self.storage.write() as unit:
                stored, known = enter_receipt(unit, record, DeletedRecordings(self.storage, None))
        except ConflictError:  # deleted a moment ago
            return Taken(Outcome.DELETED)
        self.held.release(reference.digest)
        return _taken(stored, reference, Outcome.KNOWN if known else Outcome.STORED)

    def _fault(self, reference: Reference) -> tuple[Outcome, LostRecordingError] | None:
        """Return what is wrong with the bytes of a chunk; None where they are whole."""
        fault = self.raw.fault(reference.digest, reference.suffix, reference.size_bytes)
        if fault is None:
            return None
        there = self.raw.holds(reference.digest, reference.suffix)
        return (Outcome.DAMAGED if there else Outcome.MISSING), fault


def _taken(found: ChunkRecord, reference: Reference, outcome: Outcome) -> Taken:
    if found.state is ChunkState.DELETED:
        return Taken(Outcome.DELETED)
    if found.vehicle != reference.vehicle:
        return Taken(Outcome.OTHER_VEHICLE)
    return Taken(outcome, code_of(found.reason) is ReasonCode.WAITS_FOR_DECODING)
