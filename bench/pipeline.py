"""The command ``python -m bench pipeline``: what chunks of a fleet cost until their bin tables, trends and alerts.

Processor time of this process and of those that it starts is counted, stage by stage, after a first journey has been
received and compiled everything: on a section that nobody has surveyed, whose alignment is estimated from the same
recordings, and on one that is on file. On the latter bin tables need the stages ``BIN_TABLES`` alone, and are compared
with what one would make of python-can, cantools, scipy, padasip and the ORM. That rival is given less to do: no
positions, no refusals, no checks. It is timed on a share of the same frames.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from sqlalchemy import Engine, event

from api.comparison.trial import Recorded, opened, receive
from api.terminal.processes import executor_of
from bench.pipeline_rival import rival_s_per_frame
from bench.process_tree import cpu_of_tree, tree
from bench.report import BenchRow, printed
from bench.results_page import ended
from bench.worker_load import Workload, workload
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import run_job
from estimation.values.runs import JobTrigger
from ingest.frames import take
from ingest.logs import read_log, write_blf

CORES, HOUR_S, AXLES = 2, 3600.0, 4
REACH_FRAMES, REACH_RATIO, REACH_HOUR_S, REACH_GIB, REACH_SHARE = 1e6, 20.0, 1.5, 4.0, 0.95
GIB = 2**30
BIN_TABLES = ("ingest", "estimate_windows")
"""Stages from a chunk to its bin tables where the track is on file."""


@dataclass(slots=True)
class Stages:
    """What each stage took: CPU s and statements; and how many windows there are."""

    windows: int = 0
    cpu_s: dict[str, float] = field(default_factory=dict)
    statements: dict[str, int] = field(default_factory=dict)


def rows(folder: Path, vehicles: int, minutes: float, chunk_s: float) -> Iterator[BenchRow]:
    """Yield what each stage costs per wheelset-hour, frames per second, and the ratio to the rival.

    Args:
        vehicles, minutes: Of the load: vehicles of four wheelsets, a journey of so many minutes.
        chunk_s: Length of the chunks that are received, s.
    """
    for surveyed in (False, True):
        track = "surveyed" if surveyed else "unsurveyed"
        own = folder / track
        (own / "load").mkdir(parents=True)
        load = workload(own / "load", vehicles, minutes, surveyed=surveyed)
        chunks = list(_chunks(load, own / "chunks", chunk_s))
        journeys = [(vehicle, path) for vehicle, path, _ in chunks]
        stages, peak = _measured(load, own / "measured", journeys)
        what = f"{vehicles * AXLES} wheelsets, {track} track, {minutes:g} min in chunks of {chunk_s:g} s"
        hours = len(load.recordings) * AXLES * minutes / 60.0
        yield from _stages(what, stages, hours, len(chunks))
        if surveyed:
            yield from _beside_rival(load, stages, sum(count for _, _, count in chunks), hours)
        else:
            total = sum(stages.cpu_s.values()) / hours
            shown = f"{total:.2f} CPU s per wheelset-hour"
            yield BenchRow(f"{what}: all of it", shown, f"<= {REACH_HOUR_S}", total <= REACH_HOUR_S)
            share = 1.0 - _beside_workers_s(load, own / "workers", journeys) / _jobs_s(stages)
            yield BenchRow(
                f"{what}: share of the jobs' time that workers take over",
                f"{share:.1%}",
                ">= 95 %",
                share >= REACH_SHARE,
            )
        yield BenchRow(
            f"{what}: memory of the processes at most", f"{peak / GIB:.2f} GiB", "< 4 GiB", peak < REACH_GIB * GIB
        )


def _stages(what: str, stages: Stages, hours: float, chunks: int) -> Iterator[BenchRow]:
    for name, spent in stages.cpu_s.items():
        shown = f"{spent / hours:.3f} CPU s per wheelset-hour, {stages.statements[name]} statements"
        if name == "ingest":
            shown += f", {stages.statements[name] / chunks:.0f} a chunk"
        if name in BIN_TABLES:
            shown += f", {stages.statements[name] / stages.windows:.1f} a window"
        yield BenchRow(f"{what}: {name}", shown, "", met=True)


def _beside_rival(load: Workload, stages: Stages, frames: int, hours: float) -> Iterator[BenchRow]:
    """Yield frames per second to bin tables, and the ratio to the rival."""
    spent = sum(stages.cpu_s[name] for name in BIN_TABLES)
    rate = CORES * frames / spent
    what = f"{frames:,} frames to persisted bin tables, {CORES} cores"
    yield BenchRow(what, f"{rate / 1e6:.2f} M frames/s of CPU time", ">= 1 M", rate >= REACH_FRAMES)
    theirs = rival_s_per_frame(load.recordings[0][1])
    ratio = theirs * frames / spent
    shown = f"{theirs * frames / hours:.1f} CPU s per wheelset-hour: {ratio:.1f} times ours"
    what = "the same by python-can, cantools, scipy, padasip and the ORM"
    yield BenchRow(what, shown, f">= {REACH_RATIO:.0f} times", ratio >= REACH_RATIO)


def _chunks(load: Workload, folder: Path, chunk_s: float) -> Iterator[tuple[str, Path, int]]:
    """Yield vehicle, file and frames of the recordings after the first, cut into chunks."""
    folder.mkdir()
    for number, (vehicle, path) in enumerate(load.recordings):
        batch = read_log(path)
        part = (batch.t_ns - batch.t_ns[0]) // round(chunk_s * 1e9)
        starts = [0, *(1 + i for i in range(len(part) - 1) if part[i] != part[i + 1]), len(part)]
        for first, last in pairwise(starts):
            file = folder / f"{number:04}_{first:09}.blf"
            write_blf(file, take(batch, slice(first, last)))
            yield vehicle, file, last - first


def _measured(load: Workload, folder: Path, chunks: Sequence[tuple[str, Path]]) -> tuple[Stages, int]:
    """Return what the stages took, and the largest memory of this process and those that it started, bytes."""
    folder.mkdir()
    settings, found = load.copy(folder), Stages()
    with opened(settings) as (storage, context), ExitStack() as stack:
        for job in ALL_JOBS:
            run_job(job, context, JobTrigger.CLI)
        peak = stack.enter_context(_peak_memory())
        asked = stack.enter_context(statements())
        with storage.read() as unit:
            known = sum(unit.windows.counts().values())
        begin_s, before = cpu_of_tree(), asked[0]
        receive(Recorded(tuple(chunks), load.received.data_dir), settings)
        found.cpu_s["ingest"], found.statements["ingest"] = cpu_of_tree() - begin_s, asked[0] - before
        with storage.read() as unit:
            found.windows = sum(unit.windows.counts().values()) - known
        for job in ALL_JOBS:
            begin_s, before = cpu_of_tree(), asked[0]
            run = run_job(job, context, JobTrigger.CLI)
            if run.error is not None:
                raise TreadwatchError(f"{run.job}: {run.error}")
            found.cpu_s[job.name], found.statements[job.name] = cpu_of_tree() - begin_s, asked[0] - before
    return found, peak[0]


def _jobs_s(stages: Stages) -> float:
    return sum(spent for name, spent in stages.cpu_s.items() if name != "ingest")


def _beside_workers_s(load: Workload, folder: Path, chunks: Sequence[tuple[str, Path]]) -> float:
    """Return the CPU time that this process spends on the same jobs where two workers do the units, s."""
    folder.mkdir()
    settings = load.copy(folder).model_copy(update={"workers": CORES})
    with opened(settings) as (_, context):
        for job in ALL_JOBS:
            run_job(job, context, JobTrigger.CLI)
        receive(Recorded(tuple(chunks), load.received.data_dir), settings)
        with executor_of(settings) as executor:
            begin_s = time.process_time()
            for job in ALL_JOBS:
                run_job(job, replace(context, executor=executor), JobTrigger.CLI)
            return time.process_time() - begin_s


@contextmanager
def statements() -> Iterator[list[int]]:
    """Yield the number of statements that every connection of this process has executed so far."""
    asked = [0]

    def count(*_: object) -> None:
        asked[0] += 1

    event.listen(Engine, "before_cursor_execute", count)
    try:
        yield asked
    finally:
        event.remove(Engine, "before_cursor_execute", count)


@contextmanager
def _peak_memory() -> Iterator[list[int]]:
    """Yield the largest sum of the resident memory of the processes so far, looked at every 50 ms, bytes."""
    largest, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(0.05):
            largest[0] = max(largest[0], sum(map(_resident, tree(os.getpid()))))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield largest
    finally:
        ended.set()
        watcher.join()


def _resident(pid: int) -> int:
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except OSError:
        return 0
    return int(pages) * resource.getpagesize()


def main(arguments: Sequence[str]) -> int:
    """Measure and print; return 1 where a row falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench pipeline", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=3, help="of four wheelsets (3)")
    parser.add_argument("--minutes", type=float, default=15.0, help="of a journey (15)")
    parser.add_argument("--chunk", type=float, nargs="+", default=[900.0, 60.0], help="length of a chunk, s (900 60)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/pipeline.md")
    options = parser.parse_args(arguments)
    found = []
    for chunk_s in options.chunk:
        with tempfile.TemporaryDirectory() as folder:
            found += printed(rows(Path(folder), options.vehicles, options.minutes, chunk_s))
    command = " ".join(["python -m bench pipeline", *arguments]) if options.write_docs else None
    return ended(found, "pipeline", "From chunks to alerts", command)
