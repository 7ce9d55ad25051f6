"""Processes that are killed with SIGKILL at random moments while recordings come in."""

from __future__ import annotations

import os
import random
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import httpx

from api import logs
from api.factory import open_store, process_name
from api.pipeline import job_context, scheduled_jobs
from api.serving import create_server
from api.settings import Settings
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import (
    Databases,
    compared,
    databases,
    estimate,
    fork,
    ingest,
    recordings,
    wait_for,
)
from bench.report import BenchRow
from bench.services import free_port
from estimation.jobs.scheduler import serve_jobs

SECONDS = 45.0
PIECES = 8
LEASE_S = 1.0
KILLS_A_ROUND = 10
LONGEST_LIFE_S = 0.8
RECOVERY_S = 5.0


@dataclass
class Tally:
    """What the rounds on one database came to."""

    kills: int = 0
    wrong: list[str] = field(default_factory=list)
    recoveries_s: list[float] = field(default_factory=list)


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield for each database what was lost, doubled, torn or orphaned, and the longest recovery."""
    rng = random.Random(settings.seed)  # noqa: S311 - drawn moments, not secrets
    with databases(settings.folder) as both:
        for kind in ("sqlite", "postgresql"):
            tally = Tally()
            while tally.kills < settings.size // 2:
                _round(both, kind, rng, tally, min(KILLS_A_ROUND, settings.size // 2 - tally.kills))
            wrong = tally.wrong
            yield BenchRow(
                f"{tally.kills} kills of ingest, estimate, schedule and serve, {kind}: lost, doubled, torn, orphaned",
                f"{len(wrong)} {', '.join(sorted(set(wrong)))[:300]}".strip(),
                "0",
                not wrong,
            )
            worst = max(tally.recoveries_s)
            yield BenchRow(
                f"longest time after a kill until another process has written, {kind}",
                f"{worst:.2f} s",
                f"< {RECOVERY_S:g} s",
                worst < RECOVERY_S,
            )


def _round(both: Databases, kind: str, rng: random.Random, tally: Tally, kills: int) -> None:
    """Kill processes of one deployment, let it come to rest, and compare it with one that was left alone."""
    folder = both.folder / "recordings"
    paths = recordings(folder, [rng.random() for _ in range(PIECES - 1)], SECONDS)
    broken, alone = (both.new(kind).model_copy(update={"lease_s": LEASE_S}) for _ in range(2))
    log = both.folder / "kills.log"
    for _ in range(kills):
        some = rng.sample(paths, 2)
        works: tuple[Callable[[], object], ...] = (
            partial(ingest, broken, some),
            partial(estimate, broken),
            partial(schedule, broken),
            partial(serve, broken, some),
        )
        pid = fork(rng.choice(works), log)
        time.sleep(rng.random() * LONGEST_LIFE_S)
        os.kill(pid, signal.SIGKILL)
        wait_for([pid])
        tally.kills += 1
        tally.recoveries_s.append(_until_written(broken))
    time.sleep(2.0 * LEASE_S)  # what a killed process ran is abandoned once its lease has ended
    tally.wrong += compared(both, broken, alone, paths)
    shutil.rmtree(folder)


def schedule(settings: Settings, every_s: float = 0.2) -> None:
    """Run the jobs on schedule until the process ends, each every ``every_s`` seconds."""
    logs.configure(settings)
    with closing(open_store(settings)) as storage:
        jobs = [replace(job, every_s=every_s) for job in scheduled_jobs(settings)]
        serve_jobs(job_context(settings, storage), jobs, threading.Event(), holder=process_name())


def serve(settings: Settings, paths: Sequence[Path]) -> None:
    """Serve, and run a job that is asked for while recordings come in, until the process ends."""
    port = free_port()

    def ask() -> None:
        ingest(settings, paths)
        for job in scheduled_jobs(settings):
            with suppress(httpx.HTTPError):
                httpx.post(f"http://127.0.0.1:{port}/v1/jobs/{job.name}/runs", timeout=10.0)

    threading.Thread(target=ask, daemon=True).start()
    create_server(settings.model_copy(update={"port": port})).run()


def _until_written(settings: Settings) -> float:
    begin = time.monotonic()
    with closing(open_store(settings)) as storage, storage.write() as unit:
        unit.jobs.abandon_running(1)
    return time.monotonic() - begin
