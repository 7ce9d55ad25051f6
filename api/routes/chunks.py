"""Chunks: recordings sent over HTTP. What is answered with a receipt is on the disk."""

from __future__ import annotations

from enum import StrEnum
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from api.access.gate import CallerDep, Scope, requires
from api.answers import answer
from api.asking import CODE, AskedDep
from api.middleware import turn_of
from api.problems import ProblemError, described
from api.routes.recordings import why_in_state
from api.schemas.common import Derived
from api.services import ServicesDep
from api.times import Timestamp
from estimation.errors import ConflictError
from estimation.values.reasons import ReasonCode
from estimation.values.runs import TRIED_AGAIN
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.rows import present
from ingest import receipts
from ingest.logs import SUFFIXES


class ChunkProgress(StrEnum):
    """Where a chunk stands."""

    RECEIVED = "received"  # stored; not decoded yet
    ASSEMBLED = "assembled"  # its windows are made
    QUARANTINED = "quarantined"  # it could not be decoded
    SET_ASIDE = "set_aside"
    DELETED = "deleted"


_NOT_SERVED = (
    *("digest", "suffix", "state", "reason", "first_ns", "last_ns", "frames", "counts", "recorded_ns", "purged_ns"),
    "clock_checked_ns",
)


class Chunk(
    Derived,
    of=ChunkRecord,
    without=_NOT_SERVED,
    columns="sha256 vehicle format file_name size_bytes received_at sender state reason reason_code links",
    links={
        "self": "/v1/chunks/{digest}",
        "recording": "/v1/recordings/{digest}",
        "vehicle": "/v1/vehicles/{vehicle}",
    },
):
    """The receipt of a chunk: its bytes are on the disk, and it will be decoded without being sent again."""

    sha256: str = Field(description="Of its bytes: its identity.", examples=["ab" * 32])
    format: str = Field(description="Of its bytes.", examples=["blf"])
    received_at: Timestamp = Field(description="When its receipt was committed, by our clock.")
    sender: str | None = Field(description="Who sent it; null where access is open, or it came another way.")
    state: ChunkProgress = Field(
        description="`received`: stored, not decoded yet. `assembled`: its windows are made. `quarantined`: it could"
        " not be decoded, see the reason; the bytes are kept. `set_aside`, `deleted`: by hand."
    )
    reason: str | None = Field(description="Why it is in this state; null where there is nothing to say.")
    reason_code: ReasonCode | None = Field(description="Why it is in this state; null where there is nothing to say.")


def chunk(record: ChunkRecord) -> Chunk:
    """Return the representation of a receipt."""
    own = {"sha256": record.digest, "format": record.suffix.removeprefix("."), "state": progress(record)}
    return Chunk.made(record, **own, **why_in_state(record))


def progress(record: ChunkRecord) -> ChunkProgress:
    """Return where a chunk stands."""
    if record.state is ChunkState.DECODED:
        return ChunkProgress.ASSEMBLED
    if record.state in {ChunkState.SET_ASIDE, ChunkState.DELETED}:
        return ChunkProgress(record.state.value)
    failed = record.reason is not None and record.reason.code in TRIED_AGAIN
    return ChunkProgress.QUARANTINED if failed or record.state is ChunkState.REJECTED else ChunkProgress.RECEIVED


router = APIRouter(prefix="/v1/chunks", tags=["chunks"])
OCTETS = "application/octet-stream"
FORMATS = tuple(suffix.removeprefix(".") for suffix in SUFFIXES)
BODY = {"required": True, "content": {OCTETS: {"schema": {"type": "string", "format": "binary"}}}}
Sha256 = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", description="SHA-256 of its bytes.", examples=["ab" * 32])]
OfVehicle = Annotated[str, Query(pattern=CODE, description="Code of the vehicle; it need not be registered.")]
OfFormat = Annotated[
    str,
    Query(
        alias="format",
        pattern=r"^[A-Za-z0-9]{1,8}$",
        description=f"Format of the body: {', '.join(FORMATS)}.",
        examples=["blf"],
    ),
]
FileName = Annotated[
    str | None,
    Query(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f/]+$", description="Kept with the receipt."),
]


@router.put(
    "/{sha256}",
    status_code=HTTPStatus.CREATED,
    response_model=Chunk,
    responses={200: {"model": Chunk, "description": "It is stored already."}, **described(404, 408, 409, 413, 415)},
    openapi_extra={"requestBody": BODY},
    dependencies=[Depends(requires(Scope.INGEST))],
)
async def put_chunk(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    sha256: Sha256,
    vehicle: OfVehicle,
    format_: OfFormat,
    file_name: FileName = None,
) -> Response:
    """Store the bytes of a log of one bus over some minutes. 201 and 200 promise that they are on the disk.

    The same chunk again changes nothing. 503 with `Retry-After` where too much waits to be decoded: send it again.
    """
    if format_.lower() not in FORMATS:
        detail = f"the format {format_!r} is none of {', '.join(FORMATS)}"
        raise ProblemError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", detail)
    suffix = f".{format_.lower()}"

    def require_visible() -> None:
        with services.storage.read() as unit:
            unit.registry.vehicle(vehicle)

    if caller.fleets is not None:  # a vehicle of another fleet is refused as if it did not exist
        await run_in_threadpool(require_visible)
    name = file_name or f"{vehicle}__{sha256[:12]}{suffix}"
    sender = None if caller.name is None else f"{caller.name} ({caller.identity})"
    wanted = receipts.Chunk(vehicle, suffix, name, sender)
    with turn_of(request.scope).given_back():
        try:
            stored = await services.uploads.take(request.headers, request.receive, sha256, wanted)
        except ConflictError as error:
            if caller.fleets is None or error.kind != "chunk":
                raise
            # the vehicle may be one that the caller does not see
            reason = "the same chunk was received from another vehicle"
            raise ConflictError(reason, kind=error.kind, key=error.key) from error
    created = HTTPStatus.OK if stored.known else HTTPStatus.CREATED
    headers = {} if stored.known else {"Location": f"/v1/chunks/{sha256}"}
    return answer(request, chunk(stored.record), status=created, headers=headers)


@router.get("/{sha256}", response_model=Chunk, responses=described(404))
def get_chunk(asked: AskedDep, sha256: Sha256) -> Response:
    """Return the receipt of a chunk, and where it stands."""
    return asked.one(lambda unit: chunk(present(unit.chunks.get(sha256), "chunk", sha256)))
