"""Clients that keep the service waiting: late headers and bodies, unread answers, too many connections."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import httpx
import pytest
from running_service import running

from api import http_server
from api.factory import open_store
from api.serving import create_server
from api.settings import Settings
from fleet_db.migrate import upgrade

HALF = b"GET /v1/fleets HTTP/1.1\r\nHost: localhost\r\nX-Half: "
HALF_BODY = (
    b"POST /v1/jobs/x/runs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 99\r\n\r\n{"
)
KNOWN_REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


@contextmanager
def service(folder: Path, **settings: float) -> Iterator[tuple[str, int]]:
    chosen = Settings.model_validate({"data_dir": folder, "port": 0, "log_level": "warning", **settings})
    folder.mkdir(exist_ok=True)
    upgrade(chosen.url)
    with running(chosen) as url:
        host, port = url.removeprefix("http://").split(":")
        yield host, int(port)


def connect(address: tuple[str, int]) -> socket.socket:
    return socket.create_connection(address, timeout=30)


def all_of(connection: socket.socket) -> bytes:
    """Return what comes until the service closes the connection."""
    try:
        return b"".join(iter(lambda: connection.recv(65536), b""))
    except ConnectionResetError:
        return b""


def answer_of(connection: socket.socket) -> bytes:
    """Return one answer with its JSON; the connection stays open."""
    found = b""
    while not found.endswith(b"}"):
        found += connection.recv(65536)
    return found


def measures(address: tuple[str, int]) -> str:
    return httpx.get("http://{}:{}/metrics".format(*address)).text


def test_late_headers_are_cut_however_slowly_they_trickle(tmp_path: Path) -> None:
    with service(tmp_path, header_timeout_s=1.0, body_timeout_s=20.0) as address:
        with connect(address) as silent, connect(address) as half, connect(address) as used:
            half.sendall(HALF)
            used.sendall(KNOWN_REQUEST)
            assert used.recv(65536).startswith(b"HTTP/1.1 200 ")
            used.sendall(HALF[:5])
            trickled = 0
            half.settimeout(0.05)
            while trickled < 200:
                try:
                    answer = half.recv(65536)
                except TimeoutError:
                    half.sendall(b"x")
                    trickled += 1
                else:
                    break
            assert answer.startswith(b"HTTP/1.1 408 ")
            assert all_of(silent) == b""
            assert b"HTTP/1.1 408 " in all_of(used)
        assert 'treadwatch_http_connections_cut_total{reason="headers-late"} 3.0' in measures(address)


def test_a_late_body_is_a_problem_and_ends_the_connection(tmp_path: Path) -> None:
    with service(tmp_path, header_timeout_s=20.0, body_timeout_s=0.3) as address, connect(address) as connection:
        connection.sendall(HALF_BODY.replace(b"jobs/x/runs", b"alerts/1/acknowledge"))
        answer = all_of(connection)
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b"urn:treadwatch:problem:request-timeout" in answer


def test_a_client_that_does_not_read_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.http_server.SEND_TIMEOUT_S", 0.3)
    with service(tmp_path) as address:
        with socket.socket() as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(address)
            connection.settimeout(30)
            requests = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 100_000
            with pytest.raises((ConnectionResetError, BrokenPipeError)):
                connection.sendall(requests)
        assert 'cut_total{reason="answer-unread"} 1.0' in measures(address)


def test_who_waits_for_longest_makes_room_for_who_comes(tmp_path: Path) -> None:
    with service(tmp_path, max_connections=8) as address, ExitStack() as stack:
        half = [stack.enter_context(connect(address)) for _ in range(30)]
        for connection in half:
            connection.sendall(HALF)
        with connect(address) as comer:
            comer.sendall(KNOWN_REQUEST)
            assert comer.recv(65536).startswith(b"HTTP/1.1 200 ")
        assert all_of(half[0]) == b""
        assert "treadwatch_http_connections 8.0" in measures(address)


def acknowledgement() -> bytes:
    """Return a request that has to write: it waits for whoever writes already."""
    body = b'{"by": "me"}'
    request = HALF_BODY.partition(b"Content-Length")[0].replace(b"jobs/x/runs", b"alerts/1/acknowledge")
    return request + b"If-Match: *\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body)


@contextmanager
def somebody_writes(folder: Path) -> Iterator[None]:
    settings = Settings.model_validate({"data_dir": folder})
    with closing(open_store(settings)) as storage, storage.write():
        yield


def test_a_busy_connection_is_not_displaced(tmp_path: Path) -> None:
    """Its request waits for another writer; connections that have been answered make room for each other."""
    with service(tmp_path, max_connections=2) as address, ExitStack() as stack:
        with somebody_writes(tmp_path):
            busy = stack.enter_context(connect(address))
            busy.sendall(acknowledgement())
            for _ in range(5):
                other = stack.enter_context(connect(address))
                other.sendall(KNOWN_REQUEST)
                assert answer_of(other).startswith(b"HTTP/1.1 200 ")
        assert answer_of(busy).startswith(b"HTTP/1.1 404 ")  # there is no such alert


def test_requests_beyond_those_that_are_being_answered_are_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert http_server.REQUESTS == 100
    monkeypatch.setattr("api.middleware.REQUESTS", 1)
    with service(tmp_path) as address, connect(address) as waiting, connect(address) as half:
        url = "http://{}:{}".format(*address)
        half.sendall(HALF_BODY)  # is not being answered yet
        with somebody_writes(tmp_path):
            waiting.sendall(acknowledgement())
            assert httpx.get(f"{url}/healthz").status_code == 200
            refused = httpx.get(f"{url}/v1/fleets")
            assert (refused.status_code, refused.headers["retry-after"]) == (503, "1")
            assert refused.json()["type"] == "urn:treadwatch:problem:overloaded"
            assert httpx.get(f"{url}/healthz").status_code == 200
        assert answer_of(waiting).startswith(b"HTTP/1.1 404 ")  # there is no such alert
        assert httpx.get(f"{url}/v1/fleets").status_code == 200


def test_an_answer_that_is_late_is_not_waited_for(tmp_path: Path) -> None:
    with service(tmp_path, request_timeout_s=0.3) as address, connect(address) as connection:
        with somebody_writes(tmp_path):
            connection.sendall(acknowledgement())
            answer = answer_of(connection)
            assert answer.startswith(b"HTTP/1.1 503 ")
            assert b"urn:treadwatch:problem:overloaded" in answer
        connection.sendall(KNOWN_REQUEST)
        assert answer_of(connection).startswith(b"HTTP/1.1 200 ")


def test_headers_that_are_too_large_are_refused(tmp_path: Path) -> None:
    with service(tmp_path) as address:
        url = "http://{}:{}/healthz".format(*address)
        assert httpx.get(url, headers={"X": "x" * (http_server.MAX_HEAD_BYTES - 1000)}).status_code == 200
        answer = httpx.get(url, headers={"X": "x" * http_server.MAX_HEAD_BYTES})
        assert answer.status_code == 431
        assert answer.json()["type"] == "urn:treadwatch:problem:headers-too-large"


def test_invented_methods_and_paths_share_a_label(tmp_path: Path) -> None:
    with service(tmp_path) as address, httpx.Client(base_url="http://{}:{}".format(*address)) as client:
        for number in range(50):
            assert client.request(f"INVENTED{number}", "/v1/fleets").status_code == 405
            assert client.request(f"INVENTED{number}", f"/v9/{number}").status_code == 404
        lines = [line for line in measures(address).splitlines() if line.startswith("treadwatch_http_requests_total")]
        assert [line for line in lines if "INVENTED" in line] == []
        assert 'treadwatch_http_requests_total{method="other",route="/v1/fleets",status="405"} 50.0' in lines
        assert 'treadwatch_http_requests_total{method="other",route="unmatched",status="404"} 50.0' in lines


def test_fewer_connections_than_files(monkeypatch: pytest.MonkeyPatch) -> None:
    def limit(_which: int) -> tuple[int, int]:
        return found, found

    monkeypatch.setattr("resource.getrlimit", limit)
    found = 256
    assert http_server.open_connections(1000) == 152
    found = 1024
    assert http_server.open_connections(1000) == 920
    found = 4096
    assert http_server.open_connections(1000) == 1000


def test_the_usual_limits(tmp_path: Path) -> None:
    settings = Settings.model_validate({"data_dir": tmp_path})
    assert (settings.header_timeout_s, settings.body_timeout_s, settings.request_timeout_s) == (10.0, 30.0, 60.0)
    assert (settings.max_connections, http_server.SEND_TIMEOUT_S, http_server.MAX_HEAD_BYTES) == (1000, 30.0, 16384)
    assert (settings.max_body_kb, settings.max_streams) == (1024, 500)


def test_the_server_is_built_with_the_limits_of_the_settings(tmp_path: Path) -> None:
    settings = Settings.model_validate({"data_dir": tmp_path, "port": 0})
    upgrade(settings.url)
    config = create_server(settings).config
    assert config.backlog == http_server.ACCEPTED_AT_ONCE
    assert config.h11_max_incomplete_event_size == http_server.MAX_HEAD_BYTES
