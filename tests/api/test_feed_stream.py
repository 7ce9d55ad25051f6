"""Long polls and streams: news of any process at once, and no thread or connection of those who wait."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import api_fleet
import httpx
import populated_fleet
import pytest
from running_service import Service, running
from sqlalchemy import text

from api import middleware
from api.factory import open_store
from api.feed import watch as feed_watch
from api.settings import Settings
from estimation.values.alerts import Alert
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage

FEED = "/v1/alerts/feed"
STREAM = f"{FEED}/stream"


def latest(url: str) -> str:
    cursor: str = httpx.get(f"{url}{FEED}", params={"after": "latest"}).json()["next_cursor"]
    return cursor


def blocks(response: httpx.Response) -> Iterator[dict[str, str]]:
    """Yield the blocks of a stream, each field under its name; a comment under ''."""
    block: dict[str, str] = {}
    for line in response.iter_lines():
        if line:
            name, _, value = line.partition(":")
            block[name] = value.removeprefix(" ")
        elif block:
            yield block
            block = {}


def events(response: httpx.Response) -> Iterator[tuple[str, Any]]:
    """Yield the cursor and the body of each event of a stream."""
    return ((block["id"], json.loads(block["data"])) for block in blocks(response) if "data" in block)


@contextmanager
def streaming(url: str, **given: Any) -> Iterator[httpx.Response]:  # noqa: ANN401 - parameters of httpx
    with httpx.stream("GET", f"{url}{STREAM}", timeout=30, **given) as response:
        yield response


def raise_alert(service: Service, wheelset: str = "WS-018", kind: str = "hunting") -> Alert:
    return api_fleet.raised(service.storage, wheelset, kind)


def test_a_long_poll_answers_when_another_connection_commits(service: Service) -> None:
    cursor = latest(service.url)
    with ThreadPoolExecutor(1) as pool:
        params = {"after": cursor, "wait_s": "30", "fleet": "alpha"}
        cursor = service.client.get(FEED, params={"after": "latest", "fleet": "alpha"}).json()["next_cursor"]
        polled = pool.submit(httpx.get, f"{service.url}{FEED}", params=params | {"after": cursor}, timeout=60)
        time.sleep(0.3)
        api_fleet.raised(service.storage, "WS-017", "hunting", "=beta")  # of no interest
        alert = raise_alert(service)
        page = polled.result().json()
    assert alert.alert_id in [item["alert"]["id"] for item in page["items"]]
    assert {item["alert"]["fleet"] for item in page["items"]} == {"alpha"}


def test_a_long_poll_without_news_ends_with_its_cursor(service: Service) -> None:
    cursor = latest(service.url)
    page = service.client.get(FEED, params={"after": cursor, "wait_s": "0.3"}).json()
    assert (page["items"], page["next_cursor"]) == ([], cursor)
    assert "wait_s=0.3" in page["next"]


def _until_they_wait(url: str, count: int) -> None:
    until = time.monotonic() + 30
    while f'how="long_poll"}} {count}.0' not in httpx.get(f"{url}/metrics").text:
        assert time.monotonic() < until
        time.sleep(0.02)


def test_those_who_wait_are_not_among_the_requests_that_are_answered(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More long polls than may be answered at once, and the service answers still."""
    monkeypatch.setattr(middleware, "REQUESTS", 2)
    cursor = latest(service.url)
    params = {"after": cursor, "wait_s": "30"}
    with ThreadPoolExecutor(4) as pool:
        polls = []
        for waiting in range(1, 5):
            polls.append(pool.submit(httpx.get, f"{service.url}{FEED}", params=params, timeout=60))
            _until_they_wait(service.url, waiting)
        assert service.client.get("/v1/fleets").status_code == 200
        alert = raise_alert(service)
        pages = [poll.result().json() for poll in polls]
    assert all(alert.alert_id in [item["alert"]["id"] for item in page["items"]] for page in pages)


def test_a_stream_is_the_feed_and_its_ids_are_cursors(service: Service) -> None:
    whole = service.client.get(FEED, params={"limit": "1000"}).json()["items"]
    with streaming(service.url) as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        found = events(response)
        received = [next(found) for _ in whole]
        assert [body for _, body in received] == whole
        alert = raise_alert(service)
        news = [next(found)]
        while news[-1][1]["event"] != "raised":
            news.append(next(found))
    assert news[-1][1]["alert"]["id"] == alert.alert_id
    middle = received[3][0]
    assert service.client.get(FEED, params={"after": middle, "limit": "2"}).json()["items"] == whole[4:6]
    for given in ({"params": {"after": middle}}, {"headers": {"Last-Event-ID": middle}, "params": {"after": "latest"}}):
        with streaming(service.url, **given) as response:
            assert next(events(response))[1] == whole[4]


def test_a_stream_has_the_filter_of_its_cursor(service: Service) -> None:
    with streaming(service.url, params={"fleet": "=beta", "after": "latest"}) as response:
        first = next(blocks(response))
        assert first["retry"] == "2000"
    cursor = service.client.get(FEED, params={"fleet": "=beta", "limit": "1"}).json()["next_cursor"]
    with streaming(service.url, params={"after": cursor}) as response:
        assert response.status_code == 400


def test_a_stream_shows_that_it_lives_and_moves_its_cursor_on(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_watch, "HEARTBEAT_S", 0.3)
    with streaming(service.url, params={"kind": "suspension_change", "after": "latest"}) as response:
        found = blocks(response)
        while (before := next(found))[""] != "still here":
            pass
        raise_alert(service, "WS-016")
        ids = {next(found)["id"] for _ in range(4)}
    assert ids - {before["id"]}
    for cursor in ids:
        params = {"kind": "suspension_change", "after": cursor}
        assert service.client.get(FEED, params=params).json()["items"] == []


def test_head_of_a_stream_ends(service: Service) -> None:
    response = service.client.head(STREAM)
    assert (response.status_code, response.content) == (200, b"")
    assert service.client.get(STREAM, headers={"Accept": "application/json"}).status_code == 406


def settings_of(folder: Path, **more: object) -> Settings:
    return Settings.model_validate({"data_dir": folder, "port": 0, "log_level": "warning", **more})


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[SqlStorage]:
    """Yield a database for servers of a test's own."""
    upgrade(settings_of(tmp_path).url)
    storage = open_store(settings_of(tmp_path))
    populated_fleet.populate(storage)
    yield storage
    storage.close()


def test_streams_have_a_limit_and_give_their_places_back(alone: SqlStorage, tmp_path: Path) -> None:
    with running(settings_of(tmp_path, max_streams=2)) as url, ExitStack() as stack:
        with ExitStack() as two:
            held = [blocks(two.enter_context(streaming(url))) for _ in range(2)]  # closed with their generators
            assert all(next(one) for one in held)
            refused = httpx.get(f"{url}{STREAM}")
            assert refused.status_code == 503
            assert "max_streams" in refused.json()["detail"]
            assert refused.headers["retry-after"] == "10"
            assert httpx.get(f"{url}{FEED}", params={"after": latest(url), "wait_s": "1"}).status_code == 503
        until = time.monotonic() + 30
        while (response := stack.enter_context(streaming(url))).status_code == 503:
            assert time.monotonic() < until
        next(blocks(response))
    assert alone


def test_the_end_of_the_service_ends_streams_and_long_polls_at_once(alone: SqlStorage, tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool, ExitStack() as stack:
        with running(settings_of(tmp_path, shutdown_timeout_s=600)) as url:
            response = stack.enter_context(streaming(url))
            found = blocks(response)
            next(found)
            params = {"after": latest(url), "wait_s": "60"}
            whole = httpx.get(f"{url}{FEED}").json()["items"]
            polled = pool.submit(httpx.get, f"{url}{FEED}", params=params, timeout=90)
            _until_they_wait(url, 1)
        assert [json.loads(block["data"]) for block in found if "data" in block] == whole  # ended without an error
        assert polled.result().json()["items"] == []
    assert alone


def test_a_stream_of_another_history_is_refused_and_one_that_goes_on_ends(alone: SqlStorage, tmp_path: Path) -> None:
    with running(settings_of(tmp_path)) as url:
        cursor = latest(url)
        with streaming(url, params={"after": cursor}) as response:
            found = blocks(response)
            assert "id" in [next(found), next(found)][1]
            with alone.write() as unit:  # as after a restore from an older backup
                newest = unit.feed_branches.newest_sequence()
                unit.connection.execute(text("DELETE FROM alert_events WHERE sequence = :newest"), {"newest": newest})
            assert list(found) == []
        with streaming(url, params={"after": cursor}) as response:
            assert response.status_code == 409
            assert json.loads(response.read())["next"] == STREAM


def test_a_client_far_behind_reads_the_database_and_misses_nothing(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_watch, "KEPT", 3)
    monkeypatch.setattr(feed_watch, "CATCH_UP", 4)
    alerts: list[int] = []
    with streaming(service.url, params={"after": "latest"}) as response:
        found = events(response)
        writer = threading.Thread(
            target=lambda: alerts.extend(raise_alert(service, f"WS-{n:03d}").alert_id for n in range(12))
        )
        writer.start()
        writer.join()
        received = [next(found)[1] for _ in range(12)]
        while len([one for one in received if one["event"] == "raised"]) < 12:
            received.append(next(found)[1])
    assert [one["alert"]["id"] for one in received if one["event"] == "raised"] == alerts
