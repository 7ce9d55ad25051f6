"""Evidence of alerts: typed by kind, in RFC 3339, safe for every reader of JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import api_fleet
import httpx
import pytest
from alert_evidence_cases import AT, CASES
from hypothesis import given
from hypothesis import strategies as st
from running_service import Service

from api.schemas.evidence import evidence_of
from estimation.alerts.life_cycle import transition
from estimation.alerts.rule_book import ALERT_RULES
from estimation.values.alerts import AlertEventKind, Finding

DELAYS = {
    "on_evaluations": 1,
    "off_evaluations": 2,
    "on_delay_km": None,
    "off_delay_km": None,
    "acknowledgement_days": 90.0,
    "clear_seen": 0,
    "counted_at": "2026-01-01T00:00:00.123456789Z",
}


@pytest.mark.parametrize(("finding", "expected"), CASES, ids=lambda one: getattr(one, "kind", ""))
def test_every_rule_has_evidence_of_its_own_type(finding: Finding, expected: dict[str, Any]) -> None:
    evidence = {**finding.evidence, "delays": {**_stored_delays(), "counted_ns": AT}}
    found = evidence_of(replace(api_fleet.alert("W", finding.kind), evidence=evidence)).model_dump(mode="json")
    assert found == {"kind": finding.kind, **expected, "delays": found["delays"]}
    assert {name: found["delays"][name] for name in DELAYS} == DELAYS


def test_no_rule_is_without_a_type() -> None:
    assert [finding.kind for finding, _ in CASES if finding is not None] == [rule.kind for rule in ALERT_RULES]


def _stored_delays() -> dict[str, Any]:
    finding, _ = CASES[0]
    assert finding is not None
    change = transition(None, finding, AT, fleet="F")
    assert change is not None
    delays = change.alert.evidence["delays"]
    assert isinstance(delays, dict)
    return delays


def test_evidence_of_a_kind_that_no_rule_has_is_answered_by_what_it_is() -> None:
    stored: dict[str, Any] = {
        "depth": {"value": 0.3, "unit": "mm"},
        "seen_ns": AT,
        "windows": [1, 2],
        "sure": True,
    }
    found = evidence_of(replace(api_fleet.alert("W", "hot_axle_box"), evidence=stored)).model_dump(mode="json")
    assert found == {
        "kind": "other",
        "numbers": {"depth.value": 0.3, "windows.0": 1.0, "windows.1": 2.0},
        "texts": {"depth.unit": "mm", "sure": "True"},
        "times": {"seen_at": "2026-01-01T00:00:00.123456789Z"},
        "delays": None,
    }


LEAVES: list[Any] = [None, True, 3, -1.5, 2**60, 2**70, 1e300, float("nan"), float("inf"), "estimated", "x"]
JSON = st.sampled_from(
    [*LEAVES, LEAVES, LEAVES[:2], {"p50": 2**70, "value": "x", "interval_95": [1, None]}, {"counted_ns": 1e19}, [{}]]
)
KEYS = sorted({key for finding, _ in CASES if finding is not None for key in finding.evidence} | {"members", "delays"})


@given(
    st.sampled_from([*(rule.kind for rule in ALERT_RULES), "gone"]),
    st.booleans(),
    st.dictionaries(st.sampled_from(KEYS), JSON, max_size=6),
)
def test_whatever_is_stored_is_answered(kind: str, of_fleet: bool, stored: dict[str, Any]) -> None:  # noqa: FBT001 - drawn
    alert = replace(api_fleet.alert("W", kind), evidence=stored)
    found = evidence_of(replace(alert, wheelset=None) if of_fleet else alert)
    assert list(unsafe(found.model_dump(mode="json"))) == []


def unsafe(value: object, path: str = "") -> Iterator[str]:
    """Yield where JSON has a number that readers round, or nanoseconds."""
    if isinstance(value, dict):
        for name, item in value.items():
            if name.endswith("_ns") and isinstance(item, int | float):
                yield f"{path}/{name}"
            yield from unsafe(item, f"{path}/{name}")
    elif isinstance(value, list):
        for item in value:
            yield from unsafe(item, f"{path}/-")
    elif isinstance(value, int) and abs(value) >= 2**53:
        yield path


def test_the_feed_and_every_resource_are_without_nanoseconds(service: Service) -> None:
    serial = api_fleet.WHEELSETS[20]
    with service.storage.write() as unit:
        for finding, _ in CASES:
            assert finding is not None
            found = transition(None, replace(finding, wheelset=serial, breached=True, stands=None), AT, fleet="alpha")
            assert found is not None
            if all(one.kind != finding.kind for one in unit.alerts.all_open(serial)):
                unit.alerts.save(found.alert, (AlertEventKind.RAISED,), AT)
    kinds = {item["evidence"]["kind"] for item in items(service.client, f"/v1/alerts?wheelset={serial}&open=true")}
    assert kinds >= {rule.kind for rule in ALERT_RULES}
    paths = ["/v1/alerts?limit=1000", "/v1/alerts/feed?limit=1000", *_paths(service.client)]
    assert len(paths) > 20
    for path in paths:
        response = service.client.get(path)
        assert response.status_code == 200, (path, response.text)
        assert list(unsafe(response.json())) == [], path


def _paths(client: httpx.Client) -> list[str]:
    """Return the lists and everything that the first items of each link to."""
    lists = ["/v1/fleets", "/v1/vehicles", "/v1/wheelsets", "/v1/track-sections", "/v1/jobs", "/v1/vehicle-classes"]
    lists += ["/v1/quarantine", "/v1/alerts"]
    linked = {path for name in lists for item in items(client, name)[:3] for path in item.get("links", {}).values()}
    return lists + sorted(path for path in linked if client.get(path).status_code == 200)


def items(client: httpx.Client, path: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = client.get(path).json()["items"]
    return found
