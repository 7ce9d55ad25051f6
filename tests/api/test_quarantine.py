"""What failed by itself, over REST and in the metrics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import api_fleet
import httpx
import pytest
from running_service import Service

from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import SubjectKind
from fleet_db.records import ChunkRecord, ChunkState


def listed(client: httpx.Client, query: str = "") -> list[dict[str, Any]]:
    response = client.get(f"/v1/quarantine{query}")
    assert response.status_code == 200, response.text
    found: list[dict[str, Any]] = response.json()["items"]
    return found


def test_what_failed_is_listed_by_kind_key_and_stage(client: httpx.Client) -> None:
    found = [(item["kind"], item["key"], item["stage"]) for item in listed(client)]
    assert found == sorted((one.kind.value, one.key, one.stage) for one in api_fleet.quarantined())
    (failed,) = listed(client, "?kind=wheelset&state=held")
    assert failed == {
        "kind": "wheelset",
        "key": "WS-000",
        "stage": "refresh_geometry",
        "state": "held",
        "reason_code": "processing_failed",
        "reason": "ValueError: no",
        "attempts": 2,
        "first_failed_at": "2025-07-25T15:06:40.123456789Z",
        "last_failed_at": "2025-07-26T15:06:40.123456789Z",
        "next_attempt_at": "2025-07-26T15:10:40.123456789Z",
        "links": {"wheelset": "/v1/wheelsets/WS-000"},
    }
    (resolved,) = listed(client, "?state=resolved")
    assert (resolved["stage"], resolved["next_attempt_at"]) == ("refresh_trends", None)
    (section,) = listed(client, "?kind=section")
    assert section["links"] == {"section": "/v1/track-sections/A%2FB"}


def test_no_folder_of_the_machine_is_shown(client: httpx.Client) -> None:
    (waits,) = listed(client, "?reason_code=waits_for_storage")
    assert waits["reason"] == "cd.blf: No space left on device"


def test_those_of_a_vehicle_are_its_recordings_its_windows_and_itself(service: Service) -> None:
    record = ChunkRecord("ab" * 32, "V-0", ".blf", 1, ChunkState.STORED, None, None, None, 0, {}, 1, 1)
    with service.storage.write() as unit:
        unit.chunks.put(record)
    kinds = [item["kind"] for item in listed(service.client, "?vehicle=V-0")]
    assert kinds == ["recording", "vehicle", "window"]
    assert listed(service.client, "?vehicle=V-1") == []


@pytest.mark.parametrize("query", ["kind=axle", "state=open", "reason_code=none", "vehicle=", "vehicle=a%00b"])
def test_a_filter_that_means_nothing_is_422(client: httpx.Client, query: str) -> None:
    response = client.get(f"/v1/quarantine?{query}")
    assert response.status_code == 422
    assert response.headers["content-type"] == "application/problem+json"


def test_a_cursor_of_another_filter_is_400(client: httpx.Client) -> None:
    cursor = client.get("/v1/quarantine?limit=1").json()["next_cursor"]
    assert client.get("/v1/quarantine", params={"limit": 1, "cursor": cursor}).status_code == 200
    assert client.get("/v1/quarantine", params={"kind": "window", "cursor": cursor}).status_code == 400


def test_the_measures_count_what_is_held_by_kind_and_code(client: httpx.Client) -> None:
    lines = [line for line in client.get("/metrics").text.splitlines() if line.startswith("treadwatch_quarantined{")]
    counts = {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines)}
    assert counts['treadwatch_quarantined{kind="window",reason_code="processing_failed"}'] == 2.0
    assert counts['treadwatch_quarantined{kind="wheelset",reason_code="processing_failed"}'] == 1.0
    assert counts['treadwatch_quarantined{kind="fleet",reason_code="conflict"}'] == 0.0
    assert sum(counts.values()) == sum(one.state.value == "held" for one in api_fleet.quarantined())
    assert all(any(f'kind="{kind}"' in name for kind in SubjectKind) for name in counts)


def test_a_caller_bound_to_a_fleet_sees_what_failed_of_that_fleet(service: Service) -> None:
    def seen(*fleets: str) -> set[tuple[str, str]]:
        with service.storage.seen_by(frozenset(fleets)).read() as unit:
            found = unit.quarantine.page(kind=None, state=None, code=None, vehicle=None, after=None, limit=1000)
        return {(one.kind.value, one.key) for one in found}

    kept = {(one.kind.value, one.key) for one in api_fleet.quarantined()}
    more = {
        ("recording", "cd" * 32),
        ("window", "WS-B@7"),
        ("wheelset", "WS-B"),
        ("fleet", "=beta"),
        ("fleet", "alpha"),
    }
    of_beta = (more | {("window", f"{api_fleet.WHEELSETS[1]}@7")}) - {("fleet", "alpha")}
    of_alpha = (kept | {("fleet", "alpha")}) - of_beta - {("section", "A/B")}
    with service.storage.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("WS-B", "=beta", "P8", 0.45, None, ()))
        unit.registry.add_vehicle(VehicleRecord("V-B", "=beta", "regional", 4, 44.5, (0.0,) * 4))
        for digest, vehicle in (("ab" * 32, "V-0"), ("cd" * 32, "V-B")):
            unit.chunks.put(ChunkRecord(digest, vehicle, ".blf", 1, ChunkState.REJECTED, None, None, None, 0, {}, 1, 1))
        for kind, key in more:
            unit.quarantine.put(replace(api_fleet.quarantined()[0], kind=SubjectKind(kind), key=key))
    assert seen("=beta") == of_beta
    assert seen("alpha") == of_alpha
    assert seen("alpha", "=beta") == of_alpha | of_beta
    assert seen() == set()
