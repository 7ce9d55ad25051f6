"""Recordings: what was received, and what became of it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from api import cursors
from api.asking import AskedDep, AskedListDep
from api.known import require_known
from api.parameters import CODE, FleetFilter, MeasuredFrom, MeasuredTo, require_order
from api.problems import described
from api.schemas import recordings
from api.schemas.common import Page
from api.times import Moment
from estimation.errors import NotFoundError
from estimation.values.reasons import ReasonCode
from fleet_db.receipts import ChunkRecord, ChunkState
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.chunks import ChosenChunks

router = APIRouter(prefix="/v1/recordings", tags=["recordings"])
DIGEST = r"^[0-9a-f]{64}$"
Digest = Annotated[str, Path(pattern=DIGEST, description="SHA-256 of its bytes.", examples=["ab" * 32])]
OfVehicle = Annotated[str | None, Query(pattern=CODE, description="Only of this vehicle, registered or not.")]
InState = Annotated[ChunkState | None, Query(description="Only in this state; `deleted` lists those alone.")]
OfCode = Annotated[ReasonCode | None, Query(description="Only with this reason code.")]
ReceivedFrom = Annotated[Moment | None, Query(description="Received at or after this time.")]
ReceivedTo = Annotated[Moment | None, Query(description="Received before this time.")]


@router.get("", response_model=Page[recordings.Recording], responses=described(400, 404))
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
    filters = {name: getattr(chosen, name) for name in ChosenChunks.__dataclass_fields__}
    before = _place(asked.after_text(filters))
    with asked.read() as unit:
        rows = unit.chunks.page(chosen, asked.limit + 1, before)
        if not rows:
            require_known(unit, fleet=fleet)
            if vehicle is not None and not unit.chunks.page(ChosenChunks(vehicle=vehicle), 1):
                require_known(unit, vehicle=vehicle)
    return asked.page(filters, rows, _key, recordings.recording)


@router.get("/{digest}", response_model=recordings.RecordingWithHistory, responses=described(404))
def get_recording(asked: AskedDep, digest: Digest) -> Response:
    """Return one recording, with its windows and what was done to it by hand."""
    with asked.read() as unit:
        found = with_history(unit, digest)
    return asked.answer(found)


def with_history(unit: SqlUnitOfWork, digest: str) -> recordings.RecordingWithHistory:
    """Return the representation of one recording."""
    record = unit.chunks.get(digest)
    if record is None:
        raise NotFoundError("recording", digest)
    windows, changes = unit.chunks.window_counts(record), unit.recording_changes.list(digest)
    return recordings.recording_with_history(record, windows, changes)


def _key(record: ChunkRecord) -> str:
    return f"{record.received_ns}/{record.digest}"


def _place(key: str | None) -> tuple[int, str] | None:
    if key is None:
        return None
    received, separator, digest = key.partition("/")
    if (
        not separator
        or not received.removeprefix("-").isdecimal()
        or not -cursors.INT64 <= int(received) < cursors.INT64
    ):
        raise cursors.refused("this is no cursor of this list")
    return int(received), digest
