"""The worklist over HTTP: orders, filters, cursors, and every list as a table."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import api_fleet
import httpx
import pytest
from access_examples import paused_webhook
from one_database import in_turn
from populated_service import populated_service
from running_service import Service

from api.answers import columns_of
from api.app import committed_document
from api.routes.worklist import WheelsetRow, WorklistSort
from estimation.values.alerts import AlertEventKind, Severity, Urgency
from estimation.worklist.row import MEASURE

DOCUMENT = json.loads(committed_document())
OF_FLEET = {"serial": "WS-000", "code": "V-0", "name": "estimate_windows", "alert_id": "1", "section": "S-3"}


@pytest.fixture(scope="module", params=in_turn)
def service(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, postgres_server_url: str
) -> Iterator[Service]:
    """Yield a service of these tests alone."""
    with populated_service(request.param, tmp_path_factory.mktemp("data"), postgres_server_url) as found:
        yield found


def listed(client: httpx.Client, path: str) -> list[dict[str, Any]]:
    found, following = [], path
    while following is not None:
        response = client.get(following)
        assert response.status_code == 200, response.text
        found += response.json()["items"]
        following = response.json()["next"]
    return found


def table(response: httpx.Response) -> list[dict[str, str]]:
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "text/csv; charset=utf-8; header=present"
    return list(csv.DictReader(io.StringIO(response.text, newline="")))


def test_a_row_says_where_it_runs_how_it_is_and_why(client: httpx.Client) -> None:
    (row,) = [one for one in listed(client, "/v1/wheelsets") if one["serial"] == "WS-000"]
    place = (row["vehicle"], row["vehicle_class"], row["axle"], row["position"])
    assert place == ("V-0", "regional", 1, {"bogie": 1, "place": "leading"})
    state = row["state"]
    assert state["urgency"] == "due"
    text = f"the alert on the limit is not cleared yet (probability 0%): {MEASURE}"
    assert state["reasons"][0] == {"code": "limit_exceeded", "text": text}
    assert {alert["kind"] for alert in state["alerts"]} == {"conicity_limit", "no_data"}
    # the last window was read at 9,029 km, before the trend's last point at 11,000.5 km
    assert (state["mileage_km"], state["since_trend_km"]) == (9029.0, 0.0)
    trend = client.get(row["links"]["trend"]).json()
    assert state["distance_to_limit_km"] == trend["distance_to_limit_km"]
    assert state["date_of_limit"] == trend["date_of_limit"]
    assert state["slope_1_per_1000_km"] == trend["slope_1_per_1000_km"]
    assert state["conicity_1"] == trend["current_1"]
    assert client.get(row["links"]["state"]).json() == row
    WheelsetRow.model_validate_json(json.dumps(row))


@pytest.mark.parametrize("sort", WorklistSort)
def test_every_order_lists_every_wheelset_once_whatever_the_pages(client: httpx.Client, sort: WorklistSort) -> None:
    whole = [row["serial"] for row in listed(client, f"/v1/wheelsets?sort={sort}&limit=1000")]
    assert sorted(whole) == api_fleet.WHEELSETS
    assert [row["serial"] for row in listed(client, f"/v1/wheelsets?sort={sort}&limit=4")] == whole


def test_what_is_not_known_comes_last_in_both_directions(client: httpx.Client) -> None:
    for sort in ("distance_to_limit", "-distance_to_limit", "trend", "-trend"):
        serials = [row["serial"] for row in listed(client, f"/v1/wheelsets?sort={sort}")]
        assert serials[0] == "WS-000", sort


def test_filters_narrow_the_list_and_bind_the_cursor(client: httpx.Client) -> None:
    rows = listed(client, "/v1/wheelsets?urgency=probably_over&vehicle_class=regional&sort=urgency&limit=3")
    assert {row["serial"] for row in rows} == set(api_fleet.WHEELSETS[1:10])
    assert [row["state"]["urgency"] for row in rows] == ["probably_over"] * 9
    assert len(listed(client, "/v1/wheelsets?alert_kind=no_data")) == 1
    cursor = client.get("/v1/wheelsets?sort=urgency&limit=3").json()["next_cursor"]
    for other in ("sort=-urgency", "sort=urgency&status=estimated", "sort=urgency&alert_severity=warning"):
        assert client.get(f"/v1/wheelsets?{other}&cursor={cursor}").status_code == 400, other
    assert client.get("/v1/wheelsets?vehicle_class=no-such").status_code == 404
    for wrong in ("sort=age", "sort=--serial", "urgency=high", "status=good", "alert_kind=rust"):
        assert client.get(f"/v1/wheelsets?{wrong}").status_code == 422, wrong


def lists() -> list[str]:
    """Return the path of every operation that answers with a list, with objects of the fleet in it."""
    found = []
    for path, operations in DOCUMENT["paths"].items():
        content = operations.get("get", {}).get("responses", {}).get("200", {}).get("content", {})
        reference = content.get("application/json", {}).get("schema", {}).get("$ref", "").rsplit("/", 1)[-1]
        if "items" in DOCUMENT["components"]["schemas"].get(reference, {}).get("properties", {}):
            found.append(path)
    return found


@pytest.mark.parametrize("template", lists())
def test_every_list_is_a_table_with_the_documented_columns(service: Service, template: str) -> None:
    client = service.client
    names = OF_FLEET | {name: "S-3" for name in ("code",) if "section" in template}
    if "{webhook_id}" in template:
        names["webhook_id"] = paused_webhook(service.storage, "alpha")
    path = template.format_map(names)
    whole = client.get(path, params={"limit": 2} if "cursor" in json.dumps(DOCUMENT["paths"][template]) else {})
    answer = client.get(whole.url, headers={"Accept": "text/csv"})
    rows = table(answer)
    documented = DOCUMENT["paths"][template]["get"]["responses"]["200"]["content"]["text/csv"]
    assert answer.text.startswith(documented["example"])
    assert len(rows) == len(whole.json()["items"])
    assert answer.links.get("next") == whole.links.get("next")


def test_a_table_goes_on_by_its_link_and_guards_formulas(client: httpx.Client) -> None:
    rows, following = [], "/v1/wheelsets?sort=urgency&limit=10"
    while following is not None:
        answer = client.get(following, headers={"Accept": "text/csv"})
        rows += table(answer)
        following = answer.links.get("next", {}).get("url")
    assert [row["serial"] for row in rows] == [row["serial"] for row in listed(client, "/v1/wheelsets?sort=urgency")]
    assert {row["fleet"] for row in rows} == {"alpha", "'=beta"}
    (first,) = [row for row in rows if row["serial"] == "WS-000"]
    assert (first["mounting_vehicle"], first["mounting_reversed"]) == ("V-0", "false")
    assert (first["state_conicity_1_status"], first["state_distance_to_limit_km_p10"]) == ("estimated", "8000.0")
    assert json.loads(first["state_reasons"])[0]["code"] == "limit_exceeded"
    names = [column.name for column in columns_of(WheelsetRow)]
    assert len(set(names)) == len(names)


def test_urgencies_are_documented_with_their_meaning() -> None:
    described = DOCUMENT["components"]["schemas"]["Urgency"]["description"]
    assert all(f"`{urgency.value}`: {urgency.meaning}" in described for urgency in Urgency)


def test_alerts_say_where_their_wheelset_ran_and_come_in_the_order_asked_for(service: Service) -> None:
    client = service.client
    for serial, severity in (("WS-020", Severity.CRITICAL), ("WS-021", Severity.INFO), ("WS-022", Severity.CRITICAL)):
        alert = replace(api_fleet.alert(serial, "hunting"), severity=severity)
        with service.storage.write() as unit:
            unit.alerts.save(alert, [AlertEventKind.RAISED], api_fleet.RECORDED)
    oldest = listed(client, "/v1/alerts?limit=4")
    numbers = [alert["id"] for alert in oldest]
    assert numbers == sorted(numbers)
    assert [alert["id"] for alert in listed(client, "/v1/alerts?sort=-id&limit=4")] == numbers[::-1]
    worst = listed(client, "/v1/alerts?sort=-severity&limit=2")
    severities = ["info", "warning", "critical"]
    assert [alert["id"] for alert in worst] == [
        alert["id"] for alert in sorted(oldest, key=lambda one: (-severities.index(one["severity"]), -one["id"]))
    ]
    assert {alert["severity"] for alert in oldest} == set(severities)
    places = {alert["wheelset"]: (alert["vehicle"], alert["axle"]) for alert in oldest}
    assert (places["WS-000"], places["WS-005"], places["WS-009"]) == (("V-0", 1), ("V-1", 2), ("V-2", 2))
    assert listed(client, "/v1/alerts?severity=critical") == [one for one in oldest if one["severity"] == "critical"]
    cursor = client.get("/v1/alerts?sort=-severity&limit=1").json()["next_cursor"]
    assert client.get(f"/v1/alerts?sort=-id&cursor={cursor}").status_code == 400


def test_the_turning_plan_lists_who_is_turned_when_and_why(client: httpx.Client) -> None:
    plan = client.get("/v1/plans/reprofiling", params={"fleet": "alpha"}).json()
    assert {line["wheelset"] for line in plan["items"]} >= {"WS-000", "WS-002", "WS-004", "WS-006", "WS-008"}
    (first,) = [line for line in plan["items"] if line["wheelset"] == "WS-000"]
    assert (first["vehicle"], first["axle"], first["bogie"], first["cause"], first["visit"]) == ("V-0", 1, 1, "due", 1)
    assert first["turn_by"] == plan["made_at"]  # its date has passed
    assert first["reason"].startswith("the alert on the limit is not cleared yet")
    assert first["not_checked"] == ["no measured radius on file: diameters were not checked"]
    assert first["distance_to_limit_km"]["p10"] == 8000.0
    assert {line["wheelset"] for line in plan["items"] if line["cause"] == "not_assessed"} == {"WS-010"}
    limited = {"vehicle": "V-2", "nominal_radii": "true", "cut_mm": 3, "vehicle_difference_mm": 5}
    lines = client.get("/v1/plans/reprofiling", params=limited).json()["items"]
    turned = [(one["axle"], one["cause"], one["radius_after_mm"]) for one in lines if one["visit"] == 1]
    assert turned == [(1, "due", 434.5), (2, "due", 434.5), (3, "together", 434.5), (4, "together", 434.5)]
    assert lines[2]["reason"].endswith("because the diameters would differ by 6.0 mm > 5 mm")
    assert client.get("/v1/plans/reprofiling?vehicle=no-such").status_code == 404
    assert client.get("/v1/plans/reprofiling?cut_mm=-1").status_code == 422
    rows = table(client.get("/v1/plans/reprofiling", headers={"Accept": "text/csv"}))
    assert {row["cause"] for row in rows} == {"due", "not_assessed"}
