"""The OpenAPI document: what FastAPI derives from the routes, with our problems and headers in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from http import HTTPMethod, HTTPStatus
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute, iter_route_contexts
from pydantic.json_schema import models_json_schema

from api.access.gate import HEALTH, Scope, scope_of
from api.answers import columns_of, item_of
from api.contract import CSV
from api.problems import PROBLEM_MEDIA_TYPE, TYPES, Problem
from api.schemas.common import Uncertain
from estimation.values.alerts import CloseReason, Urgency
from estimation.values.reasons import ReasonCode

WORDS: Mapping[str, str] = {
    "acknowledged_at": "When it was acknowledged; null while it is not.",
    "acknowledged_by": "Who acknowledged it; null while nobody has.",
    "amplitude_mm": "Amplitude of the lateral motion of the wheelset.",
    "axle": "Number of the axle on its vehicle, from 1 at the front.",
    "axles": "Number of axles.",
    "baseline": "Number of reprofilings before it: results of different baselines are not compared.",
    "cleared_at": "When the condition cleared; null while it has not.",
    "closed_at": "When it was closed; null while it is open.",
    "close_reason": "Why it was closed, as a sentence; null while it is open.",
    "close_reason_code": "Why it was closed; null while it is open.",
    "code": "Code, unique among its kind.",
    "code_version": "Version of the mathematics that computed it.",
    "condition": "What the data say now.",
    "counts": "How many of what the run has handled.",
    "date_of_limit": "When the limit is reached.",
    "distance_to_limit_km": "Distance still to run until the limit is reached.",
    "display_state": "One word for a list on a screen.",
    "event": "What happened.",
    "external_refs": "Identities that maintenance systems gave to their work on it.",
    "fleet": "Code of the fleet.",
    "gauge_known": "Whether the track gauge along the section is on file.",
    "id": "Number, unique among its kind.",
    "input_digest": "Digest of everything that it was computed from.",
    "items": "The items of this page, in the order of the list.",
    "kind": "Which kind.",
    "last_seen_at": "When the data said so last.",
    "max_speed_km_h": "Highest permitted speed.",
    "measured_at": "When it was measured.",
    "measured_from": "Beginning of the measurements, on the vehicle's clock.",
    "measured_to": "End of the measurements, on the vehicle's clock; not included.",
    "mileage_km": "Mileage of the wheelset since it was new.",
    "mounting": "Where it runs now; null where it is on no vehicle.",
    "n_windows": "Number of windows behind it.",
    "name": "Name.",
    "nominal_gauge_mm": "Nominal track gauge.",
    "nominal_radius_mm": "Nominal rolling radius.",
    "note": "What the person who recorded it wrote.",
    "occurrence_count": "How many evaluations in a row or apart have found it.",
    "opened_at": "When the data said so for the first time.",
    "p10": "The 10 % quantile; null where it is beyond the horizon or unknown.",
    "p50": "The median; null where it is beyond the horizon or unknown.",
    "p90": "The 90 % quantile; null where it is beyond the horizon or unknown.",
    "passes": "Number of passes.",
    "probability_1": "Probability that the condition holds; null where none is computed.",
    "quality": "What the gates looked at.",
    "rail_inclination_1": "Inclination of the rails.",
    "rail_profile": "Name of the rail profile.",
    "reason": "Why there is no value, or what limits it, as a sentence; null where nothing does.",
    "reason_code": "The reason as a stable code; null where there is none.",
    "recorded_at": "When it was recorded, on the server's clock, in the order of commits.",
    "reprofiled_at": "When it was on the lathe.",
    "reprofilings": "Its visits to the lathe, oldest first.",
    "residual_rms_mm": "Root mean square of what the estimate leaves unexplained; null where unknown.",
    "rounds": "Rounds of the iteration.",
    "section": "Code of the track section.",
    "sensors": "The sensors of each node.",
    "serial": "Serial of the wheelset.",
    "severity": "How urgent it is.",
    "shelved_reason": "Why it is shelved; null while it is not.",
    "shelved_until": "Until when it is out of sight; null while it is not shelved.",
    "source": "Where it comes from.",
    "state": "In which state it is.",
    "status": "Whether there is an estimate.",
    "track_section": "Code of the track section; null where none is known.",
    "urgency": "How urgent it is, as a class.",
    "vehicle": "Code of the vehicle.",
    "version": "Version; each change makes the next.",
    "wheel_profile": "Name of the design profile of the wheels.",
    "wheelset": "Serial of the wheelset.",
    "work": "What was done to the sensors.",
}


def describe_properties(schemas: Mapping[str, Any]) -> None:
    """Describe every property that is not described where it is declared and has a word here."""
    for schema in schemas.values():
        for field, described in schema.get("properties", {}).items():
            if field in WORDS:
                described.setdefault("description", WORDS[field])


RESPONSE_HEADERS: Mapping[str, str] = {
    "Allow": "The methods of this path.",
    "Cache-Control": "`no-cache`: keep it, and ask with `If-None-Match` before it is used again.",
    "ETag": "Of this representation; for `If-None-Match`, and for `If-Match` of changes.",
    "Idempotency-Replayed": "`true` where the first answer under this `Idempotency-Key` is sent again.",
    "Link": 'The next page, `rel="next"`; absent on the last page of a list.',
    "Location": "The path of what was created.",
    "Retry-After": "Seconds after which to try again.",
    "Vary": "`Accept`: another media type is another representation.",
    "WWW-Authenticate": "How to authenticate (RFC 6750).",
    "X-Accel-Buffering": "`no`: proxies hand each part on at once.",
    "X-Request-Id": "Name of this request in the log; that of the request's own `X-Request-Id` where it sent one.",
}
_REPRESENTATION = ("ETag", "Cache-Control", "Vary")
_STREAM = ("Cache-Control", "X-Accel-Buffering")
_HEADERS_OF_STATUS: Mapping[str, tuple[str, ...]] = {
    "200": _REPRESENTATION,
    "201": (*_REPRESENTATION, "Location"),
    "202": (*_REPRESENTATION, "Location"),
    "304": _REPRESENTATION,
    "401": ("WWW-Authenticate",),
    "405": ("Allow",),
    "412": ("ETag",),
    "429": ("Retry-After",),
    "503": ("Retry-After",),
}
_PAGED = "next_cursor"
IF_MATCH = "If-Match"
EVENT_STREAM = "text/event-stream"


def _describe_headers(method: str, operation: dict[str, Any], schemas: Mapping[str, Any]) -> None:
    """Add to an operation the headers of its answers, and that ``If-Match`` is required where it is taken.

    The service answers a request without it with 428 rather than with 422, so the route itself cannot require it.
    """
    for parameter in operation.get("parameters", ()):
        if parameter["name"] == IF_MATCH:
            parameter["required"] = True
            parameter["schema"] = {"type": "string", "title": IF_MATCH, "examples": ['"9f86d081884c7d65"']}
    for status, response in operation["responses"].items():
        names = {"X-Request-Id", *_HEADERS_OF_STATUS.get(status, ())}
        if EVENT_STREAM in response.get("content", {}):
            names = {"X-Request-Id", *_STREAM}
        if status.startswith("2") and method.upper() == HTTPMethod.POST:
            names.add("Idempotency-Replayed")
        reference = response.get("content", {}).get("application/json", {}).get("schema", {}).get("$ref", "")
        if status == "200" and _PAGED in schemas.get(reference.rpartition("/")[2], {}).get("properties", {}):
            names.add("Link")
        described = response.setdefault("headers", {})
        for name in sorted(names):
            described.setdefault(name, {"$ref": f"#/components/headers/{name}"})


def _describe_tables(app: FastAPI, document: dict[str, Any]) -> None:
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        item = item_of(route.response_model) if isinstance(route, APIRoute) and route.include_in_schema else None
        if item is None or not isinstance(route, APIRoute):
            continue
        columns = [column.name for column in columns_of(item)]
        listed = ", ".join(f"`{name}`" for name in columns)
        schema = {
            "type": "string",
            "description": f"A table (RFC 4180) with the columns {listed}. Cells that start like a formula have an "
            "apostrophe in front.",
        }
        for method in route.methods or ():
            content = document["paths"][route.path_format][method.lower()]["responses"]["200"]["content"]
            content[CSV] = {"schema": schema, "example": ",".join(columns) + "\r\n"}


KEY = "key"
SCHEME = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key of this service (`treadwatch keys create`), or a token of the identity provider.",
}


def scopes_of(routers: Iterable[APIRouter]) -> dict[str, Scope]:
    """Return the scope of every operation by its name."""
    scopes = {}
    for router in routers:
        for route in router.routes:
            if isinstance(route, APIRoute):
                scope = scope_of(route)
                if scope is None:
                    raise LookupError(f"{route.name} declares no scope")
                scopes[route.name] = scope
    return scopes


_OF_STATUS: Mapping[str, str] = {
    "400": "invalid-cursor",
    "401": "unauthenticated",
    "403": "forbidden",
    "404": "not-found",
    "406": "not-acceptable",
    "408": "request-timeout",
    "409": "conflict",
    "410": "history-purged",
    "412": "precondition-failed",
    "413": "content-too-large",
    "415": "unsupported-media-type",
    "422": "invalid-request",
    "428": "precondition-required",
    "429": "too-many-requests",
    "431": "headers-too-large",
    "500": "internal-error",
    "503": "not-ready",
}
_FEED = ("poll_alert_feed", "stream_alert_feed")
_POINTED = [{"in": "query", "pointer": "#/limit", "detail": "Input should be less than or equal to 1000"}]


def _example(path: str, status: str, name: str) -> dict[str, Any]:
    kind = "cursor-of-another-database" if name in _FEED and status == "409" else _OF_STATUS.get(status)
    example: dict[str, Any] = {
        "type": "about:blank" if kind is None else f"urn:treadwatch:problem:{kind}",
        "title": HTTPStatus(int(status)).phrase if kind is None else TYPES[kind][0],
        "status": int(status),
        "instance": path.replace("{", "").replace("}", ""),
    }
    if kind is not None:
        example["detail"] = TYPES[kind][1]
    if kind == "invalid-request":
        example["errors"] = _POINTED
    return example


DESCRIPTION = """
Fleet health monitoring of wheel-rail wear: contact geometry, equivalent conicity, trends and alerts per wheelset.

Start at [the wheelsets](/v1/wheelsets), take a serial, and follow `links`: bin table (`geometry`), `trend`, `alerts`.

Numbers carry their unit in their name (`_mm`, `_km`, `_m_s`; `_1` for pure numbers) and come with their uncertainty.
Times are RFC 3339 in UTC; ranges are half-open.
"""


def document(app: FastAPI, scopes: Mapping[str, Scope]) -> dict[str, Any]:
    """Return the document of this app."""
    described = get_openapi(
        title=app.title,
        version=app.version,
        openapi_version="3.1.0",
        description=DESCRIPTION.strip(),
        routes=app.routes,
        tags=app.openapi_tags,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    _describe_tables(app, described)
    template = "#/components/schemas/{model}"
    _, definitions = models_json_schema([(Problem, "serialization")], ref_template=template)
    schemas = described.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(definitions["$defs"])
    schemas["Uncertain"]["examples"] = Uncertain.model_json_schema()["examples"]  # FastAPI drops the nulls in them
    for name, codes in (("ReasonCode", ReasonCode), ("CloseReason", CloseReason), ("Urgency", Urgency)):
        schemas[name]["description"] = _described(codes)
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    described["components"]["schemas"] = dict(sorted(schemas.items()))
    described["components"]["headers"] = {
        name: {"description": text, "schema": {"type": "string"}} for name, text in RESPONSE_HEADERS.items()
    }
    describe_properties(schemas)
    described["components"]["securitySchemes"] = {KEY: SCHEME}
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            scope = scopes.get(operation["operationId"], Scope.READ)
            operation["security"] = [] if path in HEALTH else [{KEY: [scope.value]}]
            if any(entry["name"] == "If-None-Match" for entry in operation.get("parameters", ())):
                operation["responses"]["304"] = {"description": "The client holds it as it is."}
            operation["responses"] = dict(sorted(operation["responses"].items()))
            _describe_headers(method, operation, described["components"]["schemas"])
            for status, response in operation["responses"].items():
                content = response.get("content", {})
                if PROBLEM_MEDIA_TYPE in content:
                    content[PROBLEM_MEDIA_TYPE].setdefault("example", _example(path, status, operation["operationId"]))
                if EVENT_STREAM in content:  # checkers of documents apply the framework's type to each event
                    content[EVENT_STREAM]["schema"].pop("type", None)
    return described


def _described(codes: type[ReasonCode | CloseReason | Urgency]) -> str:
    meant = (code.sentence if isinstance(code, CloseReason) else code.meaning for code in codes)
    lines = (f"- `{code.value}`: {meaning}" for code, meaning in zip(codes, meant, strict=True))
    return "\n".join(("Stable codes; their sentences may be reworded.", "", *lines))
