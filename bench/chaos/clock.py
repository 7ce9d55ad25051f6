"""The server's clock is set wrong while scheduler and API run, and right again: nothing is lost, all go on."""

from __future__ import annotations

import shutil
import struct
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import httpx

from api.factory import open_store
from api.settings import Settings
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import (
    PASSWORD,
    Databases,
    compared,
    databases,
    fork,
    ingest,
    newest_run,
    recordings,
    wait_for,
)
from bench.report import BenchRow
from bench.services import free_port, started, until
from estimation.values.units import HOUR_NS

SECONDS = 45.0
SHIFTS = {"+400 days": 400 * 24 * HOUR_NS, "-1 hour": -HOUR_NS}
BACK_WITHIN_S = 60.0
CUTS = (0.25, 0.5, 0.75)
SOURCE = Path(__file__).with_name("set_clock.c")


@dataclass(frozen=True, slots=True)
class _Clock:
    """The wall clock of the processes that are started with ``environment``."""

    library: Path
    shift: Path

    @property
    def environment(self) -> Mapping[str, str]:
        return {"LD_PRELOAD": str(self.library), "TREADWATCH_CLOCK_SHIFT": str(self.shift)}

    def set(self, shift_ns: int) -> None:
        with self.shift.open("r+b") as file:
            file.write(struct.pack("=q", shift_ns))


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what each wrong clock did on each database.

    ``size`` is the number of rounds: clocks and databases in turn.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        yield BenchRow("the clock of the server set", "not run: needs a C compiler", "0 lost", met=True)
        return
    clock = _Clock(settings.folder / "set_clock.so", settings.folder / "shift")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(clock.library), str(SOURCE), "-ldl"], check=True)  # noqa: S603 - our own source
    clock.shift.write_bytes(bytes(8))
    with databases(settings.folder) as both:
        for number in range(settings.size):
            name = list(SHIFTS)[number % 2]
            yield _round(both, ("sqlite", "postgresql")[number // 2 % 2], name, clock)


def _round(both: Databases, kind: str, name: str, clock: _Clock) -> BenchRow:
    """Send pieces of a journey that has just ended before, while and after the clock is wrong."""
    begin_ns = (time.time_ns() - HOUR_NS) // HOUR_NS * HOUR_NS
    paths = recordings(both.folder / f"clock-{kind}{name}", CUTS, SECONDS, begin_ns)
    broken, alone = both.new(kind), both.new(kind)
    port, log = free_port(), both.folder / "clock.log"
    chosen = broken.model_copy(update={"jobs_every_s": 5.0, "port": port})
    command = partial(started, chosen, log=log, others=clock.environment)
    wait_for([fork(partial(ingest, broken, paths[:1]), log)])
    running = [command("schedule"), command("serve")]
    url = f"http://127.0.0.1:{port}/v1/wheelsets/WS-1/trend"
    stood = []
    try:
        stood += [] if _goes_on(broken, url, 0) else ["at the start"]
        clock.set(SHIFTS[name])
        sent = [command("ingest", "--vehicle", "N-7", str(paths[1])).wait()]
        stood += [] if _goes_on(broken, url, newest_run(broken)) else ["while the clock is wrong"]
        clock.set(0)
        sent.append(command("ingest", "--vehicle", "N-7", str(paths[2])).wait())
        stood += [] if _goes_on(broken, url, newest_run(broken)) else ["after it was set right"]
        stood += ["a process ended"] * sum(process.poll() is not None for process in running)
    finally:
        clock.set(0)
        for process in running:
            process.kill()
            process.wait()
    wrong = compared(both, broken, alone, paths, keep=True) + _of_the_future(broken)
    text = log.read_text(errors="replace")
    failed, passwords = sum(code != 0 for code in sent), text.count(PASSWORD)
    both.drop(broken)
    both.drop(alone)
    return BenchRow(
        f"{kind}, clock of the server {name} and right again: lost or other than with a right clock; stood still; "
        "ingests that failed; password in the log",
        f"{len(wrong)} {wrong}; {len(stood)} {stood}; {failed}; {passwords}",
        "0; 0; 0; 0",
        not wrong and not stood and failed == passwords == 0,
    )


def _goes_on(settings: Settings, url: str, known: int) -> bool:
    """Return whether the scheduler ended another round of the jobs and the API answers."""

    def reached() -> bool:
        if newest_run(settings) <= known + JOBS_A_ROUND:
            return False
        try:
            return httpx.get(url, timeout=5.0).status_code < httpx.codes.INTERNAL_SERVER_ERROR
        except httpx.HTTPError:
            return False

    return until(reached, BACK_WITHIN_S) is not None


JOBS_A_ROUND = 8
"""So many later runs are a round of the jobs, at least most of it."""


def _of_the_future(settings: Settings) -> list[str]:
    """Return which trends were recorded later than now."""
    with closing(open_store(settings)) as storage, storage.read() as unit:
        records = [unit.trends.latest(serial) for serial in ("WS-1", "WS-2")]
    return [f"{one.wheelset} of the future" for one in records if one and one.recorded_ns > time.time_ns()]
