"""What one run of all jobs costs where nothing is new: 1,000 vehicles, 4,000 wheelsets, 100 sections, 600,000 windows.

The jobs have run before, until they found nothing to do. Processor time is that of the process that runs the jobs and,
on PostgreSQL, of the server, too.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median

from sqlalchemy import func, select

from api.comparison.trial import opened
from api.pipeline import scheduled_jobs
from api.settings import Settings
from bench.counting import asked, run
from bench.idle_fleet import FleetSize, fill, note_opinions
from bench.measuring import cpu_of, tree
from bench.report import BenchRow, row_bench
from bench.standing_clock import StandingClock
from estimation.errors import TreadwatchError
from estimation.jobs.job import Job, JobContext
from fleet_db.migrate import upgrade
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.alerts import AlertRow
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.track import TrackSectionRow
from fleet_db.tables.windows import (
    RailCellRow,
    SectionAdhesionRow,
    WearSignatureRow,
    WindowAdhesionRow,
    WindowDamperRow,
    WindowRow,
)
from tests.postgres_server import SAFE, PostgresServer, stoppable_server

ROUNDS = 5
MOST_RUNS = 6
"""After so many runs of all jobs there is nothing to do any more."""

JUDGED_TOGETHER = ("refresh_signatures", "refresh_rails")
"""Jobs that read all of a fleet where there is news of one wheelset: what they have seen is noted instead."""

LATER_NS = 3_600_000_000_000
REACH_S, REACH_STATEMENTS = 0.35, 40
STATE = {"wheelsets", "sections", "unchanged", "without_limit", "quarantined"}
"""Counts of what is there; all others count what was done."""


def rows(size: FleetSize | None = None) -> Iterator[BenchRow]:
    """Yield processor time and statements of each job, on SQLite and on PostgreSQL."""
    size = size or FleetSize()
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), database_url=None, _env_file=None)
        yield from _measured("SQLite", settings, size, lambda: 0.0)
    with tempfile.TemporaryDirectory() as folder, stoppable_server(SAFE) as server:
        settings = Settings(data_dir=Path(folder), database_url=server.url, _env_file=None)
        yield from _measured("PostgreSQL", settings, size, lambda: _cpu_of_server(server))


@dataclass(slots=True)
class Spent:
    """What a job costs in each of some runs."""

    cpu_s: list[float] = field(default_factory=list)
    statements: list[int] = field(default_factory=list)
    writes: list[int] = field(default_factory=list)


def _measured(name: str, settings: Settings, size: FleetSize, server_s: Callable[[], float]) -> Iterator[BenchRow]:
    upgrade(settings.url)
    with opened(settings) as (storage, context):
        began = time.perf_counter()
        end_ns = fill(context, storage, settings, size)
        filled_s = time.perf_counter() - began
        at, jobs = replace(context, clock=StandingClock(end_ns + LATER_NS)), scheduled_jobs(settings)
        runs = _run_until_nothing_is_done(at, tuple(job for job in jobs if job.name not in JUDGED_TOGETHER))
        note_opinions(at, storage)
        runs += _run_until_nothing_is_done(at, jobs)
        yield BenchRow(
            f"{name}: filled with", f"{_counts(storage)} ({filled_s:.0f} s; at rest after {runs} runs)", "", met=True
        )
        spent = {job.name: Spent() for job in jobs}
        for _ in range(ROUNDS):
            for job in jobs:
                _run_counted(at, job, spent[job.name], server_s)
    for job_name, one in spent.items():
        shown = f"{median(one.cpu_s):.3f} CPU s, {median(one.statements):.0f} statements"
        shown += f", {median(one.writes):.0f} transactions that write"
        yield BenchRow(f"{name}: idle run of {job_name}, median of {ROUNDS}", shown, "", met=True)
    whole_s = median(sum(each) for each in zip(*(one.cpu_s for one in spent.values()), strict=True))
    statements = sum(median(one.statements) for one in spent.values())
    met = whole_s < REACH_S and statements <= REACH_STATEMENTS
    reach = f"< {REACH_S:g} CPU s, <= {REACH_STATEMENTS} statements"
    yield BenchRow(f"{name}: idle run of all jobs", f"{whole_s:.2f} CPU s, {statements:.0f} statements", reach, met)


def _run_until_nothing_is_done(context: JobContext, jobs: tuple[Job, ...]) -> int:
    """Run the jobs until none of them does anything; return how often they ran."""
    for number in range(1, MOST_RUNS + 1):
        done: Counter[str] = Counter()
        for job in jobs:
            done.update({name: count for name, count in run(job, context).counts.items() if name not in STATE})
        if not +done:
            return number
    raise TreadwatchError(f"after {MOST_RUNS} runs the jobs still do something: {dict(+done)}")


def _run_counted(context: JobContext, job: Job, spent: Spent, server_s: Callable[[], float]) -> None:
    began_s = time.process_time() + server_s()
    with asked() as found:
        run(job, context)
    spent.cpu_s.append(time.process_time() + server_s() - began_s)
    spent.statements.append(found.statements)
    spent.writes.append(found.writes)


def _counts(storage: SqlStorage) -> str:
    with storage.read() as unit:
        of = {
            name: unit.connection.scalar(select(func.count()).select_from(table_of(row)))
            for name, row in (
                ("windows", WindowRow),
                ("sections", TrackSectionRow),
                ("wheelsets", WheelsetRow),
                ("alerts", AlertRow),
                ("signatures", WearSignatureRow),
                ("creep forces", WindowAdhesionRow),
                ("windows of dampers", WindowDamperRow),
                ("rail cells", RailCellRow),
                ("sections with friction", SectionAdhesionRow),
            )
        }
    return ", ".join(f"{count:,} {name}" for name, count in of.items())


def _cpu_of_server(server: PostgresServer) -> float:
    assert server.process is not None
    return sum(map(cpu_of, tree(server.process.pid)))


main = row_bench("idle", "A run of all jobs with nothing new", __doc__ or "", lambda _options, _folder: rows()).run
