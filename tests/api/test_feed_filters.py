"""Filters of the feed, and cursors that belong to one filter and to one caller's fleets."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import api_fleet
import pytest
from running_service import Service

from api import cursors
from api.feed.pages import FeedFilter, opened, read_page
from estimation.values.alerts import Alert, AlertEventKind, Severity
from fleet_db.storage import SqlStorage

FEED = "/v1/alerts/feed"
WHOLE = partial(read_page, limit=1000)


def ask(service: Service, *pairs: tuple[str, str]) -> Any:  # noqa: ANN401 - JSON
    response = service.client.get(FEED, params=[*pairs])
    assert response.status_code == 200, response.text
    return response.json()


def changed(storage: SqlStorage, alert: Alert, severity: Severity, kind: AlertEventKind) -> Alert:
    with storage.write() as unit:
        return unit.alerts.save(replace(alert, severity=severity), [kind], api_fleet.RECORDED)


def test_filters_take_several_values_and_the_whole_feed_is_their_sum(service: Service) -> None:
    whole = ask(service, ("limit", "1000"))["items"]
    fleets = {item["alert"]["fleet"] for item in whole}
    assert fleets == {"alpha", "=beta"}
    for fleet in fleets:
        found = ask(service, ("limit", "1000"), ("fleet", fleet))["items"]
        assert found == [item for item in whole if item["alert"]["fleet"] == fleet]
    both = [("fleet", fleet) for fleet in fleets]
    assert ask(service, ("limit", "1000"), *both)["items"] == whole
    found = ask(service, ("limit", "1000"), ("kind", "no_data"), ("kind", "wheel_asymmetry"))["items"]
    assert found == [item for item in whole if item["alert"]["kind"] in {"no_data", "wheel_asymmetry"}]
    assert found


def test_an_alert_is_followed_to_its_end_once_it_has_had_the_severity(service: Service) -> None:
    cursor = ask(service, ("after", "latest"), ("severity", "critical"))["next_cursor"]
    alert = api_fleet.raised(service.storage, "WS-019", "hunting", "=beta")
    steps = [
        (Severity.WARNING, AlertEventKind.UPDATED),
        (Severity.CRITICAL, AlertEventKind.UPDATED),
        (Severity.WARNING, AlertEventKind.UPDATED),
        (Severity.WARNING, AlertEventKind.CLEARED),
    ]
    alert = changed(service.storage, alert, Severity.INFO, AlertEventKind.UPDATED)
    for severity, kind in steps:
        alert = changed(service.storage, alert, severity, kind)
    news = ask(service, ("after", cursor), ("severity", "critical"))["items"]
    mine = [item for item in news if item["alert"]["id"] == alert.alert_id]
    assert [(item["alert"]["severity"], item["event"]) for item in mine] == [
        ("critical", "updated"),
        ("warning", "updated"),
        ("warning", "cleared"),
    ]


def test_a_cursor_belongs_to_its_filter_in_any_order_of_its_values(service: Service) -> None:
    pairs = [("fleet", "alpha"), ("severity", "warning"), ("severity", "critical")]
    cursor = ask(service, *pairs, ("limit", "1000"))["next_cursor"]
    assert ask(service, *reversed(pairs), ("after", cursor), ("limit", "7"))["items"] == []
    for other in ([], pairs[:1], [*pairs, ("kind", "hunting")], [("fleet", "=beta"), *pairs[1:]]):
        response = service.client.get(FEED, params=[*other, ("after", cursor)])
        assert response.status_code == 400, response.text
        assert response.json()["type"] == "urn:treadwatch:problem:invalid-cursor"
    whole = ask(service)["next_cursor"]
    assert service.client.get(FEED, params=[("fleet", "alpha"), ("after", whole)]).status_code == 400


def test_a_filtered_poll_moves_on_where_nothing_matches(service: Service) -> None:
    cursor = ask(service, ("kind", "suspension_change"))["next_cursor"]
    api_fleet.raised(service.storage, "WS-021", "wheel_asymmetry")
    after = ask(service, ("kind", "suspension_change"), ("after", cursor))
    assert after["items"] == []
    assert after["next_cursor"] != cursor
    assert ask(service, ("kind", "suspension_change"), ("after", cursor))["next_cursor"] == after["next_cursor"]


def test_latest_begins_behind_the_newest_event(service: Service) -> None:
    page = ask(service, ("after", "latest"))
    assert page["items"] == []
    alert = api_fleet.raised(service.storage, "WS-022", "hunting")
    news = ask(service, ("after", page["next_cursor"]))["items"]
    assert [item["alert"]["id"] for item in news if item["event"] == "raised"] == [alert.alert_id]


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("fleet=nobody", 404),
        ("kind=nothing", 422),
        ("severity=bad", 422),
        ("fleet=", 422),
        ("wait_s=61", 422),
        ("wait_s=-1", 422),
        ("wait_s=nan", 422),
        ("after=a&after=b", 422),
        ("after=W10", 400),
        ("&".join("severity=info" for _ in range(51)), 422),
    ],
)
def test_what_names_nothing_is_refused(service: Service, query: str, status: int) -> None:
    assert service.client.get(f"{FEED}?{query}").status_code == status


def test_edited_cursors_are_refused_or_end_where_they_say(service: Service) -> None:
    """A client that changes the number in its cursor gets 409: the check in it is of another event."""
    cursor = ask(service, ("limit", "3"))["next_cursor"]
    key = cursors.decode("poll_alert_feed", {}, cursor)
    assert isinstance(key, str)
    sequence, identity, check = key.split(".")
    for edited, status in (
        (f"{int(sequence) + 1}.{identity}.{check}", 409),
        (f"{sequence}.{identity[::-1]}.{check}", 409),
        (f"{sequence}.{identity}.00000000", 409),
        (f"{sequence}.{identity}", 400),
        (f"-1.{identity}.{check}", 400),
        (f"{10**18}.{identity}.{check}", 409),
        (f"{10**19}.{identity}.{check}", 400),
    ):
        given = cursors.encode("poll_alert_feed", {}, edited)
        response = service.client.get(FEED, params={"after": given})
        assert response.status_code == status, edited
        assert response.headers["content-type"] == "application/problem+json"


def test_a_bound_caller_gets_its_fleets_alone_and_no_other_callers_cursor(service: Service) -> None:
    everything = opened(service.storage, FeedFilter(), FEED, None, WHOLE)
    bound = service.storage.seen_by(frozenset({"alpha"}))
    mine = FeedFilter(visible=frozenset({"alpha"}))
    page = opened(bound, mine, FEED, None, WHOLE)
    assert [event for event, _ in page.events] == [e for e, _ in everything.events if e.alert.fleet == "alpha"]
    assert opened(bound, mine, FEED, page.end.cursor, WHOLE).events == []
    critical = FeedFilter(severities=frozenset({"critical", "warning"}), visible=frozenset({"alpha"}))
    assert {event.alert.fleet for event, _ in opened(bound, critical, FEED, None, WHOLE).events} == {"alpha"}
    for narrowed, cursor in ((mine, everything.end.cursor), (FeedFilter(), page.end.cursor)):
        with pytest.raises(Exception, match="another filter"):
            opened(bound, narrowed, FEED, cursor, WHOLE)
