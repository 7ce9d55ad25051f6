"""What is done to recordings by hand: tried again, given to another vehicle, deleted."""

from __future__ import annotations

from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from api.access.caller import Caller, CallerDep
from api.access.scopes import Scope, requires
from api.answers import answer
from api.asking import AskedChange, NewDep
from api.idempotency import idempotent_post
from api.problems import described
from api.routes.recordings import Digest, with_history
from api.schemas import recordings
from api.services import Services, ServicesDep, writer_slot
from fleet_db.receipts import ChunkRecord
from ingest.corrections import Author, RecordingCorrections

router = APIRouter(
    prefix="/v1/recordings", tags=["recordings"], dependencies=[Depends(requires(Scope.INGEST)), Depends(writer_slot)]
)
Why = Annotated[
    str,
    Query(min_length=1, max_length=2000, pattern=recordings.WORDS, description="Why.", examples=["Of a test bench"]),
]
By = Annotated[
    str | None, Query(min_length=1, max_length=200, pattern=recordings.WORDS, description="Who, where no key says it.")
]
NOBODY = "unknown"
_REFUSALS = described(404, 409, 413, 415)


@router.post("/{digest}/reassign", response_model=recordings.RecordingWithHistory, responses=_REFUSALS)
def reassign_recording(asked: NewDep, digest: Digest, body: recordings.Reassignment) -> Response:
    """Give the recording to another vehicle; the next run of `assemble_windows` decodes it for that one."""
    with asked.read() as unit:
        unit.registry.vehicle(body.vehicle)  # one of another fleet is not found
    author = _author(asked.caller, body)
    return _correct(asked, digest, body, lambda made: made.reassign(digest, body.vehicle, author))


@router.post("/{digest}/retry", response_model=recordings.RecordingWithHistory, responses=_REFUSALS)
def retry_recording(asked: NewDep, digest: Digest, body: recordings.Retry) -> Response:
    """Let a rejected or waiting recording be decoded again, by the next run of `assemble_windows`."""
    author = _author(asked.caller, body)
    return _correct(
        asked, digest, body, lambda made: made.retry(digest, author, our_clock_was_behind=body.clock_was_behind)
    )


@router.delete("/{digest}", response_model=recordings.RecordingWithHistory, responses=described(404, 409))
def delete_recording(
    request: Request, services: ServicesDep, caller: CallerDep, digest: Digest, why: Why, by: By = None
) -> Response:
    """Make everything as if the recording had never come; its receipt stays, with who deleted it and why."""
    author = Author(caller.name or by or NOBODY, why)
    _made(services).delete(digest, author, services.raw)
    with services.storage.read() as unit:
        return answer(request, with_history(unit, digest))


def _correct(
    asked: AskedChange, digest: str, body: recordings.Correction, apply: Callable[[RecordingCorrections], ChunkRecord]
) -> Response:
    """Correct a recording once, however often the same request comes under one key."""
    post = idempotent_post(asked.request, asked.key, body)
    with asked.read() as unit:
        earlier = post.earlier(asked.request, unit)
    if earlier is not None:
        return earlier
    apply(_made(asked.services))
    with asked.read() as unit:
        found = with_history(unit, digest)
    with asked.services.storage.write() as unit:
        post.remember(unit, HTTPStatus.OK, found, asked.services.clock.now_ns())
    return asked.answer(found)


def _made(services: Services) -> RecordingCorrections:
    return RecordingCorrections(services.storage, services.clock)


def _author(caller: Caller, body: recordings.Correction) -> Author:
    return Author(caller.acts_as(body.by, NOBODY), body.why)
