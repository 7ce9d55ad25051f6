"""What a request may contain: only what the OpenAPI document lists, checked in one place for every route."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPMethod, HTTPStatus
from typing import Annotated, Any

from fastapi import Depends, Request

from api.problems import PROBLEM_MEDIA_TYPE, ProblemError, ProblemItem, pointer

JSON = "application/json"
CSV = "text/csv"
TABLE: dict[int | str, dict[str, Any]] = {200: {"content": {CSV: {"schema": {"type": "string"}}}}}
"""What a route says of its answer that is also there as a table."""


@dataclass(frozen=True, slots=True)
class OperationContract:
    """What one operation offers and takes: media types of success, best first, and names of query parameters.

    Those that are lists may be repeated. ``body_types`` are the media types that its body may have.
    """

    media_types: tuple[str, ...]
    query_parameters: frozenset[str]
    repeatable: frozenset[str]
    body_types: tuple[str, ...] = (JSON,)


Contracts = Mapping[tuple[str, str], OperationContract]


def contracts_of(document: Mapping[str, Any]) -> Contracts:
    """Return the contract of every operation of an OpenAPI document, by path template and upper-case method."""
    return {
        (path, method.upper()): _contract_of(operation)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
    }


def _contract_of(operation: Mapping[str, Any]) -> OperationContract:
    succeeded = [response for status, response in operation["responses"].items() if status.startswith("2")]
    offered = [media_type for response in succeeded for media_type in response.get("content", {})]
    asked = {entry["name"]: entry["schema"] for entry in operation.get("parameters", ()) if entry["in"] == "query"}
    lists = [
        name
        for name, schema in asked.items()
        if any(part.get("type") == "array" for part in (schema, *schema.get("anyOf", ())))
    ]
    return OperationContract(
        tuple(media_type for media_type in offered if media_type != PROBLEM_MEDIA_TYPE),
        frozenset(asked),
        frozenset(lists),
        tuple(operation.get("requestBody", {}).get("content", ())) or (JSON,),
    )


def _refuse_unknown_parameters(request: Request, contract: OperationContract) -> None:
    parameters = contract.query_parameters
    names = [name for name, _ in request.query_params.multi_items()]
    items = [
        ProblemItem(part="query", pointer=pointer([name]), detail="there is no such parameter")
        for name in dict.fromkeys(names)
        if name not in parameters
    ]
    items += [
        ProblemItem(part="query", pointer=pointer([name]), detail="may be given once only")
        for name in dict.fromkeys(names)
        if name in parameters - contract.repeatable and names.count(name) > 1
    ]
    if items:
        detail = f"query {items[0].pointer}: {items[0].detail}"
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", detail, items)


async def media_type(request: Request) -> str:
    """Return the media type that the client accepts best of what the operation offers (else 406, 415, 422)."""
    contracts: Contracts = request.app.state.contracts
    path = request.scope["route"].path_format
    contract = contracts.get((path, request.method))
    if contract is None:
        raise LookupError(f"{request.method} {path} is not in the committed document; run: treadwatch openapi --write")
    chosen = choose(request.headers.get("accept"), contract.media_types)
    if chosen is None:
        offered = ", ".join(contract.media_types)
        raise ProblemError(HTTPStatus.NOT_ACCEPTABLE, "not-acceptable", f"offered: {offered}")
    given = request.headers.get("content-type", contract.body_types[0]).split(";", maxsplit=1)[0].strip().lower()
    if request.method in {HTTPMethod.POST, HTTPMethod.PUT, HTTPMethod.PATCH} and given not in contract.body_types:
        detail = f"send {' or '.join(contract.body_types)}"
        raise ProblemError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", detail)
    _refuse_unknown_parameters(request, contract)
    request.state.media_type = chosen
    return chosen


Accepted = Annotated[str, Depends(media_type)]


def _ranges(accept: str) -> list[tuple[str, float]]:
    weights = []
    for part in accept.split(","):
        name, *parameters = (piece.strip() for piece in part.split(";"))
        weight = 1.0
        for parameter in parameters:
            key, _, value = parameter.partition("=")
            if key.strip().lower() == "q":
                try:
                    weight = float(value)
                except ValueError:
                    weight = 0.0
        if name:
            weights.append((name.lower(), weight))
    return weights


def _quality(media_type: str, ranges: Sequence[tuple[str, float]]) -> float:
    family = media_type.split("/", maxsplit=1)[0] + "/*"
    for wanted in (media_type, family, "*/*"):
        weights = [weight for name, weight in ranges if name == wanted]
        if weights:
            return max(weights)
    return 0.0


def choose(accept: str | None, offered: Sequence[str]) -> str | None:
    """Return which of ``offered`` (best first) the client likes most; None where it accepts none of them."""
    if accept is None or not accept.strip():
        return offered[0]
    ranges = _ranges(accept)
    weighed = [(_quality(media_type, ranges), -place, media_type) for place, media_type in enumerate(offered)]
    quality, _, media_type = max(weighed)
    return media_type if quality > 0.0 else None
