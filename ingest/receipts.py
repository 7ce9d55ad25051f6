"""The receipt of a recording whose bytes are safe: entered once, whatever there was under its digest before."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from estimation.errors import ConflictError
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.records import ChunkRecord, ChunkState, RecordingAction, RecordingChange
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.assembly import SpanAssembly, add_stale
from ingest.recordings import Recording

UNDECODABLE = frozenset({ChunkState.REJECTED, ChunkState.SET_ASIDE, ChunkState.DELETED})
"""States of recordings that count for no window."""


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file whose bytes are durable, read if it can be read."""

    path: Path
    vehicle: str
    digest: str
    recording: Recording | Exception


@dataclass(frozen=True, slots=True)
class Decoded:
    """What a recording makes: receipts, its own first, and the windows that it touches, where it has a place."""

    receipts: tuple[ChunkRecord, ...]
    assembly: SpanAssembly | None


def printable_name(path: Path) -> str:
    """Return the name of a file as it is kept with the receipt: what is no text in it is replaced."""
    name = path.name.encode("utf-8", "replace").decode()
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)


def check_undecided(unit: SqlUnitOfWork, receipts: Iterable[ChunkRecord]) -> None:
    """Raise where a recording was reassigned, deleted, set aside or rejected while its windows were assembled."""
    for receipt in receipts:
        now = unit.chunks.get(receipt.digest)
        if now is None or now.vehicle != receipt.vehicle or now.state in UNDECODABLE:
            raise ConflictError(f"recording {receipt.digest[:12]} changed meanwhile", kind="chunk", key=receipt.digest)


TAKE_DELETED = "--take-deleted"  # the option that asks for it


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
        """Refuse a recording that was deleted, before its bytes are stored."""
        deleted = self.receipt(digest)
        if deleted is not None:
            raise _refusal(deleted)

    def refuse(self, found: ChunkRecord) -> None:
        """Refuse a recording whose receipt says that it was deleted, where that is not wanted again."""
        if self.taken_by is None and found.state is ChunkState.DELETED:
            raise _refusal(found)

    def take_again(self, unit: SqlUnitOfWork, deleted: ChunkRecord, record: ChunkRecord) -> None:
        """Put a new receipt in the place of that of a deleted recording, with its record."""
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


Announce = Callable[[ChunkRecord], None]
"""Called with each committed receipt; it neither waits nor fails."""


def to_nobody(_record: ChunkRecord) -> None:
    """Announce a receipt to nobody."""


def enter_receipt(unit: SqlUnitOfWork, record: ChunkRecord, deleted: DeletedRecordings) -> tuple[ChunkRecord, bool]:
    """Store the receipt of a recording, and return what stands there now, and whether it had been there before."""
    if unit.chunks.put(record):
        return record, False
    found = unit.chunks.get(record.digest)
    assert found is not None
    if found.state is ChunkState.DELETED:
        deleted.take_again(unit, found, record)
        return record, False
    if found.purged_ns is not None:  # its bytes are there again
        found = replace(found, purged_ns=None)
        unit.chunks.update(found)
        add_stale(
            unit, found, f"recording {found.digest[:12]}: received again"
        )  # what changed meanwhile is not in them
    return found, True


def of_another_vehicle(found: ChunkRecord, vehicle: str, name: str) -> ConflictError:
    """Return the refusal of a recording that another vehicle has sent."""
    digest = found.digest
    reason = (
        f"{name}: the same recording was received from vehicle {found.vehicle};"
        f" where that is wrong: treadwatch recordings reassign {digest[:12]} --vehicle {vehicle}"
    )
    return ConflictError(reason, kind="chunk", key=digest)


WAITING = Reason(ReasonCode.WAITS_FOR_DECODING, "it is received and waits to be decoded")


@dataclass(frozen=True, slots=True)
class Chunk:
    """What a sender says of a chunk."""

    vehicle: str  # code of the vehicle; it need not be registered yet
    suffix: str
    file_name: str
    sender: str | None  # who sent it, or the folder it came through

    def receipt(self, digest: str, size_bytes: int, now_ns: int) -> ChunkRecord:
        """Return its receipt."""
        return ChunkRecord(
            digest=digest,
            vehicle=self.vehicle,
            suffix=self.suffix,
            size_bytes=size_bytes,
            state=ChunkState.STORED,
            reason=WAITING,
            first_ns=None,
            last_ns=None,
            frames=0,
            counts={},
            received_ns=now_ns,
            recorded_ns=now_ns,
            file_name=printable_name(Path(self.file_name)),
            sender=self.sender,
        )
