"""Recordings at which decoding failed: they stay stored with their reason, and are tried again ever more rarely.

Raw recordings that were found lost or damaged when windows were to be made again from them.

They are kept in quarantine. Once their file is there again, copied back or received, their windows are made again: what
changed meanwhile reaches them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace

from estimation.errors import PassingFaultError, TreadwatchError
from estimation.storage import Clock
from estimation.values.reasons import Reason
from estimation.values.runs import Quarantined, SubjectKind, after_failure, resolved
from fleet_db.raw import RawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.estimated_again import STAGE
from ingest.assembly import add_stale

ASSEMBLY = "assemble_windows"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HeldRecordings:
    """The quarantine of recordings."""

    storage: SqlStorage
    clock: Clock

    def hold(self, record: ChunkRecord, error: Exception) -> ChunkRecord:
        """Keep a failure at a stored recording; return its receipt, with the reason."""
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
        with self.storage.read() as unit:
            return frozenset(record.digest for record, early in self._held(unit) if early)

    def due(self, unit: SqlUnitOfWork) -> list[ChunkRecord]:
        """Return the stored recordings in quarantine for which another attempt is due."""
        return [record for record, early in self._held(unit) if not early and record.state is ChunkState.STORED]

    def _held(self, unit: SqlUnitOfWork) -> list[tuple[ChunkRecord, bool]]:
        now_ns = self.clock.now_ns()
        found = [(unit.chunks.get(item.key), item) for item in unit.quarantine.held(STAGE)]
        return [(record, item.waits(record.vehicle, now_ns)) for record, item in found if record is not None]

    def release(self, digest: str) -> None:
        """End the quarantine of a recording, if it was in one."""
        release(self.storage, (SubjectKind.RECORDING, digest, STAGE))


Subject = tuple[SubjectKind, str, str]
"""Kind, key and stage of what is in quarantine."""


def release(storage: SqlStorage, subject: Subject) -> None:
    """End the quarantine of a subject, if it was in one."""
    with storage.read() as unit:
        item = unit.quarantine.get(*subject)
    if item is not None and item != resolved(item):
        with storage.write() as unit:
            unit.quarantine.put(resolved(item))


CAUSE = "its raw file is there again"


@dataclass(frozen=True, slots=True)
class LostRecordings:
    """The quarantine of recordings that windows could not be made of again."""

    storage: SqlStorage
    raw: RawStore
    clock: Clock

    def note(self, unit: SqlUnitOfWork, lost: Iterable[ChunkRecord]) -> None:
        """Keep that recordings were missing, in the transaction that stores what could be made without them."""
        for record in lost:
            fault: PassingFaultError
            came = PassingFaultError("could not be read when windows were made again")
            try:
                fault = self.raw.fault(record.digest, record.suffix) or came
            except PassingFaultError as away:  # of the store: the recording was missing all the same
                fault = away
            _hold(unit, record, fault, self.clock.now_ns())

    def waits(self, record: ChunkRecord) -> bool:
        """Whether a recording was missing when windows were made again, and they wait for it."""
        with self.storage.read() as unit:
            item = unit.quarantine.get(SubjectKind.RECORDING, record.digest, ASSEMBLY)
        return item is not None and item != resolved(item)

    def look(self, vehicle: str | None = None) -> None:
        """Look for missing recordings, and let the windows of those that are there again be made again.

        Args:
            vehicle: The only one, whether another attempt is due or not; None for all that are due.
        """
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            held = [(item, unit.chunks.get(item.key)) for item in missing(unit)]
        for item, record in held:
            if record is None or record.state is not ChunkState.DECODED or record.purged_ns is not None:
                self._resolve(item)  # it counts for no window, or will be decoded as a whole
            elif record.vehicle == vehicle or (vehicle is None and not item.waits(record.vehicle, now_ns)):
                try:
                    fault = self.raw.fault(record.digest, record.suffix)
                except PassingFaultError:
                    return  # of the store: nothing is known of what is in it
                if fault is None:
                    self._resolve(item, record)
                else:
                    with self.storage.write() as unit:
                        _hold(unit, record, fault, now_ns)

    def _resolve(self, item: Quarantined, *found: ChunkRecord) -> None:
        with self.storage.write() as unit:
            for record in found:
                add_stale(unit, record, f"recording {record.digest[:12]}: {CAUSE}")
            unit.quarantine.put(resolved(item))


def missing(unit: SqlUnitOfWork) -> list[Quarantined]:
    """Return what is in quarantine of recordings whose windows wait for their raw file."""
    return [item for item in unit.quarantine.held(ASSEMBLY) if item.kind is SubjectKind.RECORDING]


def _hold(unit: SqlUnitOfWork, record: ChunkRecord, fault: PassingFaultError, now_ns: int) -> None:
    subject = (SubjectKind.RECORDING, record.digest, ASSEMBLY)
    unit.quarantine.put(after_failure(unit.quarantine.get(*subject), subject, record.vehicle, fault, now_ns))
