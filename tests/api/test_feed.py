"""The alert feed: commit order, a cursor always, nothing missed and nothing twice."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import api_fleet
from running_service import Service


def poll(service: Service, after: str | None, limit: int = 1000) -> tuple[list[tuple[int, str]], str]:
    """Return (alert, event) pairs and the next cursor."""
    params = {"limit": str(limit)} | ({} if after is None else {"after": after})
    response = service.client.get("/v1/alerts/feed", params=params)
    assert response.status_code == 200, response.text
    body = response.json()
    assert response.links["next"]["url"] == body["next"]
    return [(item["alert"]["id"], item["event"]) for item in body["items"]], body["next_cursor"]


def test_the_feed_has_a_cursor_even_when_nothing_is_new_and_the_client_owns_it(service: Service) -> None:
    _, end = poll(service, None)
    assert poll(service, end) == ([], end)
    alert = api_fleet.raised(service.storage, "WS-023", "wheel_asymmetry")
    news, after = poll(service, end)
    assert news == [(alert.alert_id, "raised")]
    assert poll(service, end) == (news, after)
    assert poll(service, after) == ([], after)


def test_short_polls_join_to_the_whole_feed(service: Service) -> None:
    whole, _ = poll(service, None)
    assert len(whole) > 10
    joined: list[tuple[int, str]] = []
    cursor: str | None = None
    while True:
        news, cursor = poll(service, cursor, limit=3)
        if not news:
            break
        joined += news
    assert joined == whole


def test_each_event_carries_the_whole_alert_as_it_was(service: Service) -> None:
    item = service.client.get("/v1/alerts/feed?limit=1").json()["items"][0]
    alert = service.client.get(item["alert"]["links"]["self"]).json()
    assert set(item["alert"]) == set(alert)
    assert item["recorded_at"] == "2025-07-25T15:06:40.123456789Z"


def test_a_cursor_of_a_list_is_none_of_the_feed(service: Service) -> None:
    cursor = service.client.get("/v1/alerts?limit=1").json()["next_cursor"]
    assert service.client.get("/v1/alerts/feed", params={"after": cursor}).status_code == 400
    assert service.client.get("/v1/alerts/feed", params={"after": "garbage"}).status_code == 400
    assert service.client.get("/v1/alerts/feed?limit=0").status_code == 422


def test_a_client_that_polls_while_many_write_misses_nothing(service: Service) -> None:
    _, cursor = poll(service, None)
    written: list[tuple[int, str]] = []
    lock = threading.Lock()

    def write(number: int) -> None:
        for _ in range(8):
            alert = api_fleet.raised(service.storage, api_fleet.WHEELSETS[number + 1], "limit_forecast")
            path = f"/v1/alerts/{alert.alert_id}"
            body = {"by": f"writer {number}"}
            done = service.client.post(f"{path}/acknowledge", json=body, headers={"If-Match": "*"})
            assert done.status_code == 200
            with lock:
                written.extend([(alert.alert_id, "raised"), (alert.alert_id, "acknowledged")])

    polled: list[tuple[int, str]] = []
    with ThreadPoolExecutor(4) as pool:
        writers = [pool.submit(write, number) for number in range(4)]
        while not all(writer.done() for writer in writers):
            news, cursor = poll(service, cursor, limit=5)
            polled += news
        for writer in writers:
            writer.result()
    while True:
        news, cursor = poll(service, cursor)
        if not news:
            break
        polled += news
    assert len(polled) == len(set(polled))
    assert set(written) <= set(polled)
    assert {pair for pair in polled if pair[1] != "closed"} == set(written)
