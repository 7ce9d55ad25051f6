"""What a request may contain: only what the OpenAPI document lists, checked in one place for every route."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPMethod, HTTPStatus
from typing import Annotated, Any

from fastapi import Depends, Request

from api.media_types import choose
from api.problems import PROBLEM_MEDIA_TYPE, ProblemError, ProblemItem, pointer

JSON = "application/json"
CSV = "text/csv"


@dataclass(frozen=True, slots=True)
class OperationContract:
    """What one operation offers and takes: media types of success, best first, and names of query parameters."""

    media_types: tuple[str, ...]
    query_parameters: frozenset[str]


Contracts = Mapping[tuple[str, str], OperationContract]


def contracts_of(document: Mapping[str, Any]) -> Contracts:
    """Return the contract of every operation of an OpenAPI document, by path template and upper-case method."""
    return {
        (path, method.upper()): OperationContract(
            _media_types(operation),
            frozenset(entry["name"] for entry in operation.get("parameters", ()) if entry["in"] == "query"),
        )
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
    }


def _media_types(operation: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(
        media_type
        for status, response in operation["responses"].items()
        if status.startswith("2")
        for media_type in response.get("content", {})
        if media_type != PROBLEM_MEDIA_TYPE
    )


def _refuse_unknown_parameters(request: Request, known: frozenset[str]) -> None:
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
        detail = f"query {items[0].pointer}: {items[0].detail}"
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", detail, items)


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
    contracts: Contracts = request.app.state.contracts
    contract = contracts[request.scope["route"].path_format, request.method]
    chosen = choose(request.headers.get("accept"), contract.media_types)
    if chosen is None:
        offered = ", ".join(contract.media_types)
        raise ProblemError(HTTPStatus.NOT_ACCEPTABLE, "not-acceptable", f"offered: {offered}")
    _refuse_other_body(request)
    _refuse_unknown_parameters(request, contract.query_parameters)
    return chosen


Accepted = Annotated[str, Depends(media_type)]
