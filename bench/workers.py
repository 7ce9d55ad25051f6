"""Worker processes: ``python -m bench workers`` or ``sustained``.

``workers``: what more worker processes make of the estimation of one deployment. Time by the clock says little on a
machine that does other things, too; so the processor time of every process is counted as well. The longest of them,
with what the process that hands out the work takes, is what the clock would show on processors that are free.

``sustained``: chunks to persisted bin tables without a pause, on two cores. Chunks of a journey on surveyed track are
put into a drop folder under the names of ever more vehicles, as fast as they are taken. ``treadwatch chunk drop``
stores them, ``treadwatch chunk work`` decodes them, and ``estimate_windows`` runs again and again with worker
processes. Counted are the frames of windows whose bin tables are stored, or that were refused with a reason. Processor
time and memory are those of all processes, the server's, too. To be run where nothing else runs.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from sqlalchemy import func, select

from api.comparison.trial import opened, receive
from api.workers.pool import ProcessPool
from bench.chaos.final_state import final_state
from bench.counting import asked, run
from bench.measuring import KINDS, Kind, cpu_of, cpu_of_tree, every, here, memory_of_tree, windows_of
from bench.report import BenchRow, row_bench
from bench.services import running
from bench.small_fleets import Workload, code_of, copy_of, put_copies, workload
from estimation.jobs import estimate_windows, refresh_alignment, refresh_geometry
from estimation.jobs.job import JobContext
from fleet_db.records import ChunkState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.recordings import ChunkRow
from tests.postgres_server import SAFE, stoppable_server

JOBS = (estimate_windows.JOB, refresh_geometry.JOB)
REACH, EFFICIENCY, MOST_STATEMENTS, MOST_WRITING = 1.8, 0.9, 5.0, 0.1
CHUNKS = table_of(ChunkRow)
CORES, WAITING = 2, 12
"""Of the reach; chunks that wait to be taken or decoded at any time."""

WARM_SHARE, WARM_S, LOOK_S, FEED_S = 0.2, 40.0, 5.0, 0.2
REACH_FRAMES, REACH_BYTES, REACH_GROWTH = 1e6, 4 * 2**30, 0.05
MB = 1e6


@dataclass(frozen=True, slots=True)
class Estimated:
    """What one run of the jobs over a deployment came to."""

    windows: int  # that waited at the begin
    estimations: int  # windows that were estimated or refused
    wall_s: float  # by the clock
    cpu_s: float  # of all processes
    longest_s: float  # CPU time of the process that hands out the work, and of the busiest worker
    state: Mapping[str, str]  # digests of what is stored


def _workers(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield what two workers make of a load beside one, in processes of this machine and on Dask."""
    with ExitStack() as stack:
        on_server = options.database == "postgresql"
        server = stack.enter_context(stoppable_server(SAFE)).url if on_server else None
        load = workload(folder, options.vehicles, options.minutes, server)
        on = "PostgreSQL" if on_server else "SQLite"
        yield from _asked(load, folder, on)
        numbers = itertools.count()

        def several(kind: Kind, count: int) -> list[Estimated]:
            return [_estimated(load, folder / str(next(numbers)), kind, count) for _ in range(options.repeats)]

        alone = several(here, 1)[0]
        for name, kind in KINDS.items():
            yield from _beside(name, on, alone, several(kind, 1), several(kind, 2))


def _beside(
    name: str, on: str, alone: Estimated, one: Sequence[Estimated], two: Sequence[Estimated]
) -> Iterator[BenchRow]:
    what = f"2 {name} against 1, {on}"
    yield _ratio(f"{what}: windows a second by the clock", one, two, "wall_s")
    yield _ratio(f"{what}: by processor time of the longest", one, two, "longest_s")
    first, second = (min(run.cpu_s / run.windows for run in runs) for runs in (one, two))
    measured = f"{first / second:.2f} ({first:.2f} s, then {second:.2f} s a window)"
    yield BenchRow(f"{what}: work per processor second", measured, f">= {EFFICIENCY:g}", first / second >= EFFICIENCY)
    twice = sum(run.estimations - run.windows for run in (*one, *two))
    yield BenchRow(f"{name}, {on}: windows estimated twice", str(twice), "0", twice == 0)
    states = len({tuple(sorted(run.state.items())) for run in (alone, *one, *two)})
    what = f"{name}, {on}: final states of {len(one) + len(two)} runs and of a single process"
    yield BenchRow(what, str(states), "1", states == 1)


def _ratio(what: str, one: Sequence[Estimated], two: Sequence[Estimated], by: str) -> BenchRow:
    first, second = (max(run.estimations / float(getattr(run, by)) for run in runs) for runs in (one, two))
    measured = f"{second / first:.2f} ({first:.2f}, then {second:.2f})"
    return BenchRow(what, measured, f">= {REACH:g}", second / first >= REACH)


def _estimated(load: Workload, folder: Path, kind: Kind, count: int) -> Estimated:
    """Return what so many workers come to, once they have estimated something and have compiled all there is."""
    settings = load.copy(folder)
    with kind(settings, count) as (executor, workers), opened(settings) as (storage, plain):
        context = replace(plain, executor=executor)
        for job in JOBS:
            run(job, context)
        receive(load.recorded, settings)
        windows = windows_of(storage)["pending"]
        before = {pid: cpu_of(pid) for pid in workers()}
        begin_s, own_s = time.perf_counter(), time.process_time()
        done: Counter[str] = Counter()
        for job in JOBS:
            done.update(run(job, context).counts)
        wall_s, own_s = time.perf_counter() - begin_s, time.process_time() - own_s
        each = [cpu_of(pid) - before.get(pid, 0.0) for pid in workers()]
        estimations, longest_s = done["estimated"] + done["refused"], own_s + max(each, default=0.0)
        return Estimated(windows, estimations, wall_s, own_s + sum(each), longest_s, final_state(storage))


def _asked(load: Workload, folder: Path, on: str) -> Iterator[BenchRow]:
    """Yield what one process asks of the database for each window."""
    settings = load.copy(folder / "asked")
    with opened(settings) as (storage, context):
        for job in JOBS:
            run(job, context)
        receive(load.recorded, settings)
        windows, begin_s = windows_of(storage)["pending"], time.perf_counter()
        with asked() as found:
            run(estimate_windows.JOB, context)
        took_s = time.perf_counter() - begin_s
    each, writing = found.statements / windows, found.writing_s / took_s
    measured = f"{each:.1f} ({windows} windows)"
    yield BenchRow(f"statements a window, {on}", measured, f"<= {MOST_STATEMENTS:g}", each <= MOST_STATEMENTS)
    measured = f"{100 * writing:.1f} % in {found.writes} transactions"
    reach = f"<= {100 * MOST_WRITING:g} %"
    yield BenchRow(f"share of its time in which a worker writes, {on}", measured, reach, writing <= MOST_WRITING)


@dataclass(slots=True)
class Feed:
    """Puts copies of chunks into the drop folder, each as one of another vehicle that is put on file for it."""

    folder: Path
    recordings: Sequence[bytes]
    storage: SqlStorage
    model: str  # vehicle that the others are like
    number: int = 0

    def refill(self) -> None:
        """Put as many files as there are too few."""
        with self.storage.read() as unit:
            waiting = unit.chunks.undecoded_size().count
        for _ in range(WAITING - waiting - len(list(self.folder.glob("*.blf")))):
            self.number += 1
            vehicle = code_of(self.number)
            put_copies(self.storage, self.model, [vehicle])
            part = self.folder / f"{vehicle}.part"
            part.write_bytes(copy_of(self.recordings[self.number % len(self.recordings)], self.number))
            part.rename(self.folder / f"{vehicle}__{self.number:05d}.blf")


@dataclass(slots=True)
class Watched:
    """Time by the clock and memory, looked at now and then."""

    begun_s: float
    at_s: list[float] = field(default_factory=list)
    bytes_: list[int] = field(default_factory=list)

    def look(self) -> None:
        """Look at the memory now."""
        self.at_s.append(time.perf_counter() - self.begun_s)
        self.bytes_.append(memory_of_tree())

    def growth(self) -> tuple[float, float, float]:
        """Return memory at 1/5 and at the end, bytes, by a line through what is between; and its slope, bytes/s."""
        at, held = np.array(self.at_s), np.array(self.bytes_, float)
        later = at >= WARM_SHARE * at[-1]
        slope, start = np.polyfit(at[later], held[later], 1)
        return float(start + slope * WARM_SHARE * at[-1]), float(start + slope * at[-1]), float(slope)


def _sustained(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield frames per second by the clock and by processor time, and the memory."""
    incoming = folder / "incoming"
    incoming.mkdir()
    with ExitStack() as stack:
        server = stack.enter_context(stoppable_server(SAFE))
        load = workload(folder / "load", 1, options.journey, server.url)
        settings, model = load.copy(folder / "deployed"), load.recordings[0][0]
        contents = [path.read_bytes() for vehicle, path in load.recordings if vehicle == model]
        pool = ProcessPool(settings, CORES)
        stack.callback(pool.shutdown)
        storage, plain = stack.enter_context(opened(settings))
        context, feed = replace(plain, executor=pool), Feed(incoming, contents, storage, model)
        stack.enter_context(running(settings, "chunk", "drop", str(incoming), "--quiet-s", "0.2"))
        stack.enter_context(running(settings, "chunk", "work"))
        stack.enter_context(every(FEED_S, feed.refill))
        _estimate_for(context, WARM_S)  # whatever is compiled or started is by now
        before, cpu_s, watched = _done(storage), cpu_of_tree(), Watched(time.perf_counter())
        stack.enter_context(every(LOOK_S, watched.look))
        _estimate_for(context, 60.0 * options.minutes)
        took_s, spent_s, after = time.perf_counter() - watched.begun_s, cpu_of_tree() - cpu_s, _done(storage)
    frames, windows, refused = (later - earlier for later, earlier in zip(after, before, strict=True))
    what = f"chunks to stored bin tables for {took_s / 60.0:.1f} min, {CORES} worker processes"
    shown = f"{frames / took_s / 1e6:.2f} M frames/s ({frames / 1e6:.0f} M frames, "
    shown += f"{windows:,.0f} windows, of which {refused:,.0f} refused)"
    yield BenchRow(f"{what}: by the clock", shown, ">= 1 M", frames / took_s >= REACH_FRAMES)
    rate = CORES * frames / spent_s
    shown = f"{rate / 1e6:.2f} M frames/s on {CORES} cores ({spent_s:.0f} CPU s)"
    yield BenchRow(f"{what}: by processor time of all processes", shown, ">= 1 M", rate >= REACH_FRAMES)
    first, last, slope = watched.growth()
    flat = last - first < REACH_GROWTH * first
    shown = f"{first / MB:.0f} MB at 1/5, {last / MB:.0f} MB at the end, {60.0 * slope / MB:+.1f} MB a minute"
    shown += f", at most {max(watched.bytes_) / MB:.0f} MB"
    yield BenchRow(f"{what}: memory", shown, "< 4 GiB, grows by < 5 %", flat and max(watched.bytes_) < REACH_BYTES)


def _done(storage: SqlStorage) -> tuple[float, int, int]:
    """Return frames of windows that are estimated or refused, how many these are, and how many are refused."""
    counts = windows_of(storage)
    with storage.read() as unit:
        decoded = CHUNKS.c.state == ChunkState.DECODED.value
        frames = unit.connection.scalar(select(func.sum(CHUNKS.c.frames)).where(decoded)) or 0
    windows = counts["estimated"] + counts["refused"]
    return float(frames) * windows / max(1, counts.total()), windows, counts["refused"]


def _estimate_for(context: JobContext, seconds: float) -> None:
    """Let the jobs run again and again for some time, while chunks come."""
    until_s, last_ns = time.perf_counter() + seconds, 0

    def over() -> bool:
        return time.perf_counter() >= until_s

    context = replace(context, stopping=over)  # a run goes on for as long as windows come
    while not over():
        run(estimate_windows.JOB, context)
        if time.perf_counter_ns() - last_ns > 1e9 * refresh_alignment.JOB.every_s:
            last_ns = time.perf_counter_ns()
            run(refresh_alignment.JOB, replace(context, executor=None))


BENCHES = (
    row_bench(
        "workers",
        "Worker processes",
        __doc__,
        _workers,
        {
            "vehicles": (2, "of four wheelsets"),
            "minutes": (10.0, "that each of two journeys of a vehicle takes"),
            "repeats": (2, "of each measurement; the best counts"),
            "database": ("postgresql", "or sqlite"),
        },
    ),
    row_bench(
        "sustained",
        "Chunks to bin tables, without a pause",
        __doc__,
        _sustained,
        {"minutes": (5.0, "how long chunks come"), "journey": (10.0, "minutes of a chunk")},
    ),
)
