"""A database that is away: quick refusals, a short log, no password in it, and all is well when it is back."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import psycopg
import pytest
from in_process_command import Run
from postgres_server import PostgresServer, stoppable_server
from service_process import COMMAND, ROOT, service_process, wait_for

from estimation.errors import ParameterError
from fleet_db.migrate import upgrade
from fleet_db.session import RETRY_S, Reachability, database_engine

PASSWORD = "S3same-öffne%dich"  # noqa: S105 - of a server that asks for none
QUOTED = "S3same-%C3%B6ffne%25dich"
REQUESTS = 60


def without_password(text: str) -> bool:
    return all(form not in text for form in (PASSWORD, QUOTED, json.dumps(PASSWORD)[1:-1], "S3same"))


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with stoppable_server() as server:
        upgrade(server.url)
        yield server


def with_password(server: PostgresServer) -> str:
    return server.url.replace("postgres@", f"postgres:{QUOTED}@")


@pytest.mark.slow
def test_requests_are_refused_quickly_and_logged_once(server: PostgresServer, tmp_path: Path) -> None:
    with (
        service_process(tmp_path, with_password(server), LOG_FORMAT="json") as service,
        httpx.Client(base_url=service.url, timeout=30.0) as client,
    ):
        assert client.get("/v1/fleets").status_code == 200
        server.stop()
        try:
            for _ in range(REQUESTS):
                response = client.get("/v1/fleets")
                assert response.status_code == 503
                assert response.json()["type"] == "urn:treadwatch:problem:not-ready"
                assert response.headers["retry-after"]
            assert client.get("/readyz").status_code == 503
            assert client.get("/healthz").status_code == 200
            assert "treadwatch_database_up 0.0" in client.get("/metrics").text
            while_away = "".join(
                line for line in service.log.splitlines(keepends=True) if "treadwatch.access" not in line
            )
        finally:
            server.start()
        eventually_ready(client)
        assert client.get("/v1/fleets").status_code == 200
    assert without_password(service.log)
    assert len(while_away) < 32_000
    assert while_away.count("request failed") <= 3  # each way to fail once: on a connection, at connecting
    assert re.search(r"again \d\d times in \d+ s: StorageError", service.log)


@contextmanager
def scheduler_process(server: PostgresServer, folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Run a scheduler; yield it and its log."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "TREADWATCH_DATA_DIR": str(folder),
        "TREADWATCH_DATABASE_URL": with_password(server),
        "TREADWATCH_JOBS_EVERY_S": "0.2",
        "TREADWATCH_LEASE_S": "2",
    }
    log = folder / "scheduler.log"
    with log.open("wb") as written:
        process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "schedule", "--wait"], env=environment, stderr=written
        )
    try:
        yield process, log
    finally:
        process.terminate()
        process.wait(60)


@pytest.mark.slow
def test_the_scheduler_leaves_no_password_either(server: PostgresServer, tmp_path: Path) -> None:
    try:
        with scheduler_process(server, tmp_path) as (_, log):
            wait_for("scheduler", log)
            server.stop()
            wait_for("failed", log)
    finally:
        server.start()
    assert without_password(log.read_text())


WAITS = "the start waits for the database"


@pytest.mark.slow
def test_a_service_that_starts_while_the_database_is_away_waits_for_it(server: PostgresServer, tmp_path: Path) -> None:
    server.stop()
    try:
        with (
            scheduler_process(server, tmp_path) as (_, log),
            service_process(tmp_path, with_password(server)) as service,
        ):
            wait_for(WAITS, log)
            wait_for(WAITS, service.file)
            with httpx.Client(base_url=service.url, timeout=30.0) as client:
                assert client.get("/healthz").status_code == 200
                assert "treadwatch_database_up 0.0" in client.get("/metrics").text
                for refused in map(client.get, ("/readyz", "/v1/fleets", "/nothing")):
                    assert refused.status_code == 503
                    assert refused.headers["content-type"] == "application/problem+json"
                    assert refused.json()["reason_code"] == "waits_for_database"
                    assert refused.headers["retry-after"]
                server.start()
                wait_for("the database answers", service.file)
                eventually_ready(client)
                assert client.get("/v1/fleets").status_code == 200
                assert "treadwatch_database_up 1.0" in client.get("/metrics").text
            wait_for("scheduler started with", log)
    finally:
        if server.process is None:
            server.start()
    for text in (service.log, log.read_text()):
        assert text.count(WAITS) == text.count("the database answers") == 1
        assert without_password(text)


@pytest.mark.slow
def test_a_service_that_waits_ends_on_a_signal(server: PostgresServer, tmp_path: Path) -> None:
    server.stop()
    try:
        with service_process(tmp_path, with_password(server)) as service:
            wait_for(WAITS, service.file)
            service.process.terminate()
            assert service.process.wait(120) in (0, -signal.SIGTERM)
    finally:
        server.start()


@pytest.mark.slow
def test_a_database_that_answers_and_cannot_be_used_ends_the_service(server: PostgresServer, tmp_path: Path) -> None:
    with psycopg.connect(server.url, autocommit=True) as connection:
        connection.execute("CREATE DATABASE empty")
    server.stop()
    try:
        with service_process(tmp_path, server.url.replace("/postgres?", "/empty?")) as service:
            wait_for(WAITS, service.file)
            server.start()
            assert service.process.wait(120) == 2
    finally:
        if server.process is None:
            server.start()
    assert "treadwatch db upgrade" in service.log.splitlines()[-1]


def eventually_ready(client: httpx.Client) -> None:
    for _ in range(200):
        if client.get("/readyz").status_code == 200:
            return
        time.sleep(0.05)
    pytest.fail("never ready")


@pytest.mark.parametrize("arguments", [("ingest", "--registry", "none.json"), ("estimate",), ("db", "check")])
def test_a_command_refuses_without_the_password(
    treadwatch: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", f"postgresql://me:{QUOTED}@/db?host={tmp_path}")
    done = treadwatch(*arguments)
    assert done.returncode == 2
    assert "the database failed" in done.stderr
    assert without_password(done.stderr)


@pytest.mark.parametrize(
    "address",
    [
        "me:S3same@öffne@host/db",
        "me:S3same-öffne@host:S3same/db",
        "me:S3same@host:x/db",
        "me:S3same",
        "me:a@S3same/b@host/db",
    ],
)
def test_an_address_that_cannot_be_used_is_not_repeated(address: str) -> None:
    with pytest.raises(ParameterError) as refused:
        database_engine(f"postgresql://{address}").connect()
    assert refused.value.field == "database_url"
    assert without_password(f"{refused.value}")
    assert refused.value.__cause__ is None


def test_one_caller_at_a_time_waits_for_a_database_that_is_away() -> None:
    now_s = [100.0]
    reachability = Reachability(clock=lambda: now_s[0])
    assert reachability.refusal() is None
    assert reachability.refusal() is None  # all may try until one has failed
    reachability.failed("refused")
    assert reachability.refusal() == "refused"
    now_s[0] += RETRY_S
    assert reachability.refusal() is None
    assert reachability.refusal() == "refused"  # one is trying
    reachability.failed("refused again")
    assert reachability.refusal() == "refused again"
    now_s[0] += RETRY_S
    assert reachability.refusal() is None
    reachability.succeeded()
    assert reachability.refusal() is None
    assert reachability.refusal() is None
