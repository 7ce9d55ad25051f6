"""Recordings at which decoding failed: they stay stored with their reason, and are tried again ever more rarely."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.errors import TreadwatchError
from estimation.failures import after_failure
from estimation.jobs.isolation import fails_alone
from estimation.storage import Clock
from estimation.values.reasons import Reason
from estimation.values.runs import Quarantined, SubjectKind, resolved
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from fleet_db.stores.decoded_again import STAGE
from fleet_db.stores.stale_spans import StaleSpan

ASSEMBLY = "assemble_windows"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class HeldRecordings:
    """The quarantine of recordings."""

    storage: SqlStorage
    clock: Clock

    def hold(self, record: ChunkRecord, error: Exception) -> ChunkRecord:
        """Keep a failure at a stored recording; return its receipt, with the reason.

        Raises:
            StorageError: The database cannot be reached.
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
        return frozenset(record.digest for record, early in self._held() if early)

    def due(self) -> list[ChunkRecord]:
        """Return the stored recordings in quarantine for which another attempt is due."""
        return [record for record, early in self._held() if not early and record.state is ChunkState.STORED]

    def _held(self) -> list[tuple[ChunkRecord, bool]]:
        """Return the recordings in quarantine, and whether it is too early for another attempt."""
        now_ns = self.clock.now_ns()
        with self.storage.read() as unit:
            found = [(unit.chunks.get(item.key), item) for item in unit.quarantine.held(STAGE)]
        return [(record, item.waits(record.vehicle, now_ns)) for record, item in found if record is not None]

    def release(self, digest: str) -> None:
        """End the quarantine of a recording, if it was in one."""
        with self.storage.read() as unit:
            item = unit.quarantine.get(SubjectKind.RECORDING, digest, STAGE)
        if item is not None and item != resolved(item):
            with self.storage.write() as unit:
                unit.quarantine.put(resolved(item))


@dataclass(frozen=True, slots=True)
class HeldVehicles:
    """The quarantine of vehicles whose windows could not be assembled again."""

    storage: SqlStorage
    clock: Clock

    def waits(self, vehicle: str, spans: Sequence[StaleSpan]) -> bool:
        """Whether it is too early for another attempt at the stale spans of a vehicle."""
        item = self._item(vehicle)
        return item is not None and item.waits(_inputs(spans), self.clock.now_ns())

    def hold(self, vehicle: str, spans: Sequence[StaleSpan], error: Exception) -> None:
        """Keep a failure at the stale spans of a vehicle, where others may succeed.

        Raises:
            StorageError: The database cannot be reached.
        """
        unexpected = None if isinstance(error, TreadwatchError) else error
        _log.warning("windows of vehicle %s could not be assembled again: %s", vehicle, error, exc_info=unexpected)
        if fails_alone(error):
            subject = (SubjectKind.VEHICLE, vehicle, ASSEMBLY)
            item = after_failure(self._item(vehicle), subject, _inputs(spans), error, self.clock.now_ns())
            with self.storage.write() as unit:
                unit.quarantine.put(item)

    def release(self, vehicle: str) -> None:
        """End the quarantine of a vehicle, if it was in one."""
        item = self._item(vehicle)
        if item is not None and item != resolved(item):
            with self.storage.write() as unit:
                unit.quarantine.put(resolved(item))

    def _item(self, vehicle: str) -> Quarantined | None:
        with self.storage.read() as unit:
            return unit.quarantine.get(SubjectKind.VEHICLE, vehicle, ASSEMBLY)


def _inputs(spans: Sequence[StaleSpan]) -> str:
    return f"{len(spans)} spans up to {max(span.id for span in spans)}"
