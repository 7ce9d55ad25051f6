"""From a reference to a committed receipt: known already, or new where the bytes are in the raw store.

References whose chunk cannot be taken yet: kept in quarantine, and tried again a bounded number of times.

A reference may overtake the file that it is about, where another site's files are replicated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.errors import ConflictError, PassingFaultError
from estimation.storage import Clock
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.runs import Quarantined, SubjectKind, after_failure
from fleet_db.raw import LostRecordingError, RawStore
from fleet_db.raw_files import check_raw_store
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.held import release
from ingest.intake.backlog import BacklogWatch, Behind
from ingest.receipts import Chunk, DeletedRecordings, enter_receipt
from ingest.topic.reference import Outcome, Reference, as_text, from_text

STAGE = "consume"
MOST_ATTEMPTS = 30
"""Over some 23 hours, as their delays grow; behind it a new message or ``treadwatch quarantine retry`` is needed."""
NEVER_NS = (1 << 63) - 1
AT_ONCE = 100
"""References that are tried again between two messages."""


@dataclass(frozen=True, slots=True)
class HeldReferences:
    """The quarantine of references."""

    storage: SqlStorage
    clock: Clock

    def hold(self, reference: Reference, error: Exception) -> None:
        """Keep a reference with what stood against it."""
        subject, text = (SubjectKind.RECORDING, reference.digest, STAGE), as_text(reference)
        with self.storage.write() as unit:
            if unit.chunks.get(reference.digest) is not None:
                return  # it came meanwhile, or what failed is kept with its receipt
            item = after_failure(unit.quarantine.get(*subject), subject, text, error, self.clock.now_ns())
            if item.attempts >= MOST_ATTEMPTS:
                item = replace(item, due_ns=NEVER_NS)
            unit.quarantine.put(item)

    def release(self, digest: str) -> None:
        """End the quarantine of a reference, if it was in one."""
        release(self.storage, (SubjectKind.RECORDING, digest, STAGE))

    def due(self) -> Sequence[Reference]:
        """Return references for which another attempt is due, at most :data:`AT_ONCE`."""
        with self.storage.read() as unit:
            items: Sequence[Quarantined] = unit.quarantine.due(STAGE, self.clock.now_ns(), AT_ONCE)
        found = [from_text(item.inputs) for item in items]
        return [reference for reference in found if reference is not None]


def missing(reference: Reference, fault: LostRecordingError) -> PassingFaultError:
    """Return what is kept of a chunk whose bytes are not there, or are others."""
    return PassingFaultError(f"a reference names this chunk of vehicle {reference.vehicle}: {fault}")


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
        check_raw_store(self.storage, self.raw, self.clock.now_ns())
        fault = self.raw.fault(reference.digest, reference.suffix, reference.size_bytes)
        if fault is not None:
            there = self.raw.holds(reference.digest, reference.suffix)
            self.held.hold(reference, missing(reference, fault))
            return Taken(Outcome.DAMAGED if there else Outcome.MISSING)
        chunk = Chunk(reference.vehicle, reference.suffix, reference.file_name, self.sender)
        record = chunk.receipt(reference.digest, reference.size_bytes, self.clock.now_ns())
        try:
            with self.storage.write() as unit:
                stored, known = enter_receipt(unit, record, DeletedRecordings(self.storage, None))
        except ConflictError:  # deleted a moment ago
            return Taken(Outcome.DELETED)
        self.held.release(reference.digest)
        return _taken(stored, reference, Outcome.KNOWN if known else Outcome.STORED)


def _taken(found: ChunkRecord, reference: Reference, outcome: Outcome) -> Taken:
    if found.state is ChunkState.DELETED:
        return Taken(Outcome.DELETED)
    if found.vehicle != reference.vehicle:
        return Taken(Outcome.OTHER_VEHICLE)
    return Taken(outcome, code_of(found.reason) is ReasonCode.WAITS_FOR_DECODING)
