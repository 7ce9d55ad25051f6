"""Fleet alerts over REST: one item of the feed, which leads to its members and back."""

from __future__ import annotations

from typing import Any

import api_fleet
import httpx
from running_service import Service

from estimation.alerts.rule_book import RuleBook
from estimation.jobs.evaluate_alerts import raise_in_fleet
from estimation.values.alerts import Alert, AlertEventKind, Transition

MEMBERS = api_fleet.WHEELSETS[11:18]
KIND = "wheel_asymmetry"


def feed(service: Service, after: str | None) -> dict[str, Any]:
    params = {"limit": "1000"} | ({} if after is None else {"after": after})
    body: dict[str, Any] = service.client.get("/v1/alerts/feed", params=params).json()
    return body


def items(client: httpx.Client, path: str) -> list[dict[str, Any]]:
    response = client.get(path)
    assert response.status_code == 200, response.text
    found: list[dict[str, Any]] = response.json()["items"]
    return found


def alarm_flood(service: Service) -> Alert:
    """Raise alerts of seven wheelsets at once, or find them raised, and return their fleet alert."""
    with service.storage.write() as unit:
        found = [Transition(api_fleet.alert(s, KIND, "=beta"), (AlertEventKind.RAISED,)) for s in MEMBERS]
        if next((one for one in unit.alerts.all_open(MEMBERS[0]) if one.kind == KIND), None) is None:
            raise_in_fleet(unit, "=beta", found, RuleBook(), api_fleet.RECORDED)
        (fleet_alert,) = [alert for alert in unit.alerts.open_in_fleet("=beta") if alert.wheelset is None]
    return fleet_alert


def test_an_alarm_flood_is_one_item_of_the_feed_that_leads_to_its_members_and_back(service: Service) -> None:
    before = feed(service, None)["next_cursor"]
    fleet_alert = alarm_flood(service)
    (item,) = feed(service, before)["items"]
    served = item["alert"]
    assert (item["event"], served["id"], served["wheelset"]) == ("raised", fleet_alert.alert_id, None)
    assert (served["scope"], served["fleet"], served["fleet_alert_id"]) == ("fleet", "=beta", None)
    assert (served["limit_unit"], served["raise_limit"], served["probability_1"]) == (None, None, None)
    assert set(served["links"]) == {"self", "events", "members"}
    assert service.client.get(served["links"]["self"]).json() == served
    members = items(service.client, served["links"]["members"])
    assert [member["wheelset"] for member in members] == MEMBERS
    evidence = served["evidence"]
    assert (evidence["kind"], evidence["member_count"], evidence["open_member_count"]) == ("fleet_alert", 7, 7)
    assert evidence["wheelsets"] == MEMBERS[:5]
    assert evidence["members"] == served["links"]["members"]
    for member in members:
        assert (member["scope"], member["fleet_alert_id"]) == ("wheelset", served["id"])
        assert service.client.get(member["links"]["fleet_alert"]).json() == served
        assert [event["event"] for event in items(service.client, member["links"]["events"])] == ["raised"]


def test_lists_distinguish_fleet_alerts_from_those_of_wheelsets(service: Service) -> None:
    number = alarm_flood(service).alert_id
    client = service.client
    assert [alert["id"] for alert in items(client, "/v1/alerts?scope=fleet&open=true")] == [number]
    of_wheelsets = items(client, f"/v1/alerts?scope=wheelset&kind={KIND}&fleet=%3Dbeta&open=true&limit=1000")
    assert [alert["wheelset"] for alert in of_wheelsets] == MEMBERS
    assert number in [alert["id"] for alert in items(client, "/v1/alerts?limit=1000&fleet=%3Dbeta")]
    assert items(client, f"/v1/alerts?scope=fleet&fleet_alert={number}") == []
    assert client.get(f"/v1/alerts?fleet_alert={of_wheelsets[0]['id']}").status_code == 404
    assert client.get("/v1/alerts?scope=vehicle").status_code == 422
    assert client.get("/v1/alerts?fleet_alert=0").status_code == 422


def test_pages_of_members_join_and_keep_their_cursor_to_themselves(service: Service) -> None:
    path = f"/v1/alerts?fleet_alert={alarm_flood(service).alert_id}&limit=3"
    seen: list[str] = []
    while path is not None:
        body = service.client.get(path).json()
        seen += [alert["wheelset"] for alert in body["items"]]
        path = body["next"]
    assert seen == MEMBERS
    first = service.client.get("/v1/alerts?scope=wheelset&limit=1").json()["next_cursor"]
    assert service.client.get("/v1/alerts", params={"scope": "fleet", "cursor": first}).status_code == 400


def test_a_fleet_alert_is_acknowledged_like_any_other_and_members_stay_out_of_the_feed(service: Service) -> None:
    fleet_alert = alarm_flood(service)
    (first, *_) = items(service.client, f"/v1/alerts?fleet_alert={fleet_alert.alert_id}")
    before = feed(service, None)["next_cursor"]
    for path in (first["links"]["self"], f"/v1/alerts/{fleet_alert.alert_id}"):
        tag = service.client.get(path).headers["etag"]
        reference = {"ref": "maximo:WO-1", "by": "maximo"}
        done = service.client.post(f"{path}/external-refs", json=reference, headers={"If-Match": tag})
        assert done.status_code == 200, done.text
        assert done.json()["external_refs"] == ["maximo:WO-1"]
    assert [(i["event"], i["alert"]["id"]) for i in feed(service, before)["items"]] == [
        ("updated", fleet_alert.alert_id)
    ]
    done = service.client.post(
        f"/v1/alerts/{fleet_alert.alert_id}/acknowledge", json={"by": "j.smith"}, headers={"If-Match": "*"}
    )
    assert done.json()["display_state"] == "acknowledged"
    assert service.client.get(first["links"]["self"]).json()["acknowledged_by"] is None


def test_metrics_count_the_members_and_not_their_fleet_alert(service: Service) -> None:
    alarm_flood(service)
    lines = service.client.get("/metrics").text.splitlines()
    wanted = f'treadwatch_alerts_open{{fleet="=beta",kind="{KIND}",severity="warning"}} '
    assert [float(line.removeprefix(wanted)) for line in lines if line.startswith(wanted)] == [len(MEMBERS)]
