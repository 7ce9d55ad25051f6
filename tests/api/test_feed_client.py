"""``treadwatch feed``: the reference client, against the real service."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import api_fleet
import httpx
import pytest
from running_service import Service
from service_process import COMMAND, ROOT

from api import cursors
from api.feed_client import Follower, Lines, RefusedError, UnreachableError, blocks, read_state, readable
from estimation.errors import InputError


def command(service: Service, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, "feed", "--url", service.url, *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), "TREADWATCH_KEY": "tw_unused"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@contextmanager
def running(service: Service, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Yield the command; one that has not ended by then is killed, so that no test waits for it."""
    with command(service, *arguments) as process:
        try:
            yield process
        finally:
            process.kill()


class StoppedError(Exception):
    """The test has seen enough."""


def lines_of(url: str, cursor: str | None, *query: tuple[str, str], state: Path | None = None) -> list[str]:
    """Return what one call of ``treadwatch feed --json`` prints."""
    output = io.StringIO()
    with httpx.Client(base_url=url) as http:
        Follower(http, query, Lines(as_json=True, state=state, output=output), cursor).once()
    return output.getvalue().splitlines()


def test_the_state_file_goes_on_where_the_last_line_was_printed(service: Service, tmp_path: Path) -> None:
    state = tmp_path / "cursor"
    whole = service.client.get("/v1/alerts/feed?limit=1000").json()["items"]
    done = command(service, "--json", "--state", str(state))
    assert [json.loads(line) for line in done.communicate(timeout=60)[0].splitlines()] == whole
    assert done.returncode == 0
    assert lines_of(service.url, read_state(state), state=state) == []
    alert = api_fleet.raised(service.storage, "WS-015", "hunting")
    news = [json.loads(line) for line in lines_of(service.url, read_state(state), state=state)]
    assert [one["alert"]["id"] for one in news if one["event"] == "raised"] == [alert.alert_id]
    assert lines_of(service.url, None, ("fleet", "=beta")) == [
        line for line in lines_of(service.url, None) if json.loads(line)["alert"]["fleet"] == "=beta"
    ]


def test_follow_prints_what_is_committed_meanwhile_and_ends_on_a_signal(service: Service, tmp_path: Path) -> None:
    state = tmp_path / "cursor"
    arguments = ("--follow", "--after", "latest", "--state", str(state), "--kind", "suspension_change")
    with running(service, *arguments) as following:
        assert following.stdout is not None
        try:
            while not state.exists():
                assert following.poll() is None
            before = state.read_text()
            alert = api_fleet.raised(service.storage, "WS-014", "suspension_change")
            line = following.stdout.readline().split()
            while state.read_text() == before:  # its cursor is kept behind the line
                assert following.poll() is None
        finally:
            following.send_signal(signal.SIGINT)
        assert following.wait(30) == 0
    assert [line[place] for place in (1, 2, -1)] == ["raised", str(alert.alert_id), "WS-014"]
    assert lines_of(service.url, read_state(state), ("kind", "suspension_change")) == []


def test_where_streams_break_it_polls_instead(service: Service) -> None:
    """A proxy that lets no stream through: three tries, then long polls, with nothing missed."""
    tried: list[str] = []
    output = io.StringIO()
    with httpx.HTTPTransport() as real:

        def between(request: httpx.Request) -> httpx.Response:
            tried.append(request.url.path)
            if request.url.path.endswith("/stream"):
                return httpx.Response(200, headers={"content-type": "text/event-stream"}, content=b"")
            if len(tried) > 4:
                raise StoppedError
            return real.handle_request(request)

        with httpx.Client(base_url=service.url, transport=httpx.MockTransport(between)) as http:
            follower = Follower(http, (), Lines(as_json=True, state=None, output=output), None)
            with pytest.raises(StoppedError):
                follower.follow()
    assert tried[:4] == ["/v1/alerts/feed/stream"] * 3 + ["/v1/alerts/feed"]
    printed = [json.loads(line) for line in output.getvalue().splitlines()]
    assert printed == service.client.get("/v1/alerts/feed?limit=1000").json()["items"]


def test_another_history_is_reported_with_what_is_open_now(service: Service) -> None:
    cursor = service.client.get("/v1/alerts/feed?limit=2").json()["next_cursor"]
    key = str(cursors.decode("poll_alert_feed", {}, cursor))
    other = cursors.encode("poll_alert_feed", {}, key.replace(key.split(".")[1], "0" * 32))
    first, *rest = [json.loads(line) for line in lines_of(service.url, other)]
    assert first["event"] == "restored"
    open_now = service.client.get("/v1/alerts?open=true&limit=1000").json()["items"]
    assert first["open_alerts"] == [alert["id"] for alert in open_now]
    assert rest == service.client.get("/v1/alerts/feed?limit=1000").json()["items"]


@pytest.mark.parametrize(
    ("status", "error", "said"),
    [(401, RefusedError, "TREADWATCH_KEY"), (403, RefusedError, "TREADWATCH_KEY"), (503, UnreachableError, "503")],
)
def test_refusals_are_one_clear_line(status: int, error: type[Exception], said: str) -> None:
    transport = httpx.MockTransport(lambda _request: httpx.Response(status, content=b"<html>"))
    with httpx.Client(base_url="http://treadwatch", transport=transport) as http, pytest.raises(error, match=said):
        Follower(http, (), Lines(as_json=True, state=None), None).once()


def test_a_service_that_is_away_and_a_wrong_cursor_end_with_exit_2(service: Service, tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="no cursor of this service"):
        lines_of(service.url, "garbage")
    with pytest.raises(UnreachableError, match=r"127\.0\.0\.1:9"):
        lines_of("http://127.0.0.1:9", None)
    state = tmp_path / "state"
    state.write_text("a line that\nsomebody needs")
    done = command(service, "--state", str(state))
    _, errors = done.communicate(timeout=60)
    assert (done.returncode, errors.count("\n")) == (2, 1)
    assert str(state) in errors
    assert state.read_text() == "a line that\nsomebody needs"


def test_blocks_of_a_stream_are_read_as_the_standard_says() -> None:
    lines = ["retry: 5", ": comment", "", "id: a", "data: 1", "data:2", "", "id: b", "", "id: c", "data: torn"]
    assert [(one.identity, one.data) for one in blocks(lines)] == [(None, None), ("a", "1\n2"), ("b", None)]


def test_a_line_for_people_shows_control_characters_and_sends_none() -> None:
    alert = {"id": 1, "wheelset": None, "fleet": "x\x1b[2J", "severity": "info", "kind": "no_data"}
    event = {"event": "raised", "recorded_at": "2026-01-01T00:00:00Z", "actor": "a\nb", "note": "", "alert": alert}
    assert readable(event).isprintable()
    with pytest.raises(InputError):
        read_state(Path(__file__))
