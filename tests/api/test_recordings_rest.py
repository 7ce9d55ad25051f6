"""Recordings over REST: what was received, what became of it, and what is done to it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from api_fleet import START
from running_service import Service

from api.times import to_rfc3339
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.records import ChunkRecord, ChunkState

SECOND = 1_000_000_000
DAY = 86_400 * SECOND
DECODED, REJECTED, UNKNOWN, AWAY = (mark * 32 for mark in ("a1", "b2", "c3", "d4"))
DAMAGED = Reason(ReasonCode.LOG_DAMAGED, "ends at /data/raw/b2/b2.blf")
NOT_ON_FILE = Reason(ReasonCode.VEHICLE_UNKNOWN, "no vehicle 'V-9'")


def receipt(digest: str, vehicle: str, received_ns: int, state: ChunkState, **more: object) -> ChunkRecord:
    values: dict[str, Any] = {
        "reason": None,
        "first_ns": None,
        "last_ns": None,
        "frames": 0,
        "counts": {},
        "file_name": "=1+1.blf",
    }
    return ChunkRecord(
        digest, vehicle, ".blf", 7, state, received_ns=received_ns, recorded_ns=received_ns, **(values | more)
    )


RECEIPTS = (
    receipt(
        DECODED,
        "V-0",
        START + 50 * DAY,
        ChunkState.DECODED,
        first_ns=START,
        last_ns=START + 60 * SECOND,
        frames=100,
        counts={"frames": 100, "decoded": 90, "unknown_identifiers": 8, "error_frames": 2, "syncs": 5, "own_time": 1},
    ),
    receipt(REJECTED, "V-1", START + 51 * DAY, ChunkState.REJECTED, reason=DAMAGED),
    receipt(UNKNOWN, "V-9", START + 51 * DAY, ChunkState.STORED, reason=NOT_ON_FILE, file_name=None),
    receipt(AWAY, "V-1", START + 49 * DAY, ChunkState.SET_ASIDE, reason=Reason(ReasonCode.SET_ASIDE, "by hand")),
)


@pytest.fixture
def service(service: Service) -> Iterator[Service]:
    """Yield the service with recordings as they are before anything is done to them."""
    with service.storage.write() as unit:
        for one in RECEIPTS:
            if not unit.chunks.put(one):
                unit.chunks.update(one)
    yield service
    with service.storage.write() as unit:  # a rejected one raises an alert, a stored one is decoded: not in other tests
        for one in RECEIPTS:
            unit.chunks.update(receipt(one.digest, one.vehicle, one.received_ns, ChunkState.DELETED))
        unit.stale_spans.remove(unit.stale_spans.all())


@pytest.fixture
def client(service: Service) -> httpx.Client:
    """Return the client alone."""
    return service.client


def digests(client: httpx.Client, **query: object) -> list[str]:
    response = client.get("/v1/recordings", params={name.rstrip("_"): str(value) for name, value in query.items()})
    assert response.status_code == 200, response.text
    return [item["digest"] for item in response.json()["items"] if item["digest"] in {one.digest for one in RECEIPTS}]


def corrected(client: httpx.Client, digest: str, what: str, **body: object) -> dict[str, Any]:
    response = client.post(f"/v1/recordings/{digest}/{what}", json=body)
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


def test_the_newest_come_first_and_pages_hold_each_once(client: httpx.Client) -> None:
    assert digests(client) == [UNKNOWN, REJECTED, DECODED, AWAY]
    found: list[str] = []
    path: str | None = "/v1/recordings?limit=1"
    while path is not None:
        page = client.get(path).json()
        found += [item["digest"] for item in page["items"]]
        path = page["next"]
    assert [one for one in found if one in {r.digest for r in RECEIPTS}] == [UNKNOWN, REJECTED, DECODED, AWAY]
    assert len(found) == len(set(found))


def test_each_filter_leaves_those_that_it_means(client: httpx.Client) -> None:
    assert digests(client, vehicle="V-9") == [UNKNOWN]
    assert digests(client, state="rejected") == [REJECTED]
    assert digests(client, reason_code="vehicle_unknown") == [UNKNOWN]
    assert digests(client, state="deleted") == []
    assert digests(client, fleet="alpha", vehicle="V-9") == []
    assert DECODED in digests(client, fleet="alpha")
    assert UNKNOWN not in digests(client, fleet="alpha")
    at = START + 51 * DAY
    assert digests(client, received_from=to_rfc3339(at)) == [UNKNOWN, REJECTED]
    assert digests(client, received_to=to_rfc3339(at)) == [DECODED, AWAY]
    last = START + 60 * SECOND
    assert digests(client, from_=to_rfc3339(last), vehicle="V-0") == [DECODED]
    assert digests(client, from_=to_rfc3339(last + 1), vehicle="V-0") == []
    assert digests(client, to=to_rfc3339(START + 1), vehicle="V-0") == [DECODED]
    assert digests(client, to=to_rfc3339(START), vehicle="V-0") == []


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("fleet=nobody", 404),
        ("vehicle=nobody", 404),
        ("state=open", 422),
        ("received_from=2026-01-02T00:00:00Z&received_to=2026-01-01T00:00:00Z", 422),
        ("cursor=W10", 400),
    ],
)
def test_a_filter_that_means_nothing_is_refused(client: httpx.Client, query: str, status: int) -> None:
    response = client.get(f"/v1/recordings?{query}")
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"


def test_one_recording_says_what_became_of_its_frames_and_windows(client: httpx.Client) -> None:
    found = client.get(f"/v1/recordings/{DECODED}").json()
    assert found["counts"] == {
        "frames": 100,
        "used": 90,
        "unused": {"unknown_identifiers": 8, "error_frames": 2},
        "lost": 0,
        "marked": {"syncs": 5},
    }
    windows = found["windows"]
    assert windows["made"] == windows["pending"] + windows["estimated"] + windows["refused"] > 0
    assert (found["file_name"], found["size_bytes"], found["format"]) == ("=1+1.blf", 7, ".blf")
    rejected = client.get(f"/v1/recordings/{REJECTED}").json()
    assert (rejected["reason_code"], rejected["reason"]) == ("log_damaged", "ends at b2.blf")
    assert rejected["windows"]["made"] == 0
    assert client.get(f"/v1/recordings/{'0' * 64}").status_code == 404
    assert client.get("/v1/recordings/xyz").status_code == 422


def test_the_list_is_a_table_without_formulas(client: httpx.Client) -> None:
    table = client.get("/v1/recordings?vehicle=V-0", headers={"Accept": "text/csv"})
    head, *rows = table.text.splitlines()
    assert head.startswith("digest,vehicle,file_name,format,size_bytes,received_at,")
    assert any(",'=1+1.blf," in row for row in rows)


def test_one_under_a_wrong_name_is_given_to_its_vehicle_once_for_a_key(client: httpx.Client) -> None:
    body = {"vehicle": "V-1", "why": "wrong name", "by": "kim"}
    url, key = f"/v1/recordings/{UNKNOWN}/reassign", {"Idempotency-Key": f"{client.base_url}reassign"}
    first = client.post(url, json=body, headers=key)
    assert first.status_code == 200, first.text
    found = first.json()
    assert (found["vehicle"], found["state"], found["reason"]) == ("V-1", "stored", None)
    (change,) = [one for one in found["changes"] if one["action"] == "reassign"][-1:]
    assert (change["by"], change["why"]) == ("kim", "wrong name")
    assert (change["vehicle_before"], change["vehicle_after"]) == ("V-9", "V-1")
    assert client.post(url, json=body, headers=key).json() == found
    again = client.post(url, json=body)
    assert (again.status_code, again.json()["detail"]) == (409, f"recording {UNKNOWN[:12]} is of vehicle V-1 already")
    assert client.post(url, json=body | {"vehicle": "nobody"}).status_code == 404
    assert client.post(url, json={"vehicle": "V-2"}).status_code == 422


def test_a_rejected_one_is_tried_again_and_a_decoded_one_is_not(client: httpx.Client) -> None:
    assert corrected(client, REJECTED, "retry", why="copied again")["state"] == "stored"
    refused = client.post(f"/v1/recordings/{DECODED}/retry", json={"why": "again"})
    assert (refused.status_code, refused.json()["detail"]) == (409, f"recording {DECODED[:12]} is decoded")


def test_a_deleted_one_leaves_the_list_and_says_who_and_why(client: httpx.Client) -> None:
    url = f"/v1/recordings/{DECODED}"
    assert client.delete(url).status_code == 422  # without a reason
    response = client.delete(url, params={"why": "test bench", "by": "kim"})
    assert response.status_code == 200, response.text
    found = client.get(url).json()
    assert (found["state"], found["reason_code"], found["measured_from"]) == ("deleted", "deleted", None)
    assert found["reason"].endswith(" by kim: test bench")
    assert found["bytes_removed_at"] is not None
    assert DECODED not in digests(client)
    assert digests(client, state="deleted") == [DECODED]
    assert client.delete(url, params={"why": "again"}).status_code == 409
    assert client.post(f"{url}/retry", json={"why": "again"}).status_code == 409
