"""What a fleet costs that grows: ``python -m bench fleet_sizes`` or ``section_runs``.

``fleet_sizes``: each vehicle of four wheelsets sends one recording of a journey on one surveyed section. The vehicles
are copies of one, on file and in their recordings under names of their own. The exponent is the slope of the logarithm
of the cost against that of the number of wheelsets: at 1 a wheelset costs the same in any fleet. What one wheelset more
costs in statements is the difference of two sizes by their wheelsets. The idle run is one of all jobs when they find
nothing to do any more.

``section_runs``: nobody has surveyed the section. After each journey all jobs run, as on the schedule of a deployment
whose vehicles come one after the other, and once more when none comes any more. Counted are the estimations of each
window over its life, and the processor time of a window from the first runs to the last; the exponent is that of all
time so far against all windows so far.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from api.comparison.trial import Recorded, opened
from bench.counting import run_all
from bench.measuring import INGEST, Stages, exponent
from bench.report import BenchRow, row_bench, say
from bench.small_fleets import (
    FOUR_AXLES,
    Workload,
    cars,
    code_of,
    copies,
    deployed,
    put_copies_into,
    small_fleet,
    workload,
)
from bench.standing_clock import StandingClock
from estimation.errors import TreadwatchError
from estimation.jobs.job import JobContext

AXLES = 4
REACH_ESTIMATIONS, REACH_EXPONENT = 1.3, 1.05
OF_ONE = (INGEST, "estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts")
REACH_OF_ONE = 8.0  # statements
REACH_IDLE_S, REACH_IDLE = 0.35, 40
NOW_NS = 1_704_900_000_000_000_000  # two days after the first journey
MOST_RUNS = 6
"""After so many runs of all jobs there is nothing to do any more."""

STATE = {"wheelsets", "sections", "unchanged", "without_limit", "quarantined"}
"""Counts of what is there; all others count what was done."""

QUIET_S = 600.0  # interval of the job of the alignment
FIRST_RUNS = 5  # left out of the exponent: they compile, and there is no alignment yet
FEWEST_RUNS = FIRST_RUNS + 2
Counts = Mapping[str, int]


def _fleet_sizes(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    load, sizes = workload(folder / "load", 1, options.minutes), sorted(options.vehicles)
    found = []
    for vehicles in sizes:
        of_fleet, idle = costs(folder / str(vehicles), load, vehicles)
        found.append(of_fleet)
        shown = f"{1e3 * of_fleet.whole_s / of_fleet.windows:.1f} CPU ms a window of a minute: " + ", ".join(
            f"{name} {1e3 * spent / of_fleet.windows:.1f}" for name, spent in of_fleet.cpu_s.items()
        )
        yield BenchRow(f"{AXLES * vehicles:,} wheelsets, {of_fleet.windows:,} windows", shown, "", met=True)
        statements = idle.statements.total()
        met = idle.whole_s < REACH_IDLE_S and statements <= REACH_IDLE
        shown, reach = f"{idle.whole_s:.2f} CPU s, {statements} statements", f"< {REACH_IDLE_S} CPU s, <= {REACH_IDLE}"
        yield BenchRow(f"{AXLES * vehicles:,} wheelsets: idle run of all jobs", shown, reach, met)
    for name in found[0].cpu_s:
        power = exponent(sizes, [one.cpu_s[name] for one in found])
        yield BenchRow(f"exponent of {name}", f"{power:.3f}", "", met=True)
    whole = exponent(sizes, [one.whole_s for one in found])
    what = f"exponent of all of it, {AXLES * sizes[0]} to {AXLES * sizes[-1]:,} wheelsets"
    yield BenchRow(what, f"{whole:.3f}", f"<= {REACH_EXPONENT}", whole <= REACH_EXPONENT)
    if len(sizes) > 1:
        each = of_one_more(dict(zip(sizes, (one.statements for one in found), strict=True)))
        shown = ", ".join(f"{name} {statements:.1f}" for name, statements in each.items())
        met = all(each[name] <= REACH_OF_ONE for name in OF_ONE)
        yield BenchRow("statements of one wheelset more", shown, f"<= {REACH_OF_ONE:g}, {', '.join(OF_ONE)}", met)


def costs(folder: Path, load: Workload, vehicles: int) -> tuple[Stages, Stages]:
    """Return what the recordings of so many vehicles take until alerts, with everything compiled before; and idle."""
    folder.mkdir()
    settings, stages, idle = load.copy(folder / "deployed"), Stages(), Stages()
    model, path = load.recordings[-1]
    put_copies_into(settings, model, [code_of(number) for number in range(vehicles)])
    recorded = Recorded(copies(folder / "recordings", path.read_bytes(), vehicles), load.received.data_dir)
    with opened(settings) as (storage, plain):
        context = replace(plain, clock=StandingClock(NOW_NS))
        run_all(context)
        stages.measure(storage, context, settings, recorded)
        _run_until_nothing_is_done(context)
        idle.run_jobs(context)
    return stages, idle


def _run_until_nothing_is_done(context: JobContext) -> None:
    for _ in range(MOST_RUNS):
        done = Counter({name: count for name, count in run_all(context).items() if name not in STATE})
        if not +done:
            return
    raise TreadwatchError(f"after {MOST_RUNS} runs the jobs still do something: {dict(+done)}")


def of_one_more(counts: Mapping[int, Counts]) -> dict[str, float]:
    """Return the statements of each stage for one wheelset more, from those of fleets by their vehicles."""
    small, large = min(counts), max(counts)
    more = AXLES * (large - small)
    return {name: (counts[large][name] - counts[small][name]) / more for name in counts[small]}


def _section_runs(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    if options.vehicles * options.campaigns < FEWEST_RUNS:
        raise SystemExit(f"{FEWEST_RUNS} journeys of all vehicles or more are needed for an exponent")
    found = []
    for stages in runs(folder, options.vehicles, options.campaigns, options.minutes):
        found.append(stages)
        say(f"run {len(found)}: {stages.windows} windows, {stages.estimated} estimated, {stages.whole_s:.1f} CPU s")
    windows = sum(stages.windows for stages in found)
    each = sum(stages.estimated for stages in found) / windows
    what = f"{options.vehicles * AXLES} wheelsets, {len(found)} runs, {windows} windows"
    reach = f"<= {REACH_ESTIMATIONS}"
    yield BenchRow(f"{what}: estimations a window", f"{each:.2f}", reach, each <= REACH_ESTIMATIONS)
    for name in [*found[0].cpu_s, "all of it"]:
        yield _growth(what, name, found)


def runs(
    folder: Path, vehicles: int, campaigns: int, minutes: float, *, surveyed: bool = False, quiet_s: float = QUIET_S
) -> Iterator[Stages]:
    """Yield what each journey costs when all jobs follow it, the last one with what was waited with."""
    fleet = small_fleet("K", cars(vehicles), FOUR_AXLES, minutes, campaigns=campaigns, surveyed=surveyed)
    load = deployed(folder, fleet)
    for recording in load.recordings:
        stages = Stages()
        with opened(load.received) as (storage, plain):
            context = replace(plain, quiet_s=quiet_s)
            stages.measure(storage, context, load.received, Recorded((recording,), load.received.data_dir))
        if quiet_s and recording is load.recordings[-1]:
            with opened(load.received) as (_, plain):
                stages.run_jobs(replace(plain, quiet_s=0.0))
        yield stages


def _growth(what: str, name: str, found: Sequence[Stages]) -> BenchRow:
    """Return the cost of a window, ms, in the first and second half of the runs, and its growth."""
    whole = name == "all of it"
    spent = np.array([stages.whole_s if whole else stages.cpu_s[name] for stages in found])
    windows = np.array([stages.windows for stages in found])
    half = len(found) // 2
    first, second = (1e3 * float(spent[part].sum() / windows[part].sum()) for part in (slice(half), slice(half, None)))
    power = exponent(np.cumsum(windows)[FIRST_RUNS:].tolist(), np.cumsum(spent)[FIRST_RUNS:].tolist())
    shown = f"{first:.1f} ms a window in the first half, {second:.1f} in the second, exponent {power:.2f}"
    reach = f"exponent <= {REACH_EXPONENT}" if whole else ""
    return BenchRow(f"{what}: {name}", shown, reach, met=not whole or power <= REACH_EXPONENT)


BENCHES = (
    row_bench(
        "fleet_sizes",
        "Cost of a wheelset by the size of the fleet",
        __doc__,
        _fleet_sizes,
        {"vehicles": ([10, 100, 1000], "of four wheelsets, by fleet"), "minutes": (3.0, "of a journey")},
    ),
    row_bench(
        "section_runs",
        "A section over many runs",
        __doc__,
        _section_runs,
        {
            "vehicles": (10, "of four wheelsets"),
            "campaigns": (5, "journeys of each vehicle"),
            "minutes": (5.0, "of a journey"),
        },
    ),
)
