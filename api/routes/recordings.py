"""Recordings: what was received, what became of it, and what is done to it by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field

from api import cursors
from api.access.gate import CallerDep, Scope, requires
from api.access.key_ring import Caller
from api.answers import answer
from api.asking import (
    CODE,
    AskedChange,
    AskedDep,
    AskedListDep,
    FleetFilter,
    MeasuredFrom,
    MeasuredTo,
    NewDep,
    OfCode,
    require_order,
)
from api.problems import described
from api.schemas.common import Body, Derived, Links, Page, Representation, segment, without_folders
from api.services import Services, ServicesDep, require_known, writer_slot
from api.times import Moment
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.windows import WindowState
from fleet_db.records import ChunkRecord, ChunkState, RecordingAction
from fleet_db.records import RecordingChange as Change
from fleet_db.rows import present
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.chunks import ChosenChunks
from ingest.corrections import Author, RecordingCorrections

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


class Correction(Body):
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


def _fields(record: ChunkRecord) -> dict[str, Any]:
    unused = {name: record.counts[name] for name in UNUSED if record.counts.get(name)}
    marked = {name: count for name, count in sorted(record.counts.items()) if count and name not in NOT_MARKS}
    used = record.frames - sum(unused.values())
    return {
        **why_in_state(record),
        "counts": RecordingCounts(
            frames=record.frames, used=used, unused=unused, lost=record.counts.get(LOST, 0), marked=marked
        ),
        "links": {"self": f"/v1/recordings/{record.digest}", "vehicle": f"/v1/vehicles/{segment(record.vehicle)}"},
    }


def why_in_state(record: ChunkRecord) -> dict[str, Any]:
    """Return why a recording is in its state, without the folders of the machine."""
    reason = record.reason
    return {"reason": None if reason is None else without_folders(reason.text), "reason_code": code_of(reason)}


router = APIRouter(prefix="/v1/recordings", tags=["recordings"])
DIGEST = r"^[0-9a-f]{64}$"
Digest = Annotated[str, Path(pattern=DIGEST, description="SHA-256 of its bytes.", examples=["ab" * 32])]
OfVehicle = Annotated[str | None, Query(pattern=CODE, description="Only of this vehicle, registered or not.")]
InState = Annotated[ChunkState | None, Query(description="Only in this state; `deleted` lists those alone.")]
ReceivedFrom = Annotated[Moment | None, Query(description="Received at or after this time.")]
ReceivedTo = Annotated[Moment | None, Query(description="Received before this time.")]


@router.get("", response_model=Page[Recording], responses=described(400, 404))
def list_recordings(
    asked: AskedListDep,
    vehicle: OfVehicle = None,
    fleet: FleetFilter = None,
    state: InState = None,
    reason_code: OfCode = None,
    received_from: ReceivedFrom = None,
    received_to: ReceivedTo = None,
    from_: MeasuredFrom = None,
    to: MeasuredTo = None,
) -> Response:
    """List what was received, the newest first; deleted recordings where they are asked for only."""
    require_order(from_, to)
    require_order(received_from, received_to, "received_from", "received_to")
    chosen = ChosenChunks(state, vehicle, fleet, reason_code, received_from, received_to, from_, to)
    filters = asdict(chosen)
    before = _place(asked.after_text(filters))
    with asked.read() as unit:
        rows = unit.chunks.page(chosen, asked.limit + 1, before)
        if not rows:
            require_known(unit, fleet=fleet)
            if vehicle is not None and not unit.chunks.page(ChosenChunks(vehicle=vehicle), 1):
                require_known(unit, vehicle=vehicle)
    return asked.page(filters, rows, lambda record: f"{record.received_ns}/{record.digest}", recording)


@router.get("/{digest}", response_model=RecordingWithHistory, responses=described(404))
def get_recording(asked: AskedDep, digest: Digest) -> Response:
    """Return one recording, with its windows and what was done to it by hand."""
    return asked.one(lambda unit: _with_history(unit, digest))


def _with_history(unit: SqlUnitOfWork, digest: str) -> RecordingWithHistory:
    record = present(unit.chunks.get(digest), "recording", digest)
    windows, changes = unit.chunks.window_counts(record), unit.recording_changes.list(digest)
    by_state = {state.value: windows.get(state, 0) for state in WindowState}
    return RecordingWithHistory.made(
        record,
        **_fields(record),
        windows=RecordingWindows(made=sum(windows.values()), **by_state),
        changes=[RecordingChange.made(change) for change in changes],
    )


def _place(key: str | None) -> tuple[int, str] | None:
    if key is None:
        return None
    received, separator, digest = key.partition("/")
    if separator and received.removeprefix("-").isdecimal() and cursors.is_number(int(received)):
        return int(received), digest
    raise cursors.refused()


corrections_router = APIRouter(
    prefix="/v1/recordings", tags=["recordings"], dependencies=[Depends(requires(Scope.INGEST)), Depends(writer_slot)]
)
Why = Annotated[
    str, Query(min_length=1, max_length=2000, pattern=WORDS, description="Why.", examples=["Of a test bench"])
]
By = Annotated[str | None, Query(min_length=1, max_length=200, pattern=WORDS, description="Who, where no key says it.")]
NOBODY = "unknown"
_REFUSALS = described(404, 409, 413, 415)


@corrections_router.post("/{digest}/reassign", response_model=RecordingWithHistory, responses=_REFUSALS)
def reassign_recording(asked: NewDep, digest: Digest, body: Reassignment) -> Response:
    """Give the recording to another vehicle; the next run of `assemble_windows` decodes it for that one."""
    with asked.read() as unit:
        unit.registry.vehicle(body.vehicle)  # one of another fleet is not found
    author = _author(asked.caller, body)
    return _correct(
        asked, digest, body, lambda made: made.correct(digest, RecordingAction.REASSIGN, author, body.vehicle)
    )


@corrections_router.post("/{digest}/retry", response_model=RecordingWithHistory, responses=_REFUSALS)
def retry_recording(asked: NewDep, digest: Digest, body: Retry) -> Response:
    """Let a rejected or waiting recording be decoded again, by the next run of `assemble_windows`."""
    author = _author(asked.caller, body)
    behind = body.clock_was_behind
    return _correct(
        *(asked, digest, body),
        lambda made: made.correct(digest, RecordingAction.RETRY, author, our_clock_was_behind=behind),
    )


@corrections_router.delete("/{digest}", response_model=RecordingWithHistory, responses=described(404, 409))
def delete_recording(
    request: Request, services: ServicesDep, caller: CallerDep, digest: Digest, why: Why, by: By = None
) -> Response:
    """Make everything as if the recording had never come; its receipt stays, with who deleted it and why."""
    author = Author(caller.name or by or NOBODY, why)
    _made(services).delete(digest, author, services.raw)
    with services.storage.read() as unit:
        return answer(request, _with_history(unit, digest))


def _correct(
    asked: AskedChange, digest: str, body: Correction, apply: Callable[[RecordingCorrections], ChunkRecord]
) -> Response:
    def corrected() -> RecordingWithHistory:
        apply(_made(asked.services))
        with asked.read() as unit:
            return _with_history(unit, digest)

    return asked.beside(body, corrected)


def _made(services: Services) -> RecordingCorrections:
    return RecordingCorrections(services.storage, services.clock)


def _author(caller: Caller, body: Correction) -> Author:
    return Author(caller.acts_as(body.by, NOBODY), body.why)
