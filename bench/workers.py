"""The command ``python -m bench workers``: what more worker processes make of the estimation of one deployment.

Time by the clock says little on a machine that does other things, too; so the processor time of every process is
counted as well. The longest of them, with what the process that hands out the work takes, is what the clock would show
on processors that are free.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table
from sqlalchemy import Engine, event

from api.comparison.trial import Recorded, opened, receive
from bench.chaos.final_state import final_state
from bench.report import BenchRow
from bench.results_page import markdown_table, write_page
from bench.worker_kinds import Kind, cpu_of, dask_of, here, pool_of
from bench.worker_load import Workload, workload
from estimation.errors import TreadwatchError
from estimation.jobs import estimate_windows, refresh_geometry
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from tests.postgres_server import SAFE, stoppable_server

JOBS = (estimate_windows.JOB, refresh_geometry.JOB)
COLUMNS = ("what", "measured", "reach", "met")
TITLE = "Worker processes"
REACH, EFFICIENCY, MOST_STATEMENTS, MOST_WRITING = 1.8, 0.9, 5.0, 0.1


@dataclass(frozen=True, slots=True)
class Estimated:
    """What one run of the jobs over a deployment came to.

    Attributes:
        windows: That waited at the begin.
        estimations: How many windows were estimated or refused.
        wall_s: By the clock, s.
        cpu_s: Processor time of all processes, s.
        longest_s: Processor time of the process that hands out the work, and of the busiest worker, s.
        state: Digests of what is stored.
    """

    windows: int
    estimations: int
    wall_s: float
    cpu_s: float
    longest_s: float
    state: Mapping[str, str]


def estimated(load: Workload, folder: Path, kind: Kind, count: int) -> Estimated:
    """Return what so many workers come to, once they have estimated something and have compiled all there is."""
    settings = load.copy(folder)
    with kind(settings, count) as (executor, workers), opened(settings) as (storage, plain):
        context = replace(plain, executor=executor)
        for job in JOBS:
            _run(job, context)
        receive(Recorded(tuple(load.recordings), load.received.data_dir), settings)
        with storage.read() as unit:
            windows = unit.windows.counts()["pending"]
        before = {pid: cpu_of(pid) for pid in workers()}
        begin_s, own_s = time.perf_counter(), time.process_time()
        done: Counter[str] = Counter()
        for job in JOBS:
            done.update(_run(job, context).counts)
        wall_s, own_s = time.perf_counter() - begin_s, time.process_time() - own_s
        each = [cpu_of(pid) - before.get(pid, 0.0) for pid in workers()]
        return Estimated(
            windows=windows,
            estimations=done["estimated"] + done["refused"],
            wall_s=wall_s,
            cpu_s=own_s + sum(each),
            longest_s=own_s + max(each, default=0.0),
            state=final_state(storage),
        )


def _run(job: Job, context: JobContext) -> JobRun:
    found = run_job(job, context, JobTrigger.CLI)
    if found.error is not None:
        raise TreadwatchError(f"{found.job}: {found.error}")
    return found


@dataclass(slots=True)
class Counted:
    """What a process asks of its database: statements, transactions that write, and the time that those take."""

    statements: int = 0
    writes: int = 0
    writing_s: float = 0.0


@contextmanager
def counted() -> Iterator[Counted]:
    """Count what is asked of a database while the block lasts."""
    found, write = Counted(), SqlStorage.write

    def count(*_parameters: object) -> None:
        found.statements += 1

    @contextmanager
    def timed(self: SqlStorage) -> Iterator[SqlUnitOfWork]:
        begin_s = time.perf_counter()
        with write(self) as unit:
            yield unit
        found.writes += 1
        found.writing_s += time.perf_counter() - begin_s

    event.listen(Engine, "before_cursor_execute", count)
    SqlStorage.write = timed  # type: ignore[method-assign]
    try:
        yield found
    finally:
        SqlStorage.write = write  # type: ignore[method-assign]
        event.remove(Engine, "before_cursor_execute", count)


def rows(folder: Path, vehicles: int, minutes: float, repeats: int, server: str | None) -> Iterator[BenchRow]:
    """Yield what two workers make of a load beside one, in processes of this machine and on Dask.

    Args:
        repeats: How often each is measured; the best counts, for the machine may do other things.
        server: URL of a PostgreSQL server; None for SQLite.
    """
    load = workload(folder, vehicles, minutes, server)
    on = "SQLite" if server is None else "PostgreSQL"
    yield from _asked(load, folder, on)
    numbers = itertools.count()

    def several(kind: Kind, count: int) -> list[Estimated]:
        return [estimated(load, folder / str(next(numbers)), kind, count) for _ in range(repeats)]

    (alone,) = several(here, 1)[:1]
    for name, kind in (("processes", pool_of), ("Dask workers", dask_of)):
        one, two = several(kind, 1), several(kind, 2)
        yield _ratio(f"2 {name} against 1, {on}: windows a second by the clock", one, two, "wall_s")
        yield _ratio(f"2 {name} against 1, {on}: by processor time of the longest", one, two, "longest_s")
        yield _efficiency(f"2 {name} against 1, {on}: work per processor second", one, two)
        twice = sum(run.estimations - run.windows for run in (*one, *two))
        yield BenchRow(f"{name}, {on}: windows estimated twice", str(twice), "0", twice == 0)
        states = len({tuple(sorted(run.state.items())) for run in (alone, *one, *two)})
        what = f"{name}, {on}: final states of {len(one) + len(two)} runs and of a single process"
        yield BenchRow(what, str(states), "1", states == 1)


def _ratio(what: str, one: Sequence[Estimated], two: Sequence[Estimated], by: str) -> BenchRow:
    first, second = (max(run.estimations / float(getattr(run, by)) for run in runs) for runs in (one, two))
    measured = f"{second / first:.2f} ({first:.2f}, then {second:.2f})"
    return BenchRow(what, measured, f">= {REACH:g}", second / first >= REACH)


def _efficiency(what: str, one: Sequence[Estimated], two: Sequence[Estimated]) -> BenchRow:
    first, second = (min(run.cpu_s / run.windows for run in runs) for runs in (one, two))
    measured = f"{first / second:.2f} ({first:.2f} s, then {second:.2f} s a window)"
    return BenchRow(what, measured, f">= {EFFICIENCY:g}", first / second >= EFFICIENCY)


def _asked(load: Workload, folder: Path, on: str) -> Iterator[BenchRow]:
    """Yield what one process asks of the database for each window."""
    settings = load.copy(folder / "asked")
    with opened(settings) as (storage, context):
        for job in JOBS:
            _run(job, context)
        receive(Recorded(tuple(load.recordings), load.received.data_dir), settings)
        with storage.read() as unit:
            windows = unit.windows.counts()["pending"]
        begin_s = time.perf_counter()
        with counted() as found:
            _run(estimate_windows.JOB, context)
        took_s = time.perf_counter() - begin_s
    each, writing = found.statements / windows, found.writing_s / took_s
    measured = f"{each:.1f} ({windows} windows)"
    yield BenchRow(f"statements a window, {on}", measured, f"<= {MOST_STATEMENTS:g}", each <= MOST_STATEMENTS)
    measured = f"{100 * writing:.1f} % in {found.writes} transactions"
    reach = f"<= {100 * MOST_WRITING:g} %"
    yield BenchRow(f"share of its time in which a worker writes, {on}", measured, reach, writing <= MOST_WRITING)


def main(arguments: Sequence[str]) -> int:
    """Measure, print, and return 1 when a row falls short."""
    parser = argparse.ArgumentParser("python -m bench workers", description=TITLE)
    parser.add_argument("--vehicles", type=int, default=2, help="of four wheelsets")
    parser.add_argument("--minutes", type=float, default=10.0, help="that each of two journeys of a vehicle takes")
    parser.add_argument("--repeats", type=int, default=2, help="of each measurement; the best counts")
    parser.add_argument("--database", choices=["sqlite", "postgresql"], default="postgresql")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/workers.md too")
    options = parser.parse_args(arguments)
    console, cells = Console(), []
    with tempfile.TemporaryDirectory(prefix="treadwatch-workers-") as name, ExitStack() as stack:
        on_server = options.database == "postgresql"
        server = stack.enter_context(stoppable_server(SAFE)).url if on_server else None
        for row in rows(Path(name), options.vehicles, options.minutes, options.repeats, server):
            console.print(f"{row.what}: {row.measured}", highlight=False, soft_wrap=True)
            cells.append((row.what, row.measured, row.reach, "yes" if row.met else "NO"))
    table = Table(*COLUMNS, title="treadwatch bench workers", title_justify="left", show_lines=True)
    for line in cells:
        table.add_row(*line)
    console.print(table)
    if options.write_docs:
        command = " ".join(["python -m bench workers", *arguments])
        console.print(f"wrote {write_page('workers', TITLE, command, [markdown_table(COLUMNS, cells)])}")
    return 1 if any(line[-1] == "NO" for line in cells) else 0
