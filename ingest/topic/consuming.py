"""The loop of a consumer: each message becomes a receipt and is decoded, then its offset may be committed.

Whatever a message holds, the next one gets its turn; while database, raw store or backlog keep receipts out, the same
message waits, and its partition with it. A reference is known already, or new where the bytes are in the raw store; it
may overtake the file that it is about, where another site's files are replicated. References whose chunk cannot be
taken yet are kept in quarantine, and tried again a bounded number of times.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from estimation.errors import ConflictError, MigrationError, PassingFaultError, StoppedError, StorageError
from estimation.storage import Clock
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.runs import Quarantined, SubjectKind, after_failure, first_line
from fleet_db.raw import LostRecordingError, RawStore, check_raw_store
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import BacklogWatch, Behind, DecodedChunks, Limit
from ingest.live.status import Backoff
from ingest.reassembly import release
from ingest.receipts import Chunk, DeletedRecordings, enter_receipt
from ingest.topic.client import ConsumerStatus, Outcome, Received, TopicReader
from ingest.topic.references import Reference, Refused, as_text, from_text, read_message

STAGE = "consume"
MOST_ATTEMPTS = 30
"""Over some 23 hours, as their delays grow; behind it a new message or ``treadwatch quarantine retry`` is needed."""
NEVER_NS = (1 << 63) - 1
HELD_AT_ONCE = 100  # references that are tried again between two messages


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
        """Return references for which another attempt is due, at most :data:`HELD_AT_ONCE`."""
        with self.storage.read() as unit:
            items: Sequence[Quarantined] = unit.quarantine.due(STAGE, self.clock.now_ns(), HELD_AT_ONCE)
        references = [from_text(item.inputs) for item in items]
        return [reference for reference in references if reference is not None]


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

        Raises StorageError or PassingFaultError where database or raw store are away, such as a folder that is not
        mounted: nothing has changed.
        """
        with self.storage.read() as unit:
            record = unit.chunks.get(reference.digest)
        if record is None:
            behind = self.backlog.behind(reference.size_bytes)
            return behind if behind is not None else self._new(reference)
        taken = _taken(record, reference, Outcome.KNOWN)
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


def _taken(record: ChunkRecord, reference: Reference, outcome: Outcome) -> Taken:
    if record.state is ChunkState.DELETED:
        return Taken(Outcome.DELETED)
    if record.vehicle != reference.vehicle:
        return Taken(Outcome.OTHER_VEHICLE)
    return Taken(outcome, code_of(record.reason) is ReasonCode.WAITS_FOR_DECODING)


POLL_S = 0.5
LOOK_EVERY_S = 5.0
"""How often references that are held are tried again, and, while no message comes, what else waits is decoded."""
ATTEMPTS = 3
"""With a message at which the database fails, before the reference is held and the next message gets its turn."""
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0

_log = logging.getLogger(__name__)


Decode = Callable[[Callable[[int, int], None], str | None], DecodedChunks]
"""Decodes what waits, as :func:`ingest.intake.backlog.decode_received`, given its last two arguments."""


@dataclass(slots=True)
class Consuming:
    """Takes messages until asked to end."""

    _reader: TopicReader
    _taking: ReferenceTaking
    _decode_received: Decode
    _status: ConsumerStatus
    _stopped: Callable[[], bool]
    _looked_s: float = float("-inf")

    def run(self) -> None:
        """Consume; what has no committed offset at the end comes again."""
        while not self._stopped():
            message = self._reader.next(POLL_S)
            if message is not None:
                self._work_off(message)
            if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
                self._look(idle=message is None)
                self._looked_s = time.monotonic()

    def _work_off(self, message: Received) -> None:
        read = read_message(message.key, message.value)
        if isinstance(read, Refused):
            where = f"partition {message.partition}, offset {message.offset}"
            _log.warning("nothing is taken of a message (%s, %s): it %s", where, read.outcome, read.text)
        outcome = read.outcome if isinstance(read, Refused) else self._taken_at_last(message, read)
        if outcome is None:
            return
        self._status.outcomes[outcome] += 1
        self._status.last_message_s = time.time()
        if isinstance(read, Reference):
            self._status.last_age_s = max(0.0, time.time() - read.received_ns * 1e-9)
        self._reader.done(message)

    def _taken_at_last(self, message: Received, reference: Reference) -> Outcome | None:
        """Take a reference however long that waits; None where an end is requested, or another member has it."""
        delays, failures = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S), 0
        while not self._stopped() and self._reader.holds(message):
            outcome = self._attempted(reference)
            if outcome is None or isinstance(outcome, Outcome):
                return outcome
            if isinstance(outcome, Behind):
                if self._caught_up(outcome):
                    continue
            elif not isinstance(outcome, PassingFaultError):
                failures += 1
                for_good = failures >= ATTEMPTS or not isinstance(outcome, StorageError)
                if for_good and self._held(reference, outcome):
                    return Outcome.FAILED
            self._reader.wait(delays.failed(), self._stopped)
        return None

    def _attempted(self, reference: Reference) -> Outcome | Behind | Exception | None:
        """Take a reference; return what became of it or what was raised, None where an end is requested."""
        try:
            return self._taken(reference)
        except StoppedError:
            return None
        except MigrationError:
            raise
        except (StorageError, PassingFaultError) as error:
            self._fault(error)
            return error
        except Exception as error:  # noqa: BLE001 - whatever it is, the next message gets its turn
            _log.exception("a reference to chunk %s failed", reference.digest)
            return error

    def _taken(self, reference: Reference) -> Outcome | Behind:
        taken = self._taking.take(reference)
        self._well()
        if isinstance(taken, Behind):
            return taken
        self._status.behind = None
        if taken.outcome not in {Outcome.STORED, Outcome.KNOWN}:
            chunk = f"chunk {reference.digest[:12]} of vehicle {reference.vehicle}"
            _log.warning("a reference to %s: %s", chunk, taken.outcome)
        if taken.waits:
            self._decode(reference.vehicle)
        return taken.outcome

    def _caught_up(self, behind: Behind) -> bool:
        """Decode what keeps new receipts out; return whether any was."""
        if self._status.behind is None:
            _log.warning("references wait: %s", behind.text)
        self._status.behind = behind.text
        try:
            return behind.limit is not Limit.DISK and self._decode(None) > 0
        except StoppedError:
            return False
        except StorageError as error:
            self._fault(error)
            return False

    def _held(self, reference: Reference, error: Exception) -> bool:
        try:
            self._taking.held.hold(reference, error)
        except StorageError as fault:
            self._fault(fault)
            return False
        return True

    def _decode(self, vehicle: str | None) -> int:
        def checkpoint(done: int, total: int) -> None:
            if self._stopped():
                raise StoppedError(done, total)
            self._reader.stay()

        counts = self._decode_received(checkpoint, vehicle)
        self._status.decoded += counts.decoded
        self._status.not_decoded += counts.others
        return counts.decoded + counts.others

    def _look(self, *, idle: bool) -> None:
        """Try again what is held, decode what else waits while no message comes, and ask how brokers and topic are."""
        self._reader.ask()
        try:
            for reference in self._taking.held.due():
                if not self._tried_again(reference):
                    break
            if idle:
                self._decode(None)
            self._well()
        except MigrationError:
            raise
        except StoppedError:
            return
        except (StorageError, PassingFaultError) as error:
            self._fault(error)

    def _tried_again(self, reference: Reference) -> bool:
        """Try a reference that was held; return whether the next one gets its turn."""
        self._reader.stay()
        try:
            outcome = self._taken(reference)
        except (StoppedError, StorageError, PassingFaultError):
            raise
        except Exception as error:  # noqa: BLE001 - whatever it is, the next one gets its turn
            _log.exception("a held reference to chunk %s failed", reference.digest)
            self._taking.held.hold(reference, error)
            return True
        if isinstance(outcome, Behind):
            return False
        _log.info("the held reference to chunk %s was tried again: %s", reference.digest[:12], outcome)
        return True

    def _fault(self, error: Exception) -> None:
        fault, passing = first_line(error), isinstance(error, PassingFaultError)
        if (self._status.raw_fault if passing else self._status.database_fault) in {None, "not asked yet"}:
            _log.warning("references wait: %s", fault)
        if passing:
            self._status.raw_fault = fault
        else:
            self._status.database_fault = fault

    def _well(self) -> None:
        self._status.raw_fault = self._status.database_fault = None
