"""Recordings as they were received, what became of them, and what was done to them by hand."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

from pydantic import Field

from api.schemas.common import Links, Representation, Request
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.reasons import ReasonCode
from estimation.values.runs import TRIED_AGAIN, Quarantined, QuarantineState, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.receipts import ChunkRecord, ChunkState, RecordingAction
from fleet_db.receipts import RecordingChange as Change

_FOLDERS = re.compile(r"(?<![\w:/.])/(?:[^\s/:'\"]+/)+")
_RESOURCES = {
    SubjectKind.WHEELSET: "wheelsets",
    SubjectKind.SECTION: "track-sections",
    SubjectKind.VEHICLE: "vehicles",
    SubjectKind.FLEET: "fleets",
}


class QuarantinedItem(Representation):
    """One thing at which one stage of the work failed, and when it is tried again; kept when it succeeds later."""

    kind: SubjectKind
    key: str = Field(description="Digest, serial or code; of a window `serial@start in ns`.", examples=["WS-0001"])
    stage: str = Field(description="The job, or `ingest` for recordings.", examples=["refresh_geometry"])
    state: QuarantineState
    reason_code: ReasonCode
    reason: str = Field(description="First line of the error.")
    attempts: int = Field(description="Failures in a row.")
    first_failed_at: Timestamp
    last_failed_at: Timestamp
    next_attempt_at: Timestamp | None = Field(description="Null once it has succeeded.")
    links: Links


def without_folders(message: str) -> str:
    """Return a message without the folders of the machine."""
    return _FOLDERS.sub("", message)


def quarantined(item: Quarantined) -> QuarantinedItem:
    """Return the representation of what is kept of a failure; its message without the folders of the machine."""
    resource = _RESOURCES.get(item.kind)
    return QuarantinedItem(
        kind=item.kind,
        key=item.key,
        stage=item.stage,
        state=item.state,
        reason_code=item.code,
        reason=without_folders(item.error),
        attempts=item.attempts,
        first_failed_at=to_rfc3339(item.first_ns),
        last_failed_at=to_rfc3339(item.last_ns),
        next_attempt_at=to_rfc3339(item.due_ns) if item.state is QuarantineState.HELD else None,
        links={} if resource is None else {item.kind.value: f"/v1/{resource}/{segment(item.key)}"},
    )


UNUSED = ("unknown_identifiers", "wrong_lengths", "extended_frames", "remote_frames", "error_frames")
"""Counts of a receipt that are frames which carry no value of the bus of the vehicle; each frame is in one at most."""
LOST = "frames_dropped"
NOT_MARKS = frozenset({"frames", "decoded", LOST, "recorder_first_ns", "recorder_last_ns", "own_time", *UNUSED})
WORDS = r"^[^\x00-\x08\x0b-\x1f\x7f]+$"


class RecordingCounts(Representation):
    """What became of the frames of a recording; all 0 until it is decoded."""

    frames: int = Field(description="Frames in it; of an exchange, rows.", examples=[90_000])
    used: int = Field(description="Frames that carry values of the bus of its vehicle; of an exchange, rows.")
    unused: dict[str, int] = Field(description="Frames that carry none, by reason.", examples=[{"error_frames": 2}])
    lost: int = Field(description="Frames that its recorder says are missing in it.")
    marked: dict[str, int] = Field(
        description="What was marked and counted on the way: gaps, duplicates, clipped values, windows left out.",
        examples=[{"frames_late": 3}],
    )


class RecordingWindows(Representation):
    """Windows of its vehicle that share time with a recording, by their state."""

    made: int = Field(description="All of them.")
    pending: int = Field(description="Those that are not estimated yet.")
    estimated: int = Field(description="Those with a bin table.")
    refused: int = Field(description="Those that were refused, each with its reason.")


class Recording(Representation):
    """The receipt of a recording, and where it stands."""

    digest: str = Field(description="SHA-256 of its bytes: its identity.", examples=["ab" * 32])
    vehicle: str = Field(description="Code of the vehicle that it came for; it need not be registered.")
    file_name: str | None = Field(description="Under which it came.")
    format: str = Field(description="Ending of its format.", examples=[".blf"])
    size_bytes: int = Field(description="Of its bytes as they came.")
    received_at: Timestamp = Field(description="When its receipt was given, by our clock.")
    measured_from: Timestamp | None = Field(description="First frame, on the vehicle's clock; null until decoded.")
    measured_to: Timestamp | None = Field(description="Last frame, on the vehicle's clock; null until decoded.")
    state: ChunkState
    reason: str | None = Field(description="Why it is in this state; null where nothing is wrong.")
    reason_code: ReasonCode | None = Field(description="Why it is in this state; null where nothing is wrong.")
    bytes_removed_at: Timestamp | None = Field(description="When its raw bytes were removed; null while they are kept.")
    counts: RecordingCounts
    links: Links


class RecordingChange(Representation):
    """What was done to a recording by hand."""

    action: RecordingAction = Field(description="What was done.")
    at: Timestamp = Field(description="When, by our clock.")
    by: str = Field(description="Who.")
    why: str = Field(description="As it was written.")
    vehicle_before: str = Field(description="Code of its vehicle before it.")
    vehicle_after: str = Field(description="Code of its vehicle after it.")
    state_before: ChunkState = Field(description="Its state before it.")
    state_after: ChunkState = Field(description="Its state after it.")


class RecordingWithHistory(Recording):
    """A recording with its windows and what was done to it by hand, oldest first."""

    windows: RecordingWindows = Field(description="Its windows, counted.")
    changes: list[RecordingChange] = Field(description="What was done to it by hand, oldest first.")


class Correction(Request):
    """Why something is done to a recording, and who does it where access is open."""

    why: str = Field(
        min_length=1,
        max_length=2000,
        pattern=WORDS,
        description="Why; kept with the change.",
        examples=["The log was of the other unit"],
    )
    by: str | None = Field(
        default=None,
        min_length=1,
        max_length=200,
        pattern=WORDS,
        description="Who, where no key says it.",
        examples=["j.smith"],
    )


class Reassignment(Correction):
    """Give a recording to the vehicle that it is of."""

    vehicle: str = Field(pattern=r"^[^\x00-\x1f\x7f]{1,64}$", description="Code of the vehicle.", examples=["V-2"])


class Retry(Correction):
    """Decode a recording again."""

    clock_was_behind: bool = Field(
        default=False, description="Whether our clock was behind when it was received, and is right now."
    )


def recording(record: ChunkRecord) -> Recording:
    """Return the representation of a receipt."""
    return Recording(**_fields(record))


def recording_with_history(
    record: ChunkRecord, windows: Mapping[WindowState, int], changes: Sequence[Change]
) -> RecordingWithHistory:
    """Return the representation of a receipt with its windows and changes."""
    by_state = {state.value: windows.get(state, 0) for state in WindowState}
    return RecordingWithHistory(
        **_fields(record),
        windows=RecordingWindows(made=sum(windows.values()), **by_state),
        changes=[_change(one) for one in changes],
    )


def _fields(record: ChunkRecord) -> dict[str, Any]:
    return {
        "digest": record.digest,
        "vehicle": record.vehicle,
        "file_name": record.file_name,
        "format": record.suffix,
        "size_bytes": record.size_bytes,
        "received_at": to_rfc3339(record.received_ns),
        "measured_from": _time(record.first_ns),
        "measured_to": _time(record.last_ns),
        "state": record.state,
        "reason": None if record.reason is None else without_folders(record.reason.text),
        "reason_code": None if record.reason is None else record.reason.code,
        "bytes_removed_at": _time(record.purged_ns),
        "counts": _counts(record),
        "links": {"self": f"/v1/recordings/{record.digest}", "vehicle": f"/v1/vehicles/{segment(record.vehicle)}"},
    }


def _time(t_ns: int | None) -> str | None:
    return None if t_ns is None else to_rfc3339(t_ns)


def _counts(record: ChunkRecord) -> RecordingCounts:
    unused = {name: record.counts[name] for name in UNUSED if record.counts.get(name)}
    marked = {name: count for name, count in sorted(record.counts.items()) if count and name not in NOT_MARKS}
    used = record.frames - sum(unused.values())
    return RecordingCounts(
        frames=record.frames, used=used, unused=unused, lost=record.counts.get(LOST, 0), marked=marked
    )


def _change(change: Change) -> RecordingChange:
    return RecordingChange(
        action=change.action,
        at=to_rfc3339(change.recorded_ns),
        by=change.actor,
        why=change.why,
        vehicle_before=change.vehicle_before,
        vehicle_after=change.vehicle_after,
        state_before=change.state_before,
        state_after=change.state_after,
    )


class ChunkProgress(StrEnum):
    """Where a chunk stands."""

    RECEIVED = "received"  # stored; not decoded yet
    ASSEMBLED = "assembled"  # its windows are made
    QUARANTINED = "quarantined"  # it could not be decoded
    SET_ASIDE = "set_aside"
    DELETED = "deleted"


class Chunk(Representation):
    """The receipt of a chunk: its bytes are on the disk, and it will be decoded without being sent again."""

    sha256: str = Field(description="Of its bytes: its identity.", examples=["ab" * 32])
    vehicle: str = Field(description="Code of the vehicle that it came for; it need not be registered.")
    format: str = Field(description="Of its bytes.", examples=["blf"])
    file_name: str | None = Field(description="Under which it came.")
    size_bytes: int = Field(description="Of its bytes as they came.")
    received_at: Timestamp = Field(description="When its receipt was committed, by our clock.")
    sender: str | None = Field(description="Who sent it; null where access is open, or it came another way.")
    state: ChunkProgress = Field(
        description="`received`: stored, not decoded yet. `assembled`: its windows are made. `quarantined`: it could"
        " not be decoded, see the reason; the bytes are kept. `set_aside`, `deleted`: by hand."
    )
    reason: str | None = Field(description="Why it is in this state; null where there is nothing to say.")
    reason_code: ReasonCode | None = Field(description="Why it is in this state; null where there is nothing to say.")
    links: Links


def chunk(record: ChunkRecord) -> Chunk:
    """Return the representation of a receipt."""
    return Chunk(
        sha256=record.digest,
        vehicle=record.vehicle,
        format=record.suffix.removeprefix("."),
        file_name=record.file_name,
        size_bytes=record.size_bytes,
        received_at=to_rfc3339(record.received_ns),
        sender=record.sender,
        state=progress(record),
        reason=None if record.reason is None else without_folders(record.reason.text),
        reason_code=None if record.reason is None else record.reason.code,
        links={
            "self": f"/v1/chunks/{record.digest}",
            "recording": f"/v1/recordings/{record.digest}",
            "vehicle": f"/v1/vehicles/{segment(record.vehicle)}",
        },
    )


def progress(record: ChunkRecord) -> ChunkProgress:
    """Return where a chunk stands."""
    if record.state is ChunkState.DECODED:
        return ChunkProgress.ASSEMBLED
    if record.state in {ChunkState.SET_ASIDE, ChunkState.DELETED}:
        return ChunkProgress(record.state.value)
    failed = record.reason is not None and record.reason.code in TRIED_AGAIN
    return ChunkProgress.QUARANTINED if failed or record.state is ChunkState.REJECTED else ChunkProgress.RECEIVED
