"""Chunks: recordings sent over HTTP. What is answered with a receipt is on the disk."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.caller import Caller, CallerDep
from api.access.scopes import Scope, requires
from api.answers import answer
from api.asking import AskedDep
from api.middleware import turn_of
from api.parameters import CODE
from api.problems import ProblemError, described
from api.schemas import recordings
from api.services import Services, ServicesDep
from estimation.errors import ConflictError, NotFoundError
from ingest.logs import SUFFIXES
from ingest.receipts import Chunk

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
    response_model=recordings.Chunk,
    responses={
        200: {"model": recordings.Chunk, "description": "It is stored already."},
        **described(404, 408, 409, 413, 415),
    },
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
    suffix = _suffix(format_)
    if caller.fleets is not None:
        await run_in_threadpool(_require_visible, services, vehicle)
    name = file_name or f"{vehicle}__{sha256[:12]}{suffix}"
    wanted = Chunk(vehicle, suffix, name, _sender(caller))
    with turn_of(request.scope).given_back():
        try:
            stored = await services.uploads.take(request.headers, request.receive, sha256, wanted)
        except ConflictError as error:
            raise _conflict(error, caller) from error
    created = HTTPStatus.OK if stored.known else HTTPStatus.CREATED
    headers = {} if stored.known else {"Location": f"/v1/chunks/{sha256}"}
    return answer(request, recordings.chunk(stored.record), status=created, headers=headers)


@router.get("/{sha256}", response_model=recordings.Chunk, responses=described(404))
def get_chunk(asked: AskedDep, sha256: Sha256) -> Response:
    """Return the receipt of a chunk, and where it stands."""
    with asked.read() as unit:
        record = unit.chunks.get(sha256)
    if record is None:
        raise NotFoundError("chunk", sha256)
    return asked.answer(recordings.chunk(record))


def _suffix(given: str) -> str:
    if given.lower() not in FORMATS:
        detail = f"the format {given!r} is none of {', '.join(FORMATS)}"
        raise ProblemError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", detail)
    return f".{given.lower()}"


def _require_visible(services: Services, vehicle: str) -> None:
    """Refuse a vehicle of another fleet, as if it did not exist, to a caller who is bound to fleets."""
    with services.storage.read() as unit:
        unit.registry.vehicle(vehicle)


def _conflict(error: ConflictError, caller: Caller) -> ConflictError:
    """Return the refusal without the name of a vehicle that the caller does not see."""
    if caller.fleets is None or error.kind != "chunk":
        return error
    return ConflictError("the same chunk was received from another vehicle", kind=error.kind, key=error.key)


def _sender(caller: Caller) -> str | None:
    return None if caller.name is None else f"{caller.name} ({caller.identity})"
