"""The command ``python -m bench statements``: SQL statements by the size of a fleet, and by its days of history.

By size: copies of a vehicle of four wheelsets send one recording of one window each, from which alerts follow. What is
given is the difference between two sizes by the wheelsets or windows that it is made of: what one more of them costs.
``BEGIN``, which SQLite is sent and PostgreSQL is not, is not counted.
By days: four wheelsets run one window a day, and all jobs run after each day.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from api.factory import open_store, raw_store
from api.pipeline import job_context
from api.settings import Settings
from bench.digests import SCENARIOS
from bench.measuring import INGEST, Stages
from bench.report import BenchRow, RowBench
from bench.small_fleets import code_of, copies, put_copies
from bench.standing_clock import StandingClock
from estimation.values.units import DAY_NS
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import FleetReport, run_fleet
from ingest.simulator.scenario_file import load_scenario

WINDOW_S, BEGIN_NS = 120.0, 1_704_700_000_000_000_000
WHEELSETS_OF_VEHICLE, AXLE_OFFSETS = 4, (2.0, 4.5, 14.0, 16.5)
OF_ONE = (INGEST, "estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts")
REACH_OF_ONE, REACH_OF_JOB, NOT_EVERY_DAY = 8.0, 150, 20
Counts = Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Deployment:
    """A database with what receives recordings and runs the jobs."""

    settings: Settings
    storage: SqlStorage
    clock: StandingClock

    def next_day(self, recordings: Sequence[tuple[str, Path]]) -> Counts:
        """Receive recordings of vehicles and run all jobs; return the statements of ingest and of each job."""
        self.clock.at_ns += DAY_NS
        raw, stages = raw_store(self.settings), Stages()
        receiver = Receiver(self.storage, raw, default_catalogue(), self.clock, window_length_s=WINDOW_S)
        with stages.stage(INGEST):
            for vehicle, path in recordings:
                receiver.receive_file(path, vehicle)
        stages.run_jobs(replace(job_context(self.settings, self.storage), clock=self.clock))
        return stages.statements


def simulated(folder: Path, days: int) -> FleetReport:
    """Return the recordings of a vehicle of four wheelsets, one a day."""
    scenario = load_scenario(str(SCENARIOS / "frame.toml"))
    sessions, (vehicle,) = scenario.sessions, scenario.vehicles
    sessions = replace(sessions, campaigns=days, distance_between=sessions.distance_per_day)
    wheelsets = tuple(replace(one, serial=f"{one.serial}{end}") for end in "AB" for one in vehicle.wheelsets)
    vehicle = replace(vehicle, axle_offsets=AXLE_OFFSETS, wheelsets=wheelsets)
    return run_fleet(replace(scenario, sessions=sessions, vehicles=(vehicle,)), folder, workers=1)


def deployed(folder: Path, report: FleetReport) -> Deployment:
    """Return a deployment on an empty database that knows the registry."""
    settings = Settings(data_dir=folder, database_url=None, window_length_s=WINDOW_S, _env_file=None)
    upgrade(settings.url)
    storage = open_store(settings)
    with storage.write() as unit:
        load_registry(report.registry, unit, 1)
    return Deployment(settings, storage, StandingClock(BEGIN_NS))


def of_fleet(folder: Path, report: FleetReport, vehicles: int) -> Counts:
    """Return the statements of ingest and of each job, of so many vehicles that send one recording."""
    (folder / "deployed").mkdir(parents=True)
    model = report.recordings[0]
    deployment = deployed(folder / "deployed", report)
    with closing(deployment.storage):
        put_copies(deployment.storage, model.vehicle, [code_of(number) for number in range(vehicles)])
        sent = copies(folder / "recordings", model.path.read_bytes(), vehicles)
        return deployment.next_day(sent)


def of_one_more(counts: Mapping[int, Counts]) -> dict[str, float]:
    """Return what a wheelset with one window more costs each stage, from counts of fleets by their vehicles."""
    small, large = min(counts), max(counts)
    more = WHEELSETS_OF_VEHICLE * (large - small)
    return {name: (counts[large][name] - counts[small][name]) / more for name in counts[small]}


def of_days(folder: Path, report: FleetReport) -> list[Counts]:
    """Return the statements of ingest and of each job, of each day."""
    deployment = deployed(folder, report)
    with closing(deployment.storage):
        return [deployment.next_day([(recording.vehicle, recording.path)]) for recording in report.recordings]


def is_flat(of_job: Sequence[int]) -> bool:
    """Return whether the last days cost no more than the third did, but for what not every day brings."""
    third = of_job[min(2, len(of_job) - 1)]
    return max(of_job[2:], default=third) <= third + NOT_EVERY_DAY


def rows(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield the statements of one wheelset more, and those of each job by days of history."""
    wheelsets, days = options.wheelsets, options.days
    report = simulated(folder / "simulated", max(1, days))
    sizes = sorted({max(1, size // WHEELSETS_OF_VEHICLE) for size in wheelsets})
    counts = {vehicles: of_fleet(folder / str(vehicles), report, vehicles) for vehicles in sizes}
    for vehicles, executed in counts.items():
        shown = ", ".join(f"{name} {count}" for name, count in executed.items())
        yield BenchRow(f"{WHEELSETS_OF_VEHICLE * vehicles:,} wheelsets with one window each", shown, "", met=True)
    for name, each in (of_one_more(counts) if len(counts) > 1 else {}).items():
        held = name in OF_ONE
        met = not held or each <= REACH_OF_ONE
        yield BenchRow(f"one wheelset more: {name}", f"{each:.1f}", f"<= {REACH_OF_ONE:g}" if held else "", met)
    by_day = of_days(folder / "days", report)
    for name in by_day[0]:
        of_job = [executed[name] for executed in by_day]
        reach = "" if name == INGEST else f"<= {REACH_OF_JOB}, flat"
        met = not reach or (max(of_job) <= REACH_OF_JOB and is_flat(of_job))
        yield BenchRow(f"one window more after 1 to {days} days: {name}", ", ".join(map(str, of_job)), reach, met)


main = RowBench(
    "statements",
    "SQL statements by the size of a fleet and its days of history",
    __doc__ or "",
    rows,
    {"wheelsets": ([400, 4000], "of the fleets"), "days": (20, "of history")},
).run
