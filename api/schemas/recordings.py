"""Recordings as they were received, what became of them, and what was done to them by hand."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

from pydantic import Field

from api.schemas.common import Links, Representation, Request
from api.schemas.derived import Derived
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.runs import TRIED_AGAIN, Quarantined, QuarantineState, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.receipts import RecordingChange as Change

_FOLDERS = re.compile(r"(?<![\w:/.])/(?:[^\s/:'\"]+/)+")
_RESOURCES = {
    SubjectKind.WHEELSET: "wheelsets",
    SubjectKind.SECTION: "track-sections",
    SubjectKind.VEHICLE: "vehicles",
    SubjectKind.FLEET: "fleets",
}


class QuarantinedItem(
    Derived,
    of=Quarantined,
    without=("error", "inputs", "due_ns"),
    columns="kind key stage state reason_code reason attempts first_failed_at last_failed_at next_attempt_at links",
):
    """One thing at which one stage of the work failed, and when it is tried again; kept when it succeeds later."""

    reason: str = Field(description="First line of the error.")
    next_attempt_at: Timestamp | None = Field(description="Null once it has succeeded.")
    links: Links


def without_folders(message: str) -> str:
    """Return a message without the folders of the machine."""
    return _FOLDERS.sub("", message)


def quarantined(item: Quarantined) -> QuarantinedItem:
    """Return the representation of what is kept of a failure; its message without the folders of the machine."""
    resource = _RESOURCES.get(item.kind)
    return QuarantinedItem.made(
        item,
        reason=without_folders(item.error),
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


_NOT_SERVED = ("frames", "counts", "recorded_ns", "clock_checked_ns", "sender", "reason")


class Recording(
    Derived,
    of=ChunkRecord,
    without=_NOT_SERVED,
    columns="digest vehicle file_name format size_bytes received_at measured_from measured_to state reason reason_code"
    " bytes_removed_at counts links",
):
    """The receipt of a recording, and where it stands."""

    reason: str | None = Field(description="Why it is in this state; null where nothing is wrong.")
    reason_code: ReasonCode | None = Field(description="Why it is in this state; null where nothing is wrong.")
    counts: RecordingCounts
    links: Links


class RecordingChange(Derived, of=Change, without=("digest",)):
    """What was done to a recording by hand."""


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
    return Recording.made(record, **_fields(record))


def recording_with_history(
    record: ChunkRecord, windows: Mapping[WindowState, int], changes: Sequence[Change]
) -> RecordingWithHistory:
    """Return the representation of a receipt with its windows and changes."""
    by_state = {state.value: windows.get(state, 0) for state in WindowState}
    return RecordingWithHistory.made(
        record,
        **_fields(record),
        windows=RecordingWindows(made=sum(windows.values()), **by_state),
        changes=[RecordingChange.made(one) for one in changes],
    )


def _fields(record: ChunkRecord) -> dict[str, Any]:
    return {
        **_why(record),
        "counts": _counts(record),
        "links": {"self": f"/v1/recordings/{record.digest}", "vehicle": f"/v1/vehicles/{segment(record.vehicle)}"},
    }


def _why(record: ChunkRecord) -> dict[str, Any]:
    """Return why a recording is in its state, without the folders of the machine."""
    reason = record.reason
    return {"reason": None if reason is None else without_folders(reason.text), "reason_code": code_of(reason)}


def _counts(record: ChunkRecord) -> RecordingCounts:
    unused = {name: record.counts[name] for name in UNUSED if record.counts.get(name)}
    marked = {name: count for name, count in sorted(record.counts.items()) if count and name not in NOT_MARKS}
    used = record.frames - sum(unused.values())
    return RecordingCounts(
        frames=record.frames, used=used, unused=unused, lost=record.counts.get(LOST, 0), marked=marked
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
        **_why(record),
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
