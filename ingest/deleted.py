"""Recordings that were deleted by hand: received again they are refused, unless that was asked for."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.errors import ConflictError
from fleet_db.receipts import ChunkRecord, ChunkState, RecordingAction, RecordingChange
from fleet_db.storage import SqlStorage, SqlUnitOfWork

TAKE_DELETED = "--take-deleted"
"""The option that asks for it."""


@dataclass(frozen=True, slots=True)
class DeletedRecordings:
    """What is done with recordings that were deleted and come again.

    Args:
        taken_by: Who wants them to be taken in; None where they are refused.
    """

    storage: SqlStorage
    taken_by: str | None

    def receipt(self, digest: str) -> ChunkRecord | None:
        """Return the receipt of a deleted recording; None of any other, and where they are taken in."""
        if self.taken_by is not None:
            return None
        with self.storage.read() as unit:
            found = unit.chunks.get(digest)
        return found if found is not None and found.state is ChunkState.DELETED else None

    def admit(self, digest: str) -> None:
        """Refuse a recording that was deleted, before its bytes are stored.

        Raises:
            ConflictError: It was deleted; says when, by whom and why, and how to take it in again.
        """
        deleted = self.receipt(digest)
        if deleted is not None:
            raise _refusal(deleted)

    def refuse(self, found: ChunkRecord) -> None:
        """Refuse a recording whose receipt says that it was deleted, where that is not wanted again.

        Raises:
            ConflictError: It was, and is not.
        """
        if self.taken_by is None and found.state is ChunkState.DELETED:
            raise _refusal(found)

    def take_again(self, unit: SqlUnitOfWork, deleted: ChunkRecord, record: ChunkRecord) -> None:
        """Put a new receipt in the place of that of a deleted recording, with its record.

        Args:
            deleted, record: The receipt that there is, and the new one.

        Raises:
            ConflictError: It is not asked for: the recording was deleted meanwhile.
        """
        if self.taken_by is None:
            raise _refusal(deleted)
        unit.chunks.update(record)
        action = RecordingAction.TAKE_AGAIN
        before, after = (deleted.vehicle, deleted.state), (record.vehicle, record.state)
        change = RecordingChange(
            record.digest, action, record.recorded_ns, self.taken_by, TAKE_DELETED, *before, *after
        )
        unit.recording_changes.add(change)


def _refusal(deleted: ChunkRecord) -> ConflictError:
    why = "deleted" if deleted.reason is None else deleted.reason.text
    reason = f"the recording {deleted.digest[:12]} was {why}; to take it in again, ingest it with {TAKE_DELETED}"
    return ConflictError(reason, kind="recording", key=deleted.digest)
