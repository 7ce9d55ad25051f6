"""Recordings at which decoding failed: they stay stored with their reason, and are tried again ever more rarely."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

from estimation.errors import TreadwatchError
from estimation.failures import after_failure
from estimation.storage import Clock
from estimation.values.quarantine import SubjectKind, resolved
from estimation.values.reasons import Reason
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage

STAGE = "ingest"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HeldRecordings:
    """The quarantine of recordings."""

    storage: SqlStorage
    clock: Clock

    def hold(self, record: ChunkRecord, error: Exception) -> ChunkRecord:
        """Keep a failure at a stored recording; return its receipt, with the reason.

        Raises
        ------
        StorageError
            The database cannot be reached.
        """
        unexpected = None if isinstance(error, TreadwatchError) else error
        _log.warning("recording %s of %s is held: %s", record.digest, record.vehicle, error, exc_info=unexpected)
        with self.storage.write() as unit:
            now = unit.chunks.get(record.digest)
            if now is None or now.state is not ChunkState.STORED:  # somebody has decided on it meanwhile
                return now or record
            subject = (SubjectKind.RECORDING, record.digest, STAGE)
            item = after_failure(unit.quarantine.get(*subject), subject, record.vehicle, error, self.clock.now_ns())
            unit.quarantine.put(item)
            held = replace(now, reason=Reason(item.code, item.error))
            unit.chunks.update(held)
            return held

    def waiting(self) -> frozenset[str]:
        """Return the digests of recordings for which it is too early for another attempt.

        Of one that was moved to another vehicle it never is.
        """
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            found = {item.key: item for item in unit.quarantine.held(STAGE)}
            records = [unit.chunks.get(digest) for digest in found]
        return frozenset(
            record.digest
            for record in records
            if record is not None and found[record.digest].waits(record.vehicle, now_ns)
        )

    def release(self, digest: str) -> None:
        """End the quarantine of a recording, if it was in one."""
        with self.storage.read() as unit:
            item = unit.quarantine.get(SubjectKind.RECORDING, digest, STAGE)
        if item is not None and item != resolved(item):
            with self.storage.write() as unit:
                unit.quarantine.put(resolved(item))
