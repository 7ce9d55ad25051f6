"""The command ``python -m bench section_runs``: a section that vehicles keep coming back to, run by run.

Nobody has surveyed the section. After each journey all jobs run, as on the schedule of a deployment whose vehicles
come one after the other, and once more when none comes any more. Counted are the estimations of each window over its
life, and the processor time of a window from the first runs to the last; the exponent is the slope of the logarithm of
all time so far against the logarithm of all windows so far.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from api.comparison.trial import Recorded, deploy, opened, receive, record
from api.factory import open_store
from api.settings import Settings
from bench.report import BenchRow, printed
from bench.results_page import ended
from bench.worker_load import fleet
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import run_job
from estimation.values.runs import JobTrigger
from ingest.simulator.scenario_file import read_scenario

TITLE = "A section over many runs"
REACH_ESTIMATIONS, REACH_EXPONENT = 1.3, 1.05
QUIET_S = 600.0  # interval of the job of the alignment
FEWEST_RUNS = 2  # that an exponent needs
FIRST_RUNS = 5  # left out of the exponent: they compile, and there is no alignment yet


@dataclass(frozen=True, slots=True)
class Run:
    """One journey: its windows, what was estimated, and processor time by job, s."""

    windows: int
    estimated: int
    cpu_s: dict[str, float]


def runs(folder: Path, vehicles: int, campaigns: int, minutes: float) -> Iterator[Run]:
    """Yield what each journey costs when all jobs follow it.

    Args:
        vehicles, campaigns, minutes: Vehicles of four wheelsets, journeys of each, and how long one takes.
    """
    file = folder / "scenario.toml"
    file.write_text(fleet(vehicles, minutes, campaigns=campaigns, surveyed=False), encoding="utf-8")
    scenario = read_scenario(file)
    recorded = record(scenario, folder / "recordings", workers=2)
    settings = deploy(scenario, folder / "deployed")
    known = 0
    for recording in recorded.recordings:
        cpu_s: dict[str, float] = {}
        begin_s = time.process_time()
        receive(Recorded((recording,), recorded.truth), settings)
        cpu_s["ingest"] = time.process_time() - begin_s
        last = recording is recorded.recordings[-1]
        estimated = sum(_run_jobs(settings, cpu_s, quiet_s) for quiet_s in ((QUIET_S, 0.0) if last else (QUIET_S,)))
        with closing(open_store(settings)) as storage, storage.read() as unit:
            total = sum(unit.windows.counts().values())
        yield Run(total - known, estimated, cpu_s)
        known = total


def _run_jobs(settings: Settings, cpu_s: dict[str, float], quiet_s: float) -> int:
    """Run all jobs once, add what they took, and return how many windows were estimated."""
    estimated = 0
    with opened(settings) as (_, plain):
        context = replace(plain, quiet_s=quiet_s)
        for job in ALL_JOBS:
            begin_s = time.process_time()
            found = run_job(job, context, JobTrigger.CLI)
            if found.error is not None:
                raise TreadwatchError(f"{found.job}: {found.error}")
            cpu_s[job.name] = cpu_s.get(job.name, 0.0) + time.process_time() - begin_s
            estimated += found.counts.get("estimated", 0)
    return estimated


def rows(folder: Path, vehicles: int, campaigns: int, minutes: float) -> Iterator[BenchRow]:
    """Yield estimations per window, and how the cost of a window grows with the runs."""
    found = []
    console = Console(stderr=True)
    for one in runs(folder, vehicles, campaigns, minutes):
        found.append(one)
        spent = sum(one.cpu_s.values())
        console.print(f"run {len(found)}: {one.windows} windows, {one.estimated} estimated, {spent:.1f} CPU s")
    windows = sum(one.windows for one in found)
    each = sum(one.estimated for one in found) / windows
    what = f"{vehicles * 4} wheelsets, {len(found)} runs, {windows} windows"
    reach = f"<= {REACH_ESTIMATIONS}"
    yield BenchRow(f"{what}: estimations a window", f"{each:.2f}", reach, each <= REACH_ESTIMATIONS)
    for name in [*found[0].cpu_s, "all of it"]:
        yield _growth(what, name, found)


def _growth(what: str, name: str, found: Sequence[Run]) -> BenchRow:
    """Return the cost of a window, ms, in the first and second half of the runs, and its growth."""
    spent = np.array([sum(one.cpu_s.values()) if name == "all of it" else one.cpu_s[name] for one in found])
    windows = np.array([one.windows for one in found])
    half = len(found) // 2
    first, second = (1e3 * float(spent[part].sum() / windows[part].sum()) for part in (slice(half), slice(half, None)))
    kept = slice(FIRST_RUNS, None)
    exponent = float(np.polyfit(np.log(np.cumsum(windows)[kept]), np.log(np.cumsum(spent)[kept]), 1)[0])
    shown = f"{first:.1f} ms a window in the first half, {second:.1f} in the second, exponent {exponent:.2f}"
    whole = name == "all of it"
    return BenchRow(
        f"{what}: {name}",
        shown,
        f"exponent <= {REACH_EXPONENT}" if whole else "",
        met=not whole or exponent <= REACH_EXPONENT,
    )


def main(arguments: Sequence[str]) -> int:
    """Measure and print; return 1 where a row falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench section_runs", description=TITLE)
    parser.add_argument("--vehicles", type=int, default=10, help="of four wheelsets (10)")
    parser.add_argument("--campaigns", type=int, default=5, help="journeys of each vehicle (5)")
    parser.add_argument("--minutes", type=float, default=5.0, help="of a journey (5)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/section_runs.md")
    options = parser.parse_args(arguments)
    if options.vehicles * options.campaigns < FIRST_RUNS + FEWEST_RUNS:
        parser.error(f"{FIRST_RUNS + FEWEST_RUNS} journeys of all vehicles or more are needed for an exponent")
    with tempfile.TemporaryDirectory(prefix="treadwatch-section-runs-") as folder:
        found = printed(rows(Path(folder), options.vehicles, options.campaigns, options.minutes))
    command = " ".join(["python -m bench section_runs", *arguments]) if options.write_docs else None
    return ended(found, "section_runs", TITLE, command)
