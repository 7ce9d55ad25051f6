"""The command ``python -m bench sustained``: chunks to persisted bin tables without a pause, on two cores.

Chunks of a journey on surveyed track are put into a drop folder under the names of ever more vehicles, as fast as they
are taken. ``treadwatch chunk drop`` stores them, ``treadwatch chunk work`` decodes them, and ``estimate_windows`` runs
again and again with worker processes. Counted are the frames of windows whose bin tables are stored, or that were
refused with a reason. Processor time and memory are those of all processes, the server's, too. To be run where nothing
else runs.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from sqlalchemy import func, select

from api.comparison.trial import opened
from api.settings import Settings
from api.workers.pool import ProcessPool
from bench.process_tree import cpu_of_tree, memory_of_tree
from bench.report import BenchRow, printed
from bench.results_page import ended
from bench.worker_load import Workload, workload
from estimation.errors import TreadwatchError
from estimation.jobs import estimate_windows, refresh_alignment
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.records import ChunkState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.recordings import ChunkRow
from tests.postgres_server import SAFE, stoppable_server

TITLE = "Chunks to bin tables, without a pause"
CHUNKS = table_of(ChunkRow)
CORES, WAITING = 2, 12
"""Of the reach; chunks that wait to be taken or decoded at any time."""

APPLICATION_AT = 8
"""Place of four bytes of a BLF file that name the program: with them each copy has a digest of its own."""

WARM_SHARE, WARM_S, LOOK_S, FEED_S = 0.2, 40.0, 5.0, 0.2
REACH_FRAMES, REACH_BYTES, REACH_GROWTH = 1e6, 4 * 2**30, 0.05
MB = 1e6


@dataclass(slots=True)
class Feed:
    """Puts copies of chunks into the drop folder, each as one of another vehicle that is put on file for it.

    Attributes:
        folder: That the product watches.
        recordings: Contents of files.
        storage: Of the deployment; its first vehicle is the model of the others.
    """

    folder: Path
    recordings: Sequence[bytes]
    storage: SqlStorage
    model: str
    number: int = 0

    def refill(self) -> None:
        """Put as many files as there are too few."""
        with self.storage.read() as unit:
            waiting = unit.chunks.undecoded_size().count
        for _ in range(WAITING - waiting - len(list(self.folder.glob("*.blf")))):
            self.number += 1
            vehicle = f"C-{self.number:05d}"
            self._register(vehicle)
            content = bytearray(self.recordings[self.number % len(self.recordings)])
            content[APPLICATION_AT : APPLICATION_AT + 4] = self.number.to_bytes(4, "little")
            part = self.folder / f"{vehicle}.part"
            part.write_bytes(content)
            part.rename(self.folder / f"{vehicle}__{self.number:05d}.blf")

    def _register(self, vehicle: str) -> None:
        with self.storage.write() as unit:
            unit.registry.add_vehicle(replace(unit.registry.vehicle(self.model), code=vehicle))
            for wheelset in unit.registry.wheelsets():
                mounting = wheelset.mounting
                if mounting is not None and mounting.vehicle == self.model:
                    serial = f"{vehicle}-{mounting.axle}"
                    own = replace(mounting, wheelset=serial, vehicle=vehicle)
                    unit.registry.add_wheelset(replace(wheelset, serial=serial, mounting=own))
            unit.stale_spans.remove(unit.stale_spans.all(vehicle))  # it has no recording yet


@dataclass(slots=True)
class Watched:
    """Time by the clock and memory, looked at now and then."""

    at_s: list[float] = field(default_factory=list)
    bytes_: list[int] = field(default_factory=list)

    def look(self, begun_s: float) -> None:
        """Look at the memory now."""
        self.at_s.append(time.perf_counter() - begun_s)
        self.bytes_.append(memory_of_tree())

    def growth(self) -> tuple[float, float, float]:
        """Return memory at 1/5 and at the end, bytes, by a line through what is between; and its slope, bytes/s."""
        at, held = np.array(self.at_s), np.array(self.bytes_, float)
        later = at >= WARM_SHARE * at[-1]
        slope, start = np.polyfit(at[later], held[later], 1)
        return float(start + slope * WARM_SHARE * at[-1]), float(start + slope * at[-1]), float(slope)


def rows(folder: Path, load: Workload, minutes: float) -> Iterator[BenchRow]:
    """Yield frames per second by the clock and by processor time, and the memory.

    Args:
        load: A deployment whose first vehicle's journeys are copied.
    """
    settings, incoming = load.copy(folder / "deployed"), folder / "incoming"
    incoming.mkdir()
    model = load.recordings[0][0]
    contents = [path.read_bytes() for vehicle, path in load.recordings if vehicle == model]
    pool = ProcessPool(settings, CORES)
    with ExitStack() as stack:
        stack.callback(pool.shutdown)
        storage, plain = stack.enter_context(opened(settings))
        assert isinstance(storage, SqlStorage)
        context, feed = replace(plain, executor=pool), Feed(incoming, contents, storage, model)
        for arguments in (["drop", str(incoming), "--quiet-s", "0.2"], ["work"]):
            stack.enter_context(_running(settings, arguments))
        stack.enter_context(_every(FEED_S, feed.refill))
        _estimated(context, WARM_S)  # whatever is compiled or started is by now
        watched, before, cpu_s, begun_s = Watched(), _done(storage), cpu_of_tree(), time.perf_counter()
        stack.enter_context(_every(LOOK_S, lambda: watched.look(begun_s)))
        _estimated(context, 60.0 * minutes)
        took_s, spent_s, after = time.perf_counter() - begun_s, cpu_of_tree() - cpu_s, _done(storage)
    frames = after.frames - before.frames
    what = f"chunks to stored bin tables for {took_s / 60.0:.1f} min, {CORES} worker processes"
    shown = f"{frames / took_s / 1e6:.2f} M frames/s ({frames / 1e6:.0f} M frames, "
    shown += f"{after.windows - before.windows:,} windows, of which {after.refused - before.refused:,} refused)"
    yield BenchRow(f"{what}: by the clock", shown, ">= 1 M", frames / took_s >= REACH_FRAMES)
    rate = CORES * frames / spent_s
    shown = f"{rate / 1e6:.2f} M frames/s on {CORES} cores ({spent_s:.0f} CPU s)"
    yield BenchRow(f"{what}: by processor time of all processes", shown, ">= 1 M", rate >= REACH_FRAMES)
    first, last, slope = watched.growth()
    flat = last - first < REACH_GROWTH * first
    shown = f"{first / MB:.0f} MB at 1/5, {last / MB:.0f} MB at the end, {60.0 * slope / MB:+.1f} MB a minute"
    shown += f", at most {max(watched.bytes_) / MB:.0f} MB"
    yield BenchRow(f"{what}: memory", shown, "< 4 GiB, grows by < 5 %", flat and max(watched.bytes_) < REACH_BYTES)


@dataclass(frozen=True, slots=True)
class _Done:
    """What is stored: windows that are estimated or refused, and the frames that they came from."""

    windows: int
    refused: int
    frames: float


def _done(storage: SqlStorage) -> _Done:
    with storage.read() as unit:
        counts = unit.windows.counts()
        decoded = CHUNKS.c.state == ChunkState.DECODED.value
        frames = unit.connection.scalar(select(func.sum(CHUNKS.c.frames)).where(decoded)) or 0
    windows = counts["estimated"] + counts["refused"]
    return _Done(windows, counts["refused"], float(frames) * windows / max(1, sum(counts.values())))


def _estimated(context: JobContext, seconds: float) -> None:
    """Let the jobs run again and again for some time, while chunks come."""
    until_s, last_ns = time.perf_counter() + seconds, 0

    def over() -> bool:
        return time.perf_counter() >= until_s

    context = replace(context, stopping=over)  # a run goes on for as long as windows come
    while not over():
        _run(estimate_windows.JOB, context)
        if time.perf_counter_ns() - last_ns > 1e9 * refresh_alignment.JOB.every_s:
            last_ns = time.perf_counter_ns()
            _run(refresh_alignment.JOB, replace(context, executor=None))


def _run(job: Job, context: JobContext) -> None:
    run = run_job(job, context, JobTrigger.CLI)
    if run.outcome is JobOutcome.FAILED:
        raise TreadwatchError(f"{run.job}: {run.error}")


@contextmanager
def _running(settings: Settings, arguments: Sequence[str]) -> Iterator[None]:
    """Let ``treadwatch chunk`` run meanwhile."""
    named = {"TREADWATCH_DATA_DIR": str(settings.data_dir), "TREADWATCH_DATABASE_URL": settings.url}
    command = [sys.executable, "-c", "from api.cli import main; main()", "chunk", *arguments]
    with subprocess.Popen(command, env=os.environ | named, stdout=subprocess.DEVNULL) as process:  # noqa: S603 - ours
        try:
            yield
            if process.poll() is not None:
                raise TreadwatchError(f"treadwatch chunk {arguments[0]} ended with {process.returncode}")
        finally:
            process.send_signal(signal.SIGTERM)


@contextmanager
def _every(seconds: float, do: Callable[[], None]) -> Iterator[None]:
    """Do something again and again meanwhile, in a thread."""
    ended, failed = threading.Event(), list[Exception]()

    def loop() -> None:
        try:
            while not ended.wait(seconds):
                do()
        except Exception as error:  # noqa: BLE001 - raised at the end
            failed.append(error)

    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    if failed:
        raise failed[0]


def main(arguments: Sequence[str]) -> int:
    """Measure and print; return 1 where a row falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench sustained", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long chunks come (5)")
    parser.add_argument("--journey", type=float, default=10.0, help="minutes of a chunk (10)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/sustained.md too")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="treadwatch-sustained-") as name, stoppable_server(SAFE) as server:
        folder = Path(name)
        (folder / "load").mkdir()
        found = printed(rows(folder, workload(folder / "load", 1, options.journey, server.url), options.minutes))
    command = " ".join(["python -m bench sustained", *arguments]) if options.write_docs else None
    return ended(found, "sustained", TITLE, command)
