"""Recordings corrected by hand: tried again, set aside, restored, given to another vehicle, deleted.

Each correction is one transaction with its record and the stale spans of the vehicles' clocks. The recording is decoded
and windows are made again afterwards, by whoever works off what is stored and stale.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from estimation.errors import ConflictError, PassingFaultError
from estimation.storage import Clock
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import SubjectKind, resolved
from estimation.values.units import SECOND_NS
from fleet_db.locks import keeping_alone
from fleet_db.raw import RawStore
from fleet_db.records import ChunkRecord, ChunkState, RecordingAction, RecordingChange
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.estimated_again import STAGE
from ingest.assembly import OWN_TIME, WAITING, add_stale
from ingest.recordings import ALWAYS, RECORDER_FIRST, RECORDER_LAST, is_beside

STANDING = tuple(state for state in ChunkState if state is not ChunkState.DELETED)
_log = logging.getLogger(__name__)
ALLOWED = {
    RecordingAction.RETRY: (ChunkState.REJECTED, ChunkState.STORED),
    RecordingAction.SET_ASIDE: (ChunkState.STORED, ChunkState.DECODED, ChunkState.REJECTED),
    RecordingAction.RESTORE: (ChunkState.SET_ASIDE,),
    RecordingAction.REASSIGN: STANDING,
    RecordingAction.DELETE: STANDING,
}
"""States of recordings to which each may be done."""


@dataclass(frozen=True, slots=True)
class Author:
    """Who corrects something, and why."""

    actor: str
    why: str


@dataclass(frozen=True, slots=True)
class RecordingCorrections:
    """Corrections of recordings; raise ConflictError where the state of a recording does not allow them."""

    storage: SqlStorage
    clock: Clock

    def delete(self, digest: str, author: Author, raw: RawStore) -> ChunkRecord:
        """Make everything as if a recording had never come; return its receipt, which stays and says so.

        Its raw file is removed; where that cannot be done now, the next purge removes it. Refused during a backup.
        """
        with keeping_alone(self.storage.engine):
            record = self.correct(digest, RecordingAction.DELETE, author)
            try:
                raw.remove(record.digest, record.suffix)
            except PassingFaultError as error:
                _log.warning("recording %s was deleted, its raw file is left to the purge: %s", record.digest, error)
        return record

    def correct(
        self,
        digest: str,
        action: RecordingAction,
        author: Author,
        vehicle: str | None = None,
        *,
        our_clock_was_behind: bool = False,
    ) -> ChunkRecord:
        """Correct a recording; return its receipt. A vehicle is given where it is reassigned.

        Its time of receipt stays. What was ahead of it remains so, however late it is tried again, unless our clock
        was wrong then: the vehicle's is checked against that of now in this case.
        """
        with self.storage.write() as unit:
            before = unit.chunks.receipt(digest)
            for code in sorted({before.vehicle, vehicle or before.vehicle}):
                unit.assemble_alone(code)
            before = unit.chunks.receipt(digest)  # as nobody else assembles it now
            if vehicle is not None and unit.registry.vehicle(vehicle).code == before.vehicle:
                raise _conflict(before, f"is of vehicle {vehicle} already")
            if before.state not in ALLOWED[action]:
                raise _conflict(before, f"is {before.state}")
            if before.purged_ns is not None and action not in {RecordingAction.SET_ASIDE, RecordingAction.DELETE}:
                raise _conflict(before, "has no raw bytes any more: they were purged")
            now_ns = self.clock.now_ns()
            after = _after(before, action, author, vehicle or before.vehicle, now_ns)
            if our_clock_was_behind:
                after = replace(after, clock_checked_ns=now_ns)
            _make_stale(unit, before, after, action)
            unit.chunks.update(after)
            held = unit.quarantine.get(SubjectKind.RECORDING, before.digest, STAGE)
            if held is not None:
                unit.quarantine.put(resolved(held))
            states = (before.vehicle, before.state, after.vehicle, after.state)
            change = RecordingChange(before.digest, action, now_ns, author.actor, author.why, *states)
            unit.recording_changes.add(change)
            return after


def _after(before: ChunkRecord, action: RecordingAction, author: Author, vehicle: str, now_ns: int) -> ChunkRecord:
    if action is RecordingAction.DELETE:
        at = datetime.fromtimestamp(now_ns // SECOND_NS, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        reason = Reason(ReasonCode.DELETED, f"deleted at {at} by {author.actor}: {author.why}")
        return replace(before, state=ChunkState.DELETED, reason=reason, first_ns=None, last_ns=None, purged_ns=now_ns)
    if action is RecordingAction.SET_ASIDE or (
        action is RecordingAction.REASSIGN and before.state is ChunkState.SET_ASIDE
    ):
        reason = Reason(ReasonCode.SET_ASIDE, "set aside by hand")
        return replace(before, vehicle=vehicle, state=ChunkState.SET_ASIDE, reason=reason)
    return replace(before, vehicle=vehicle, state=ChunkState.STORED, reason=None, first_ns=None, last_ns=None)


def _make_stale(unit: SqlUnitOfWork, before: ChunkRecord, after: ChunkRecord, action: RecordingAction) -> None:
    """Let the windows that a recording counted for be made again, and those of recordings that its TIME had placed."""
    if before.state is not ChunkState.DECODED or before.first_ns is None or before.last_ns is None:
        return
    for vehicle in {before.vehicle, after.vehicle}:
        add_stale(unit, replace(before, vehicle=vehicle), f"recording {before.digest[:12]}: {action}")
    for other in _placed_by(unit, before):
        add_stale(unit, other, f"recording {before.digest[:12]}, which had its time: {action}")
        unit.chunks.update(replace(other, state=ChunkState.STORED, reason=WAITING, first_ns=None, last_ns=None))


def _placed_by(unit: SqlUnitOfWork, record: ChunkRecord) -> Sequence[ChunkRecord]:
    """Return the decoded recordings without TIME frames that follow each other from this one on, either way."""
    without = [
        other
        for other in unit.chunks.overlapping(record.vehicle, *ALWAYS)
        if other.digest != record.digest and not other.counts.get(OWN_TIME, 1) and RECORDER_FIRST in other.counts
    ]
    placed: list[ChunkRecord] = []
    near = [record]
    while near:
        chunk = near.pop()
        if RECORDER_FIRST not in chunk.counts:
            continue
        ends = chunk.counts[RECORDER_FIRST], chunk.counts[RECORDER_LAST]
        beside = [other for other in without if other not in placed and is_beside(other, chunk.digest, ends)]
        placed += beside
        near += beside
    return placed


def _conflict(record: ChunkRecord, why: str) -> ConflictError:
    return ConflictError(f"recording {record.digest[:12]} {why}", kind="recording", key=record.digest)
