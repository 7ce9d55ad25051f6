"""Problem details (RFC 9457), and the one table from our errors to HTTP."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPMethod, HTTPStatus
from typing import Any, Literal

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from api.times import to_rfc3339
from estimation.errors import BusyError, ConflictError, InputError, MigrationError, NotFoundError, StorageError
from ingest.registry_entry.contents import RegistryRefusedError

PROBLEM_MEDIA_TYPE = "application/problem+json"
_KIND_OF_STATUS = {404: "not-found"}
_log = logging.getLogger(__name__)

# Type URIs are names for programs to compare; they never change once published.
TYPES: Mapping[str, tuple[str, str]] = {  # title, and the detail of an example
    "not-found": ("No such resource", "no wheelset 'WS-9999'"),
    "invalid-request": ("The request does not validate", "query #/limit: Input should be less than or equal to 1000"),
    "invalid-cursor": (
        "The cursor cannot be used",
        "this cursor belongs to another list or another filter; start again without it",
    ),
    "cursor-of-another-database": (
        "The cursor belongs to another history of the database",
        "the cursor is of another database: read what is open now, then follow `next`",
    ),
    "conflict": ("The resource is not in the state that the request assumes", "alert 7 is closed"),
    "precondition-required": ("If-Match is required", "send the ETag of the resource as If-Match"),
    "precondition-failed": ("The resource has changed since it was read", "the resource has changed; read it again"),
    "idempotency-key-reused": (
        "The Idempotency-Key was used for another request",
        "this Idempotency-Key was used for another request; use a new one",
    ),
    "history-purged": (
        "What was known at that time has been purged",
        "replaced results are kept from 2026-01-01T00:00:00Z on, see the retention",
    ),
    "not-acceptable": ("None of the accepted media types is offered", "offered: application/json"),
    "unsupported-media-type": ("The request's media type is not supported", "send application/json"),
    "digest-mismatch": ("The bytes have another digest", "the body has another sha256 than its path"),
    "content-too-large": ("The request body is too large", "at most 1048576 bytes"),
    "headers-too-large": ("Request line and headers are too large", "request line and headers: at most 16384 bytes"),
    "request-timeout": ("The request did not arrive in time", "the body did not arrive within 30 s"),
    "unauthenticated": ("A valid key or token is required", "send a valid key or token: Authorization: Bearer ..."),
    "forbidden": ("The key or token does not allow this", "this needs the scope 'act'"),
    "foreign-origin": (
        "The request comes from a page of another origin",
        "pages of https://elsewhere.example may not change anything here",
    ),
    "unknown-host": ("The service is not reached under this name", "name the host in TREADWATCH_HOSTS"),
    "too-many-requests": (
        "A limit of requests is reached",
        "limit requests_per_s: at most 50 requests a second of a key; try again",
    ),
    "overloaded": ("The service has too much to do", "100 requests are being answered; try again"),
    "not-ready": ("The service is not ready", "the database does not answer"),
    "internal-error": ("The service failed", "the failure has been logged"),
}


class ProblemItem(BaseModel):
    """One thing that does not validate: a JSON Pointer into the part of the request that is named by ``in``."""

    part: str = Field(
        description="Part of the request: `query`, `path`, `header` or `body`.",
        serialization_alias="in",
        examples=["query"],
    )
    pointer: str = Field(description="JSON Pointer into that part.", examples=["#/limit"])
    detail: str = Field(description="What is wrong there.", examples=["Input should be less than or equal to 1000"])


class ContradictedRecord(BaseModel):
    """A record, or a window, that what was sent contradicts."""

    kind: str = Field(description="As the arrays of a registry file are called.", examples=["reprofilings"])
    key: str = Field(description="Code, or serial of the wheelset.", examples=["WS-0001"])
    at: str | None = Field(default=None, description="Time of a dated record.", examples=["2026-03-01T06:00:00Z"])


class Problem(BaseModel):
    """What went wrong, as in RFC 9457."""

    type: str = Field(
        description="Stable name of the kind of problem, for programs to compare.",
        examples=["urn:treadwatch:problem:not-found"],
    )
    title: str = Field(description="What kind of problem it is.", examples=["No such resource"])
    status: int = Field(ge=400, le=599, description="HTTP status.", examples=[404])
    detail: str | None = Field(
        description="What went wrong this time.", default=None, examples=["no wheelset 'WS-9999'"]
    )
    instance: str | None = Field(default=None, description="Path of the request.", examples=["/v1/wheelsets/WS-9999"])
    errors: list[ProblemItem] | None = Field(default=None, description="Each place that does not validate.")
    contradicts: list[ContradictedRecord] | None = Field(
        default=None, description="The records on file that what was sent contradicts."
    )
    reason_code: Literal["waits_for_database"] | None = Field(
        default=None, description="What is waited for, where the service has not had its database since its start."
    )
    next_cursor: str | None = Field(default=None, description="Cursor with which to go on.")
    next: str | None = Field(default=None, description="Path with which to go on.", examples=["/v1/alerts/feed"])


@dataclass(frozen=True, slots=True)
class GoOn:
    """Where a client that was refused goes on: a path, and the cursor in it."""

    path: str
    cursor: str | None


class ProblemError(Exception):
    """A problem that a handler raises: the key of its type, the HTTP status, what happened."""

    def __init__(
        self,
        status: int,
        kind: str,
        detail: str,
        errors: Sequence[ProblemItem] = (),
        headers: Mapping[str, str] = {},
        go_on: GoOn | None = None,
        reason_code: Literal["waits_for_database"] | None = None,
        contradicts: Sequence[ContradictedRecord] = (),
    ) -> None:
        self.status = status
        self.kind = kind
        self.detail = detail
        self.errors = list(errors)
        self.headers = dict(headers)
        self.go_on = go_on
        self.reason_code = reason_code
        self.contradicts = list(contradicts)
        super().__init__(detail)


def problem_response(request: Request, error: ProblemError) -> Response:
    """Return the problem as a response."""
    problem = Problem(
        type=f"urn:treadwatch:problem:{error.kind}" if error.kind in TYPES else "about:blank",
        title=TYPES[error.kind][0] if error.kind in TYPES else HTTPStatus(error.status).phrase,
        status=error.status,
        detail=error.detail or None,
        instance=request.scope.get("path"),
        errors=error.errors or None,
        reason_code=error.reason_code,
        contradicts=error.contradicts or None,
        next_cursor=None if error.go_on is None else error.go_on.cursor,
        next=None if error.go_on is None else error.go_on.path,
    )
    body = orjson.dumps(problem.model_dump(by_alias=True, exclude_none=True))
    return Response(body, error.status, headers=error.headers, media_type=PROBLEM_MEDIA_TYPE)


def pointer(parts: Sequence[str | int]) -> str:
    """Return the JSON Pointer (RFC 6901, as a URI fragment) of a place."""
    return "#" + "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in parts)


def _invalid(error: RequestValidationError) -> ProblemError:
    items = []
    for entry in error.errors():
        part, *place = entry["loc"] or ("body",)
        if entry["type"] == "json_invalid":
            place = []
        message = str(entry["msg"]).removeprefix("Value error, ")
        items.append(ProblemItem(part=str(part), pointer=pointer(place), detail=message))
    first = f"{items[0].part} {items[0].pointer}: {items[0].detail}" if items else ""
    return ProblemError(422, "invalid-request", first, items)


def invalid(place: str, detail: str, said: str | None = None, part: str = "body") -> ProblemError:
    """Return the refusal (422) of one value, by its JSON Pointer; ``said`` in place of the sentence that names it."""
    item = ProblemItem(part=part, pointer=place, detail=detail)
    return ProblemError(422, "invalid-request", said or f"{part} {place}: {detail}", [item])


def _refused_record(error: RegistryRefusedError) -> ProblemError:
    """Return 409 where a record contradicts others, else 422: it is impossible by itself."""
    items = [
        ProblemItem(part="body", pointer=pointer([wrong.field] if wrong.field else []), detail=wrong.reason)
        for wrong in (refusal.error for refusal in error.refusals)
    ]
    others = dict.fromkeys(
        name for refusal in error.refusals if refusal.contradiction is not None for name in refusal.contradiction.others
    )
    records = [
        ContradictedRecord(kind=name.kind, key=name.key, at=None if name.at_ns is None else to_rfc3339(name.at_ns))
        for name in others
    ]
    if not records:
        return ProblemError(422, "invalid-request", error.reason, items)
    return ProblemError(409, "conflict", error.reason, items, contradicts=records)


def _plain(error: HTTPException) -> ProblemError:
    if error.status_code == HTTPStatus.BAD_REQUEST:  # the framework could not even decode the body
        return invalid(pointer([]), "is no JSON in UTF-8", "the body is no JSON in UTF-8")
    return ProblemError(
        error.status_code, _KIND_OF_STATUS.get(error.status_code, ""), str(error.detail), headers=error.headers or {}
    )


_BUSY = "the database is being written to; nothing was changed, try again"
_AWAY = "the storage is not available"
# The first line whose class fits; errors that are not ours are answered without their message.
_TABLE: tuple[tuple[type[Exception], Callable[[Any], ProblemError]], ...] = (
    (ProblemError, lambda error: error),
    (RequestValidationError, _invalid),
    (HTTPException, _plain),
    (NotFoundError, lambda error: ProblemError(404, "not-found", str(error))),
    (ConflictError, lambda error: ProblemError(409, "conflict", str(error))),
    (RegistryRefusedError, _refused_record),
    (InputError, lambda error: invalid(pointer([error.field] if error.field else []), error.reason, error.reason)),
    (MigrationError, lambda error: ProblemError(503, "not-ready", str(error))),
    (BusyError, lambda _: ProblemError(503, "not-ready", _BUSY, headers={"Retry-After": "2"})),
    (StorageError, lambda _: ProblemError(503, "not-ready", _AWAY, headers={"Retry-After": "5"})),
    (Exception, lambda _: ProblemError(500, "internal-error", "the failure has been logged")),
)


def from_error(error: Exception) -> ProblemError:
    """Return the problem that answers an error."""
    return next(describe(error) for kind, describe in _TABLE if isinstance(error, kind))


def install(app: FastAPI) -> None:
    """Answer every error of this app with a problem."""

    async def respond(request: Request, error: Exception) -> Response:
        problem = from_error(error)
        if problem.status == HTTPStatus.METHOD_NOT_ALLOWED:
            named = next((value for name, value in problem.headers.items() if name.lower() == "allow"), "")
            problem.headers["Allow"] = allowed_methods(request.app.state.contracts, request.scope["path"], named)
        if problem.status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            _log.error("request failed: %s", request.scope.get("path"), exc_info=error)
        return problem_response(request, problem)

    for kind, _ in _TABLE:
        app.add_exception_handler(kind, respond)


def described(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route's OpenAPI description for these statuses."""
    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        status: {"description": HTTPStatus(status).phrase, "content": {PROBLEM_MEDIA_TYPE: {"schema": schema}}}
        for status in statuses
    }


def allowed_methods(operations: Iterable[tuple[str, str]], path: str, named: str) -> str:
    """Return the value of ``Allow`` (RFC 9110, 10.2.1) for a path; HEAD goes with GET."""
    methods: dict[str, set[str]] = {}
    for template, method in operations:
        methods.setdefault(template, set()).add(method)
    fitting = [template for template in methods if compile_path(template)[0].match(path)]
    if fitting:
        allowed = methods[min(fitting, key=lambda template: template.count("{"))]
    else:
        allowed = {name.strip() for name in named.split(",") if name.strip()}
    if HTTPMethod.GET in allowed:
        allowed = {*allowed, HTTPMethod.HEAD.value}
    return ", ".join(sorted(allowed))
