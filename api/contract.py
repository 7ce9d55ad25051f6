"""What a request may say: exactly what the OpenAPI document names, checked in one place for every route."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPMethod, HTTPStatus
from typing import Annotated, Any

from fastapi import Depends, Request

from api.media_types import choose
from api.problems import PROBLEM_MEDIA_TYPE, ProblemError, ProblemItem, pointer

JSON = "application/json"
CSV = "text/csv"


def _operation(request: Request) -> Mapping[str, Any]:
    paths = request.app.openapi()["paths"]
    operation: Mapping[str, Any] = paths[request.scope["route"].path_format][request.method.lower()]
    return operation


def _offered(operation: Mapping[str, Any]) -> list[str]:
    """Return the media types of success, best first."""
    return [
        media_type
        for status, response in operation["responses"].items()
        if status.startswith("2")
        for media_type in response.get("content", {})
        if media_type != PROBLEM_MEDIA_TYPE
    ]


def _refuse_unknown_parameters(request: Request, operation: Mapping[str, Any]) -> None:
    known = {entry["name"] for entry in operation.get("parameters", ()) if entry["in"] == "query"}
    names = [name for name, _ in request.query_params.multi_items()]
    items = [
        ProblemItem(part="query", pointer=pointer([name]), detail="there is no such parameter")
        for name in dict.fromkeys(names)
        if name not in known
    ]
    items += [
        ProblemItem(part="query", pointer=pointer([name]), detail="may be given once only")
        for name in dict.fromkeys(names)
        if name in known and names.count(name) > 1
    ]
    if items:
        told = f"query {items[0].pointer}: {items[0].detail}"
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", told, items)


def _refuse_other_body(request: Request) -> None:
    given = request.headers.get("content-type", JSON).split(";", maxsplit=1)[0].strip().lower()
    if request.method == HTTPMethod.POST and given != JSON:
        raise ProblemError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", f"send {JSON}")


async def media_type(request: Request) -> str:
    """Return the media type that the client accepts best of what the operation offers.

    Raises
    ------
    ProblemError
        406: it accepts none; 415: the body is no JSON; 422: an unknown or repeated query parameter.
    """
    operation = _operation(request)
    offered = _offered(operation)
    chosen = choose(request.headers.get("accept"), offered)
    if chosen is None:
        raise ProblemError(HTTPStatus.NOT_ACCEPTABLE, "not-acceptable", f"offered: {', '.join(offered)}")
    _refuse_other_body(request)
    _refuse_unknown_parameters(request, operation)
    return chosen


Accepted = Annotated[str, Depends(media_type)]
