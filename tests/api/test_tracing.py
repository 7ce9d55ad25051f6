"""Traces: sent to a real collector where one is named, nothing otherwise, and never waited for."""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from google.protobuf.json_format import MessageToDict
from in_process_command import Run
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from service_process import service_process

from api import logs
from estimation.errors import ParameterError
from fleet_db.migrate import upgrade

PATIENCE_S = 30.0
ENDPOINT = "OTEL_EXPORTER_OTLP_ENDPOINT"


class Collector:
    """What was sent: each span under its name, and the attributes of their resource."""

    def __init__(self) -> None:
        self.spans: dict[str, dict[str, object]] = {}
        self.resource: dict[str, object] = {}

    def take(self, body: bytes) -> None:
        for group in MessageToDict(ExportTraceServiceRequest.FromString(body))["resourceSpans"]:
            self.resource = _attributes(group["resource"])
            for scope in group["scopeSpans"]:
                for span in scope["spans"]:
                    self.spans[span["name"]] = {**_attributes(span), "trace": span["traceId"]}

    def waited_for(self, name: str) -> dict[str, object]:
        until = time.monotonic() + PATIENCE_S
        while name not in self.spans:
            assert time.monotonic() < until, sorted(self.spans)
            time.sleep(0.05)
        return self.spans[name]


def _attributes(of: dict[str, list[dict[str, object]]]) -> dict[str, object]:
    found = {}
    for one in of.get("attributes", []):
        value = one["value"]
        assert isinstance(value, dict)
        found[str(one["key"])] = next(iter(value.values()))
    return found


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    """Yield a collector that the environment names."""
    found = Collector()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            found.take(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with environment(monkeypatch, server.server_address[1]):
            yield found
        server.shutdown()


@contextmanager
def environment(monkeypatch: pytest.MonkeyPatch, port: int) -> Iterator[None]:
    monkeypatch.setenv(ENDPOINT, f"http://127.0.0.1:{port}")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_COMPRESSION", "none")
    monkeypatch.setenv("OTEL_BSP_SCHEDULE_DELAY", "100")
    yield


def _migrated(folder: Path) -> Path:
    (folder / "data").mkdir()
    upgrade(f"sqlite:///{folder / 'data' / 'treadwatch.sqlite'}")
    return folder


@pytest.mark.slow
def test_requests_and_jobs_are_spans_and_the_log_names_their_trace(collector: Collector, tmp_path: Path) -> None:
    with service_process(_migrated(tmp_path), log_level="info", LOG_FORMAT="json") as service:
        secret = {"Authorization": "Bearer tw_secret"}
        assert httpx.get(f"{service.url}/v1/wheelsets/WS-1", headers=secret).status_code == 404
        assert httpx.post(f"{service.url}/v1/jobs/evaluate_alerts/runs").status_code == 202
        span = collector.waited_for("GET /v1/wheelsets/{serial}")
        assert span["http.route"] == "/v1/wheelsets/{serial}"
        assert span["http.response.status_code"] == "404"
        collector.waited_for("job evaluate_alerts")
        assert collector.resource["service.name"] == "treadwatch"
        assert "tw_secret" not in json.dumps(collector.spans)
        httpx.get(f"{service.url}/v1/alerts/feed?wait_s=0.1")
        httpx.get(f"{service.url}/v1/fleets")
        collector.waited_for("GET /v1/fleets")
    lines = [json.loads(line) for line in service.log.splitlines() if line.startswith("{")]
    (line,) = (one for one in lines if one.get("path") == "/v1/wheelsets/WS-1")
    assert len(line["trace_id"]) == 32
    assert not any("/feed" in name for name in collector.spans)  # it lasts for as long as nothing happens


@pytest.mark.slow
def test_a_collector_that_is_away_is_reported_once_and_not_waited_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with environment(monkeypatch, port), service_process(_migrated(tmp_path)) as service:
        for _ in range(40):
            assert httpx.get(f"{service.url}/v1/fleets").status_code == 200
            time.sleep(0.05)
    assert 1 <= service.log.count("trace_exporter") <= 4, service.log
    assert service.process.returncode == 0


def test_nothing_is_started_where_nobody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ENDPOINT, raising=False)
    assert logs.start_tracing() is False
    for switch, value in (("OTEL_SDK_DISABLED", "true"), ("OTEL_TRACES_EXPORTER", "none")):
        with monkeypatch.context() as patch:
            patch.setenv(ENDPOINT, "http://127.0.0.1:4318")
            patch.setenv(switch, value)
            assert logs.start_tracing() is False


def test_without_the_extra_it_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch, treadwatch: Run) -> None:
    monkeypatch.setenv(ENDPOINT, "http://127.0.0.1:4318")
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(ParameterError, match=r"treadwatch\[otel\]"):
        logs.start_tracing()
    done = treadwatch("serve", "--port", "0")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert ENDPOINT in done.stderr
