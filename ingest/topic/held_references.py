"""References whose chunk cannot be taken yet: kept in quarantine, and tried again a bounded number of times.

A reference may overtake the file that it is about, where another site's files are replicated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.errors import PassingFaultError
from estimation.failures import after_failure
from estimation.storage import Clock
from estimation.values.runs import Quarantined, SubjectKind, resolved
from fleet_db.raw import LostRecordingError
from fleet_db.storage import SqlStorage
from ingest.topic.reference import Reference, as_text, from_text

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
        """Keep a reference with what stood against it.

        Args:
            reference: To a chunk without a receipt.
            error: What was raised, or would be.

        Raises:
            StorageError: The database cannot be reached.
        """
        subject, text = (SubjectKind.RECORDING, reference.digest, STAGE), as_text(reference)
        with self.storage.write() as unit:
            if unit.chunks.get(reference.digest) is not None:
                return  # it came meanwhile, or what failed is kept with its receipt
            item = after_failure(unit.quarantine.get(*subject), subject, text, error, self.clock.now_ns())
            if item.attempts >= MOST_ATTEMPTS:
                item = replace(item, due_ns=NEVER_NS)
            unit.quarantine.put(item)

    def release(self, digest: str) -> None:
        """End the quarantine of a reference, if it was in one.

        Raises:
            StorageError: The database cannot be reached.
        """
        with self.storage.read() as unit:
            item = unit.quarantine.get(SubjectKind.RECORDING, digest, STAGE)
        if item is not None and item != resolved(item):
            with self.storage.write() as unit:
                unit.quarantine.put(resolved(item))

    def due(self) -> Sequence[Reference]:
        """Return references for which another attempt is due, at most :data:`AT_ONCE`.

        Raises:
            StorageError: The database cannot be reached.
        """
        with self.storage.read() as unit:
            items: Sequence[Quarantined] = unit.quarantine.due(STAGE, self.clock.now_ns(), AT_ONCE)
        found = [from_text(item.inputs) for item in items]
        return [reference for reference in found if reference is not None]


def missing(reference: Reference, fault: LostRecordingError) -> PassingFaultError:
    """Return what is kept of a chunk whose bytes are not there, or are others."""
    return PassingFaultError(f"a reference names this chunk of vehicle {reference.vehicle}: {fault}")
