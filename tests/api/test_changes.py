"""Changes: If-Match, Idempotency-Key, what happens to alerts and wheelsets."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import count

import api_fleet
import httpx
import pytest
from running_service import Service

_numbers = count()
ACKNOWLEDGE = {"by": "j.smith", "note": "seen"}
SHELVE = {"by": "j.smith", "until": "2200-01-01T00:00:00Z", "reason": "reprofiling is ordered"}
UNSHELVE = {"by": "a.nother", "note": "the lathe is free"}
LINK = {"ref": "maximo:WO-4711", "by": "maximo"}
ACTIONS = [("acknowledge", ACKNOWLEDGE), ("shelve", SHELVE), ("external-refs", LINK)]


def fresh_alert(service: Service) -> str:
    """Return the path of an alert of the test's own."""
    serial = api_fleet.WHEELSETS[10 + next(_numbers) % 10]
    alert = api_fleet.raised(service.storage, serial, "sensor_fault")
    return f"/v1/alerts/{alert.alert_id}"


def tag_of(service: Service, path: str) -> str:
    return service.client.get(path).headers["etag"]


def post(service: Service, path: str, body: Mapping[str, object], **headers: str) -> httpx.Response:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return service.client.post(path, json=body, headers=named)


def events(service: Service, path: str) -> list[str]:
    return [item["event"] for item in service.client.get(f"{path}/events").json()["items"]]


def test_an_alert_is_acknowledged_shelved_and_linked_and_each_is_an_event(service: Service) -> None:
    path = fresh_alert(service)
    assert service.client.get(path).json()["display_state"] == "active"
    first = post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match=tag_of(service, path))
    assert first.status_code == 200, first.text
    assert first.json()["acknowledged_by"] == "j.smith"
    assert first.json()["display_state"] == "acknowledged"
    second = post(service, f"{path}/shelve", SHELVE, If_Match=first.headers["etag"])
    assert second.json()["shelved_until"] == "2200-01-01T00:00:00Z"
    assert second.json()["display_state"] == "shelved"
    third = post(service, f"{path}/external-refs", LINK, If_Match=second.headers["etag"])
    assert third.json()["external_refs"] == ["maximo:WO-4711"]
    assert service.client.get(path).content == third.content
    assert events(service, path) == ["raised", "acknowledged", "shelved", "updated"]
    items = service.client.get(f"{path}/events").json()["items"]
    assert [item["actor"] for item in items] == ["treadwatch", "j.smith", "j.smith", "maximo"]
    assert items[1]["note"] == "seen"
    assert items[1]["alert"]["shelved_until"] is None
    assert items[3]["alert"]["version"] == third.json()["version"]


def test_a_shelved_alert_is_brought_back_before_its_time(service: Service) -> None:
    path = fresh_alert(service)
    before = service.client.get("/v1/alerts/feed?limit=1000").json()["next_cursor"]
    post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match="*")
    assert post(service, f"{path}/unshelve", UNSHELVE, If_Match="*").status_code == 409
    post(service, f"{path}/shelve", SHELVE, If_Match="*")
    back = post(service, f"{path}/unshelve", UNSHELVE, If_Match=tag_of(service, path)).json()
    assert (back["shelved_until"], back["shelved_reason"], back["display_state"]) == (None, None, "acknowledged")
    again = post(service, f"{path}/unshelve", UNSHELVE, If_Match="*")
    assert (again.status_code, again.headers["content-type"]) == (409, "application/problem+json")
    assert again.json()["detail"].endswith("not shelved")
    last = service.client.get(f"{path}/events").json()["items"][-1]
    assert (last["event"], last["actor"], last["note"]) == ("unshelved", "a.nother", "the lathe is free")
    feed = service.client.get("/v1/alerts/feed", params={"after": before}).json()["items"]
    assert [item["event"] for item in feed] == ["acknowledged", "shelved", "unshelved"]


@pytest.mark.parametrize(("action", "body"), ACTIONS)
def test_a_change_without_if_match_is_428_and_with_a_stale_one_412(
    service: Service, action: str, body: Mapping[str, object]
) -> None:
    path = fresh_alert(service)
    stale = tag_of(service, path)
    missing = post(service, f"{path}/{action}", body)
    assert (missing.status_code, missing.json()["type"]) == (428, "urn:treadwatch:problem:precondition-required")
    post(service, f"{path}/external-refs", {"ref": "other"}, If_Match=stale)
    for tag in (stale, '"nonsense"', f"W/{tag_of(service, path)}"):
        refused = post(service, f"{path}/{action}", body, If_Match=tag)
        assert (refused.status_code, refused.json()["type"]) == (412, "urn:treadwatch:problem:precondition-failed")
        assert refused.headers["etag"] == tag_of(service, path)
    assert events(service, path) == ["raised", "updated"]
    assert post(service, f"{path}/{action}", body, If_Match=f'"other", {tag_of(service, path)}').status_code == 200


@pytest.mark.parametrize(("action", "body"), ACTIONS)
def test_a_repeat_under_the_same_key_changes_nothing_and_gets_the_same_answer(
    service: Service, action: str, body: Mapping[str, object]
) -> None:
    path, key = fresh_alert(service), str(uuid.uuid4())
    tag = tag_of(service, path)
    first = post(service, f"{path}/{action}", body, If_Match=tag, Idempotency_Key=key)
    assert first.status_code == 200
    for if_match in (tag, '"whatever"'):
        again = post(service, f"{path}/{action}", body, If_Match=if_match, Idempotency_Key=key)
        assert (again.status_code, again.content) == (200, first.content)
        assert again.headers["etag"] == first.headers["etag"]
        assert again.headers["idempotency-replayed"] == "true"
    assert len(events(service, path)) == 2
    other = post(service, f"{path}/{action}", {**body, "by": "another"}, If_Match=tag, Idempotency_Key=key)
    assert (other.status_code, other.json()["type"]) == (422, "urn:treadwatch:problem:idempotency-key-reused")
    elsewhere = post(service, f"{fresh_alert(service)}/{action}", body, If_Match="*", Idempotency_Key=key)
    assert elsewhere.status_code == 422


def test_a_refused_change_is_not_remembered_under_its_key(service: Service) -> None:
    path, key = fresh_alert(service), str(uuid.uuid4())
    refused = post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match='"stale"', Idempotency_Key=key)
    assert refused.status_code == 412
    done = post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match=tag_of(service, path), Idempotency_Key=key)
    assert done.status_code == 200
    assert "idempotency-replayed" not in done.headers


@pytest.mark.parametrize("key", ["", "k" * 256])
def test_a_key_of_the_wrong_length_is_422(service: Service, key: str) -> None:
    path = fresh_alert(service)
    response = post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match="*", Idempotency_Key=key)
    assert response.status_code == 422


def test_a_change_that_the_alerts_state_forbids_is_409(service: Service) -> None:
    path = fresh_alert(service)
    post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match="*")
    again = post(service, f"{path}/acknowledge", ACKNOWLEDGE, If_Match="*")
    assert (again.status_code, again.json()["type"]) == (409, "urn:treadwatch:problem:conflict")
    assert "j.smith" in again.json()["detail"]


def test_shelving_into_the_past_is_422_and_names_the_field(service: Service) -> None:
    path = fresh_alert(service)
    response = post(service, f"{path}/shelve", {**SHELVE, "until": "2020-01-01T00:00:00Z"}, If_Match="*")
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == "#/until"
    assert events(service, path) == ["raised"]


def test_of_many_who_saw_the_same_alert_one_acknowledges_it(service: Service) -> None:
    path = fresh_alert(service)
    tag = tag_of(service, path)

    def acknowledge(number: int) -> int:
        return post(service, f"{path}/acknowledge", {"by": f"person {number}"}, If_Match=tag).status_code

    with ThreadPoolExecutor(8) as pool:
        statuses = sorted(pool.map(acknowledge, range(8)))
    assert statuses == [200] + [412] * 7
    assert events(service, path) == ["raised", "acknowledged"]


def test_of_many_repeats_at_the_same_time_one_is_done(service: Service) -> None:
    path, key = fresh_alert(service), str(uuid.uuid4())

    def link(_: int) -> httpx.Response:
        return post(service, f"{path}/external-refs", LINK, If_Match="*", Idempotency_Key=key)

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(link, range(8)))
    assert {answer.status_code for answer in answers} <= {200, 409}
    assert len({answer.content for answer in answers if answer.status_code == 200}) == 1
    assert events(service, path) == ["raised", "updated"]


def test_a_reprofiling_is_recorded_under_the_wheelsets_etag(service: Service) -> None:
    path, key = "/v1/wheelsets/WS-021", str(uuid.uuid4())
    body = {"reprofiled_at": "2025-09-01T06:00:00+02:00", "mileage_km": 151200.5, "note": "lathe 2"}
    tag = tag_of(service, path)
    assert post(service, f"{path}/reprofilings", body).status_code == 428
    assert post(service, f"{path}/reprofilings", body, If_Match='"old"').status_code == 412
    done = post(service, f"{path}/reprofilings", body, If_Match=tag, Idempotency_Key=key)
    assert done.status_code == 201, done.text
    assert done.json() == {**body, "wheelset": "WS-021", "reprofiled_at": "2025-09-01T04:00:00Z"}
    assert service.client.get(path).json()["reprofilings"] == [done.json()]
    assert service.client.get(f"{path}/reprofilings").json()["items"] == [done.json()]
    again = post(service, f"{path}/reprofilings", body, If_Match=tag, Idempotency_Key=key)
    assert (again.status_code, again.content) == (201, done.content)
    assert post(service, f"{path}/reprofilings", body, If_Match=tag).status_code == 412
    same_time = post(service, f"{path}/reprofilings", {**body, "mileage_km": 1.0}, If_Match=tag_of(service, path))
    assert same_time.status_code == 409
    assert service.client.get(path).json()["reprofilings"] == [done.json()]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("reprofiled_at", "yesterday"),
        ("reprofiled_at", 1_700_000_000),
        ("mileage_km", -1.0),
        ("mileage_km", "12"),
        ("mileage_km", None),
        ("note", 7),
        ("extra", "field"),
    ],
)
def test_a_wrong_field_of_a_reprofiling_is_422_and_named(service: Service, field: str, value: object) -> None:
    body = {"reprofiled_at": "2025-09-01T06:00:00Z", "mileage_km": 10.0, field: value}
    response = post(service, "/v1/wheelsets/WS-022/reprofilings", body, If_Match="*")
    assert response.status_code == 422
    assert [(error["in"], error["pointer"]) for error in response.json()["errors"]] == [("body", f"#/{field}")]
    assert service.client.get("/v1/wheelsets/WS-022").json()["reprofilings"] == []


def test_nan_in_a_body_is_422(service: Service) -> None:
    content = b'{"reprofiled_at": "2025-09-01T06:00:00Z", "mileage_km": NaN}'
    headers = {"Content-Type": "application/json", "If-Match": "*"}
    response = service.client.post("/v1/wheelsets/WS-022/reprofilings", content=content, headers=headers)
    assert response.status_code == 422


def test_changes_to_what_does_not_exist_are_404(service: Service) -> None:
    assert post(service, "/v1/alerts/999999/acknowledge", ACKNOWLEDGE, If_Match="*").status_code == 404
    body = {"reprofiled_at": "2025-09-01T06:00:00Z", "mileage_km": 10.0}
    assert post(service, "/v1/wheelsets/WS-999/reprofilings", body, If_Match="*").status_code == 404
