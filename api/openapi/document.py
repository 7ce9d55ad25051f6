"""The OpenAPI document: what FastAPI derives from the routes, with our problems in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from api.access.scopes import Scope
from api.openapi import headers
from api.openapi.problem_examples import describe_problems
from api.openapi.security import describe_access
from api.openapi.tables import describe_tables
from api.openapi.words import describe_properties
from api.problems import Problem
from api.schemas.common import Uncertain
from estimation.values.alerts import CloseReason
from estimation.values.reasons import ReasonCode
from estimation.values.worklist import Urgency

DESCRIPTION = """
Fleet health monitoring of wheel-rail wear: contact geometry, equivalent conicity, trends and alerts per wheelset.

Start at [the wheelsets](/v1/wheelsets), take a serial, and follow `links`: bin table (`geometry`), `trend`, `alerts`.

Numbers carry their unit in their name (`_mm`, `_km`, `_m_s`; `_1` for pure numbers) and come with their uncertainty.
Times are RFC 3339 in UTC; ranges are half-open.
"""


def document(app: FastAPI, scopes: Mapping[str, Scope]) -> dict[str, Any]:
    """Return the document of this app.

    Args:
        scopes: Of every operation, by its name.
    """
    found = get_openapi(
        title=app.title,
        version=app.version,
        openapi_version="3.1.0",
        description=DESCRIPTION.strip(),
        routes=app.routes,
        tags=app.openapi_tags,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    describe_tables(app, found)
    template = "#/components/schemas/{model}"
    _, definitions = models_json_schema([(Problem, "serialization")], ref_template=template)
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(definitions["$defs"])
    schemas["Uncertain"]["examples"] = Uncertain.model_json_schema()["examples"]  # FastAPI drops the nulls in them
    for name, codes in (("ReasonCode", ReasonCode), ("CloseReason", CloseReason), ("Urgency", Urgency)):
        schemas[name]["description"] = _described(codes)
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    found["components"]["schemas"] = dict(sorted(schemas.items()))
    found["components"]["headers"] = headers.components()
    describe_properties(found["components"]["schemas"])
    describe_access(found, scopes)
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            _describe_unchanged(operation)
            headers.describe_headers(method, operation, found["components"]["schemas"])
            describe_problems(path, operation)
            _leave_streams_open(operation)
    return found


def _leave_streams_open(operation: dict[str, Any]) -> None:
    """Leave out the type that the framework gives a stream: checkers of documents apply it to each event."""
    for response in operation["responses"].values():
        stream = response.get("content", {}).get("text/event-stream")
        if stream is not None:
            stream["schema"].pop("type", None)


def _described(codes: type[ReasonCode | CloseReason | Urgency]) -> str:
    """Return what every code of an enumeration means, one line each."""
    meant = (code.sentence if isinstance(code, CloseReason) else code.meaning for code in codes)
    lines = (f"- `{code.value}`: {meaning}" for code, meaning in zip(codes, meant, strict=True))
    return "\n".join(("Stable codes; their sentences may be reworded.", "", *lines))


def _describe_unchanged(operation: dict[str, Any]) -> None:
    """Add 304 to the responses of an operation that takes ``If-None-Match``."""
    if any(entry["name"] == "If-None-Match" for entry in operation.get("parameters", ())):
        operation["responses"]["304"] = {"description": "The client holds it as it is."}
    operation["responses"] = dict(sorted(operation["responses"].items()))
