"""A writer that is stuck: requests that read are answered, those that write wait a moment and are refused."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import httpx
import pytest
from running_service import running

from api.services import MOST_WAITING, WriterSlots
from api.settings import Settings
from estimation.errors import BusyError
from estimation.values.runs import JobTrigger
from fleet_db.locks import single_writer

LONG_S = 120.0
POST, READS = "/v1/jobs/refresh_trends/runs", ("/v1/fleets", "/v1/vehicles", "/readyz", "/v1/jobs", "/healthz")


@pytest.fixture
def settings(sqlite_url: str, tmp_path: Path) -> Settings:
    return Settings(database_url=sqlite_url, data_dir=tmp_path / "data", port=0)


@contextmanager
def stuck_writer(settings: Settings) -> Iterator[Event]:
    """Hold the database as a writer that hangs does, until the event is set."""
    held, let_go = Event(), Event()
    file = Path(settings.url.removeprefix("sqlite:///"))

    def hold() -> None:
        with single_writer(file.with_name(f"{file.name}.writer-lock"), LONG_S):
            held.set()
            let_go.wait(LONG_S)

    thread = Thread(target=hold)
    thread.start()
    assert held.wait(LONG_S)
    try:
        yield let_go
    finally:
        let_go.set()
        thread.join(LONG_S)


def test_reads_are_answered_while_writers_wait_for_a_stuck_one(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.services.PATIENCE_S", LONG_S)
    with running(settings) as url, stuck_writer(settings) as let_go, ThreadPoolExecutor(3) as pool:
        posts = [pool.submit(httpx.post, url + POST, timeout=LONG_S) for _ in range(3)]
        for _ in range(4):
            assert [httpx.get(url + path, timeout=LONG_S / 4).status_code for path in READS] == [200] * len(READS)
        assert not any(post.done() for post in posts)
        let_go.set()
        assert min(post.result(LONG_S).status_code for post in posts) == 202


def test_a_request_that_cannot_write_in_time_gets_a_time_to_come_back(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.services.PATIENCE_S", 0.05)
    with running(settings) as url, stuck_writer(settings) as let_go:
        answer = httpx.post(url + POST, timeout=LONG_S)
        assert (answer.status_code, answer.headers["Retry-After"]) == (503, "2")
        assert answer.json()["detail"] == "the database is being written to; nothing was changed, try again"
        let_go.set()
    with running(settings) as url:
        assert httpx.get(f"{url}/v1/jobs/refresh_trends/runs").json()["items"] == []
        run = httpx.post(url + POST, timeout=LONG_S)
        assert (run.status_code, run.json()["trigger"]) == (202, JobTrigger.API)


def test_only_so_many_requests_wait() -> None:
    async def one(slots: WriterSlots, go_on: asyncio.Event) -> bool:
        try:
            async with slots.slot():
                await go_on.wait()
        except BusyError:
            return False
        return True

    async def crowd(more: int) -> list[bool]:
        slots, go_on = WriterSlots(1, LONG_S), asyncio.Event()
        requests = [asyncio.create_task(one(slots, go_on)) for _ in range(1 + MOST_WAITING + more)]
        await asyncio.sleep(0)  # each has come as far as it can
        go_on.set()
        return await asyncio.gather(*requests)

    assert asyncio.run(crowd(0)).count(False) == 0
    assert asyncio.run(crowd(3)).count(False) == 3
