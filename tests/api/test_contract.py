"""The OpenAPI document: committed, stable, true to what the service answers."""

from __future__ import annotations

import asyncio
import json
import re
from importlib.resources import files
from typing import Any

import httpx
import jsonschema_rs
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from running_service import Service
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
    unsupported_method,
)

from api.app import committed_document, describe, document_text

DOCUMENT = json.loads(committed_document())  # what the routes say, by the first test
PARTS = 4
HEADERS = {"If-Match", "If-None-Match", "Idempotency-Key"}


def operations() -> list[tuple[str, str, dict[str, Any]]]:
    return [(path, method, one) for path, item in DOCUMENT["paths"].items() for method, one in item.items()]


def test_the_committed_document_is_what_the_routes_say() -> None:
    committed = (files("api") / "openapi.json").read_text(encoding="utf-8")
    assert committed == document_text(), "it has drifted; run: treadwatch openapi --write"
    assert committed_document() == committed.encode()


def test_the_service_serves_the_committed_document(service: Service) -> None:
    assert service.client.get("/openapi.json").content == committed_document()


def test_a_route_that_the_committed_document_lacks_is_named() -> None:
    app = describe()
    app.state.contracts = {}

    async def ask() -> None:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://treadwatch") as client:
            await client.get("/v1/fleets")

    with pytest.raises(LookupError, match=r"GET /v1/fleets is not in .* treadwatch openapi --write"):
        asyncio.run(ask())


def test_the_document_is_openapi_3_1() -> None:
    assert DOCUMENT["openapi"].startswith("3.1.")


def test_operations_have_stable_names() -> None:
    names = [operation["operationId"] for _, _, operation in operations()]
    assert len(names) == len(set(names))
    assert all(re.fullmatch("[a-z]+(_[a-z]+)+", name) for name in names)
    assert {"get_geometry", "get_trend", "poll_alert_feed", "acknowledge_alert", "run_job_now"} <= set(names)


def test_paths_carry_the_version_and_problems_are_described() -> None:
    for path, _, operation in operations():
        if path in {"/healthz", "/readyz", "/metrics"}:
            continue
        assert path.startswith("/v1/")
        refusals = {status for status in operation["responses"] if status >= "400"}
        assert {"406", "422"} <= refusals
        for status in refusals:
            assert set(operation["responses"][status]["content"]) == {"application/problem+json"}
        if any(parameter["name"] == "If-Match" for parameter in operation.get("parameters", ())):
            assert {"412", "428", "409", "404"} <= refusals


def test_numbers_say_their_unit_in_their_names() -> None:
    bare = {
        "Uncertain": {"value", "std", "interval_95"},
        "Alert": {"raise_limit", "clear_limit", "id", "fleet_alert_id", "occurrence_count", "version"},
        "AlertRow": {"raise_limit", "clear_limit", "id", "fleet_alert_id", "occurrence_count", "version"},
        "BinColumn": {"value", "std"},
        "DistanceForecast": {"p10", "p50", "p90"},
        "LevelCalibration": {"profiles", "contradicting"},
        "Parameter": {"value", "std"},  # their unit is in a field beside them
        "Sensor": {"noise_density", "limit"},
        "RecordingCounts": {"frames", "used", "unused", "lost", "marked"},
        "SignatureAnswer": {"novelty"},  # a ratio of stds
        "StateOfWear": {"probability"},
        "UsedEntry": {"weight"},
        "RecordingWindows": {"made", "pending", "estimated", "refused"},
        "UnestimatedBecause": {"pending", "estimated", "refused"},
    }
    counts = {
        "diverged_windows",
        "refused_windows",
        "first_axle",
        "axle",
        "axles",
        "baseline",
        "gaps",
        "id",
        "n_windows",
        "number",
        "passes",
        "status",
        "version",
    }
    counts |= {
        "interval",
        "windows",
        "faulty_windows",
        "hunting_windows",
        "striking_windows",
        "implausible_windows",
        "rejected_recordings",
    }
    counts |= {"rejected_reasons", "reasons", "more_than", "member_count", "open_member_count", "numbers"}
    counts |= {"on_evaluations", "off_evaluations", "clear_seen"}
    counts |= {"geometry_baseline", "left_out", "library_sections", "library_wheelsets", "n_periods", "n_wheelsets"}
    counts |= {"bogie", "urgency_rank", "visit", "size_bytes", "status_code"}
    counts |= {"compared", "covered", "considered", "on_file", "measurements"}  # of measurements
    counts |= {"attempts", "past_findings", "recent_findings", "other_vehicles", "windows_left_out"}
    counts |= {"intervals_before", "intervals_behind"}
    counts |= {"same_since_version", "points", "rounds", "refused_windows", "refused_windows_by_code", "wheelsets"}
    units = (
        "_mm",
        "_m",
        "_km",
        "_m_s",
        "_km_h",
        "_m_s2",
        "_1",
        "_s",
        "_hz",
        "_rad",
        "_deg",
        "_per_mm",
        "_per_1000_km",
        "_per_year",
        "_days",
        "_hours",
    )
    for name, schema in DOCUMENT["components"]["schemas"].items():
        for field, described in schema.get("properties", {}).items():
            text = json.dumps(described)
            numeric = '"type": "number"' in text or '"type": "integer"' in text
            if numeric and field not in counts | bare.get(name, set()) | {"counts", "track_versions"}:
                assert field.endswith(units), f"{name}.{field}"


def test_examples_validate() -> None:
    checked = 0
    for name, schema in DOCUMENT["components"]["schemas"].items():
        for field, described in [("", schema), *schema.get("properties", {}).items()]:
            whole = {**described, "components": DOCUMENT["components"]}
            for example in described.get("examples", ()):
                problems = [str(error) for error in jsonschema_rs.validator_for(whole).iter_errors(example)]
                assert problems == [], f"{name}.{field}: {problems}"
                checked += 1
    for path, _, operation in operations():
        for parameter in operation.get("parameters", ()):
            for example in parameter["schema"].get("examples", ()):
                jsonschema_rs.validate(parameter["schema"], example)
                checked += 1
            assert "examples" not in parameter, path
    assert checked > 30


@pytest.fixture(scope="session")
def described_operations(service: Service) -> list[Any]:
    """Return the operations as schemathesis reads them from the running service."""
    served = json.loads(service.client.get("/openapi.json").content)
    for item in served["paths"].values():
        for one in item.values():
            one.pop("security", None)  # access to this service is open; the tests of access ask with and without keys
    served.pop("security", None)
    schema = schemathesis.openapi.from_dict(served)
    schema.config.update(base_url=service.url)
    return [result.ok() for result in schema.get_all_operations()]


@pytest.mark.parametrize("part", range(PARTS))
def test_the_service_answers_whatever_it_is_asked_as_the_document_says(
    described_operations: list[Any], part: int
) -> None:
    """Ask every operation; the long form is ``python -m bench fuzz``."""
    checks = [
        not_a_server_error,
        content_type_conformance,
        response_schema_conformance,
        status_code_conformance,
        negative_data_rejection,
        unsupported_method,
    ]
    assert len(described_operations) == len(operations())
    for operation in described_operations[part::PARTS]:
        if operation.path == "/v1/jobs/{name}/runs" and operation.method == "post":
            continue  # what a run changes is held in its own test
        if operation.path == "/v1/alerts/feed/stream":
            continue  # it goes on for ever, see test_feed_stream.py
        for mode in _modes(operation):

            @settings(
                max_examples=6,
                derandomize=True,
                database=None,
                phases=[Phase.explicit, Phase.generate],
                suppress_health_check=list(HealthCheck),
            )
            @given(case=operation.as_strategy(generation_mode=mode))
            def ask(case: schemathesis.Case) -> None:
                _answer_at_once(case)
                case.call_and_validate(checks=checks)

            ask()


def _answer_at_once(case: schemathesis.Case) -> None:
    """Let a long poll not wait; what it refuses stays."""
    wait_s = (case.query or {}).get("wait_s")
    if isinstance(wait_s, int | float) and 0 <= wait_s <= 60:
        case.query["wait_s"] = 0


def _modes(operation: schemathesis.schemas.APIOperation[Any, Any, Any, Any]) -> list[schemathesis.GenerationMode]:
    """Return how an operation can be asked: wrongly only where it takes something that can be wrong."""
    described = DOCUMENT["paths"][operation.path][operation.method]
    takes = [one for one in described.get("parameters", ()) if one["in"] != "header"]
    if takes or "requestBody" in described:
        return list(schemathesis.GenerationMode)
    return [schemathesis.GenerationMode.POSITIVE]
