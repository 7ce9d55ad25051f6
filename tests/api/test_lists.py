"""Lists: opaque keyset cursors that belong to their filter, limits, links."""

from __future__ import annotations

import base64
import json
from typing import Any

import api_fleet
import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from running_service import Service

from api import cursors
from api.problems import ProblemError

LISTS = [
    "/v1/fleets",
    "/v1/vehicles",
    "/v1/vehicle-classes",
    "/v1/wheelsets",
    "/v1/wheelsets?fleet=alpha",
    "/v1/wheelsets?vehicle=V-0",
    "/v1/wheelsets/WS-000/windows",
    "/v1/wheelsets/WS-000/windows?from=2025-06-15T15:08:00Z&to=2025-06-15T15:14:10Z",
    "/v1/wheelsets/WS-000/mountings",
    "/v1/wheelsets/WS-000/reprofilings",
    "/v1/wheelsets/WS-000/measured-profiles",
    "/v1/alerts?condition=active&fleet=%3Dbeta",
    "/v1/jobs",
    "/v1/jobs/estimate_windows/runs",
    "/v1/quarantine",
    "/v1/quarantine?kind=window",
    "/v1/track-sections",
    "/v1/track-sections/S-3/alignments",
]


def pages(client: httpx.Client, path: str, limit: int) -> list[list[object]]:
    """Walk a list by its own links."""
    found, following = [], f"{path}{'&' if '?' in path else '?'}limit={limit}"
    while following is not None:
        response = client.get(following)
        assert response.status_code == 200, response.text
        page = response.json()
        found.append(page["items"])
        link = response.links.get("next")
        assert (link["url"] if link else None) == page["next"]
        assert (page["next"] is None) == (page["next_cursor"] is None)
        following = page["next"]
    return found


@pytest.mark.parametrize("path", LISTS)
def test_pages_of_any_length_join_to_the_whole_list(client: httpx.Client, path: str) -> None:
    (whole,) = pages(client, path, 1000)

    @settings(max_examples=5, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(st.integers(1, 12))
    def walk(limit: int) -> None:
        found = pages(client, path, limit)
        assert [item for page in found for item in page] == whole
        assert all(len(page) == limit for page in found[:-1])
        assert whole == [] or found[-1] != []

    walk()


@pytest.mark.parametrize("path", LISTS)
@pytest.mark.parametrize("limit", ["0", "-1", "1001", "x", "1.5", "", "99999999999999999999"])
def test_a_limit_out_of_range_is_422(client: httpx.Client, path: str, limit: str) -> None:
    response = client.get(path.split("?", maxsplit=1)[0], params={"limit": limit})
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert (error["in"], error["pointer"]) == ("query", "#/limit")


def test_a_list_is_a_hundred_long_when_nothing_is_said(service: Service) -> None:
    with service.storage.write() as unit:
        for index in range(130):
            unit.windows.put(api_fleet.window(index, "WS-020"), float(index), api_fleet.RECORDED)
    assert len(service.client.get("/v1/wheelsets/WS-020/windows").json()["items"]) == 100
    assert len(service.client.get("/v1/wheelsets/WS-020/windows?limit=1000").json()["items"]) == 130


def test_a_cursor_of_another_filter_or_list_is_400(client: httpx.Client) -> None:
    cursor = client.get("/v1/wheelsets?fleet=alpha&limit=2").json()["next_cursor"]
    assert client.get("/v1/wheelsets", params={"fleet": "alpha", "cursor": cursor}).status_code == 200
    for path in ("/v1/wheelsets", "/v1/wheelsets?fleet=%3Dbeta", "/v1/vehicles", "/v1/alerts", "/v1/fleets"):
        response = client.get(path + ("&" if "?" in path else "?") + f"cursor={cursor}")
        assert response.status_code == 400, path
        assert response.json()["type"] == "urn:treadwatch:problem:invalid-cursor"


@pytest.mark.parametrize("path", LISTS)
@pytest.mark.parametrize("cursor", ["", "abc", "%00", "💥", "a" * 5000, "eyJhIjoxfQ", "bnVsbA", "WzEsMl0"])
def test_garbage_for_a_cursor_is_400(client: httpx.Client, path: str, cursor: str) -> None:
    response = client.get(path.split("?", maxsplit=1)[0], params={"cursor": cursor})
    assert response.status_code == 400
    assert response.headers["content-type"] == "application/problem+json"


@settings(max_examples=300, derandomize=True)
@given(
    st.text(max_size=20),
    st.dictionaries(st.text(max_size=5), st.none() | st.text(max_size=5) | st.integers(), max_size=3),
    st.integers(-(2**63), 2**63 - 1),
    st.text(max_size=30).filter(lambda text: "\0" not in text),
)
def test_a_cursor_gives_its_key_back_and_only_under_its_filter(
    operation: str, filters: dict[str, Any], number: int, text: str
) -> None:
    assert cursors.decode_number(operation, filters, cursors.encode(operation, filters, number)) == number
    assert cursors.decode_text(operation, filters, cursors.encode(operation, filters, text)) == text
    for other in ((operation + "x", filters), (operation, filters | {"another": "filter"})):
        with pytest.raises(ProblemError) as refused:
            cursors.decode_number(*other, cursors.encode(operation, filters, number))
        assert refused.value.status == 400


@settings(max_examples=300, derandomize=True)
@given(
    st.one_of(
        st.text(),
        st.binary().map(lambda raw: base64.urlsafe_b64encode(raw).decode()),
        st.recursive(st.none() | st.booleans() | st.integers() | st.text(), st.lists).map(
            lambda value: base64.urlsafe_b64encode(json.dumps(value).encode()).decode()
        ),
    )
)
def test_no_text_makes_a_cursor_fail_but_with_400(text: str) -> None:
    for decode in (cursors.decode_number, cursors.decode_text):
        with pytest.raises(ProblemError) as refused:
            decode("list", {}, text)
        assert refused.value.status == 400


@pytest.mark.parametrize("key", [True, None, 2**63, 1.5, [1], {"a": 1}, "text"])
def test_a_forged_cursor_with_a_key_of_another_type_is_400(key: object) -> None:
    digest = json.loads(base64.urlsafe_b64decode(cursors.encode("list", {}, 1) + "=="))[0]
    forged = base64.urlsafe_b64encode(json.dumps([digest, key]).encode()).decode()
    with pytest.raises(ProblemError) as refused:
        cursors.decode_number("list", {}, forged)
    assert refused.value.status == 400


def test_a_storage_bound_to_a_fleet_shows_nothing_of_another(service: Service) -> None:
    with service.storage.seen_by(frozenset({"alpha"})).read() as unit:
        assert {one.code for one in unit.registry.fleets()} == {"alpha"}
        assert {one.fleet for one in unit.registry.wheelsets()} == {"alpha"}
        assert {event.alert.fleet for event in unit.alerts.feed(0, 1000)} <= {"alpha"}
    with service.storage.seen_by(frozenset({"none"})).read() as unit:
        assert unit.registry.wheelsets() == []
        assert unit.windows.page("WS-000", None, 10) == []
        assert unit.trends.latest("WS-000") is None
    with service.storage.read() as unit:
        assert {one.code for one in unit.registry.fleets()} > {"alpha"}
        assert unit.trends.latest("WS-000") is not None
