"""The command ``python -m bench fleet_sizes``: what a wheelset costs in small and in large fleets.

Each vehicle of four wheelsets sends one recording of a journey on one surveyed section, which all share; from the
recordings to alerts, stage by stage, processor time is counted. The vehicles are copies of one, on file and in their
recordings under names of their own. The exponent is the slope of the logarithm of the cost against that of the number
of wheelsets: at 1 a wheelset costs the same in any fleet.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from api.comparison.trial import Recorded, opened, receive
from api.factory import open_store
from bench.process_tree import cpu_of_tree
from bench.report import BenchRow, printed
from bench.results_page import ended
from bench.sustained import APPLICATION_AT
from bench.worker_load import Workload, workload
from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import run_job
from estimation.values.runs import JobTrigger
from fleet_db.storage import SqlStorage

TITLE = "Cost of a wheelset by the size of the fleet"
AXLES, REACH_EXPONENT = 4, 1.05
VEHICLES = (10, 100, 1000)


@dataclass(frozen=True, slots=True)
class Spent:
    """What a fleet took: CPU s by stage, and how many windows it has."""

    wheelsets: int
    windows: int
    cpu_s: Mapping[str, float]

    @property
    def whole_s(self) -> float:
        """CPU s of all stages."""
        return sum(self.cpu_s.values())


def rows(folder: Path, load: Workload, sizes: Sequence[int]) -> Iterator[BenchRow]:
    """Yield what a window costs in fleets of different sizes, and the exponents.

    Args:
        load: A deployment of one vehicle, whose last recording is copied.
    """
    found = []
    for vehicles in sizes:
        one = _spent(folder / str(vehicles), load, vehicles)
        found.append(one)
        shown = f"{1e3 * one.whole_s / one.windows:.1f} CPU ms a window of a minute: " + ", ".join(
            f"{name} {1e3 * spent / one.windows:.1f}" for name, spent in one.cpu_s.items()
        )
        yield BenchRow(f"{one.wheelsets:,} wheelsets, {one.windows:,} windows", shown, "", met=True)
    for name in found[0].cpu_s:
        yield BenchRow(f"exponent of {name}", f"{_exponent(found, name):.3f}", "", met=True)
    whole = _exponent(found, None)
    what = f"exponent of all of it, {found[0].wheelsets} to {found[-1].wheelsets:,} wheelsets"
    yield BenchRow(what, f"{whole:.3f}", f"<= {REACH_EXPONENT}", whole <= REACH_EXPONENT)


def _exponent(found: Sequence[Spent], name: str | None) -> float:
    cost = [one.whole_s if name is None else one.cpu_s[name] for one in found]
    return float(np.polyfit(np.log([one.wheelsets for one in found]), np.log(cost), 1)[0])


def _spent(folder: Path, load: Workload, vehicles: int) -> Spent:
    """Return what the recordings of so many vehicles took until alerts, with everything compiled before."""
    settings, cpu_s = load.copy(folder / "deployed"), dict[str, float]()
    model, path = load.recordings[-1]
    with closing(open_store(settings)) as storage:
        register(storage, model, vehicles)
    recordings = Recorded(tuple(copies(folder / "recordings", path.read_bytes(), vehicles)), load.received.data_dir)
    with opened(settings) as (storage, context):
        for job in ALL_JOBS:
            run_job(job, context, JobTrigger.CLI)
        with storage.read() as unit:
            known = sum(unit.windows.counts().values())
        begin_s = cpu_of_tree()
        receive(recordings, settings)
        cpu_s["ingest"] = cpu_of_tree() - begin_s
        for job in ALL_JOBS:
            begin_s = cpu_of_tree()
            run = run_job(job, context, JobTrigger.CLI)
            if run.error is not None:
                raise TreadwatchError(f"{run.job}: {run.error}")
            cpu_s[job.name] = cpu_of_tree() - begin_s
        with storage.read() as unit:
            windows = sum(unit.windows.counts().values()) - known
    return Spent(AXLES * vehicles, windows, cpu_s)


def register(storage: SqlStorage, model: str, vehicles: int) -> None:
    """Put copies of a vehicle with its wheelsets on file."""
    with storage.write() as unit:
        like = unit.registry.vehicle(model)
        mounted = [one for one in unit.registry.wheelsets() if one.mounting and one.mounting.vehicle == model]
        for number in range(vehicles):
            code = _code(number)
            unit.registry.add_vehicle(replace(like, code=code))
            for wheelset in mounted:
                assert wheelset.mounting is not None
                serial = f"{code}-{wheelset.mounting.axle}"
                own = replace(wheelset.mounting, wheelset=serial, vehicle=code)
                unit.registry.add_wheelset(replace(wheelset, serial=serial, mounting=own))
            unit.stale_spans.remove(unit.stale_spans.all(code))  # it has no recording yet


def copies(folder: Path, content: bytes, vehicles: int) -> Iterator[tuple[str, Path]]:
    """Yield vehicles with copies of a recording, each with a digest of its own."""
    folder.mkdir()
    for number in range(vehicles):
        own = bytearray(content)
        own[APPLICATION_AT : APPLICATION_AT + 4] = number.to_bytes(4, "little")
        path = folder / f"{number:05d}.blf"
        path.write_bytes(own)
        yield _code(number), path


def _code(number: int) -> str:
    return f"C-{number:05d}"


def main(arguments: Sequence[str]) -> int:
    """Measure and print; return 1 where a row falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench fleet_sizes", description=TITLE)
    parser.add_argument("--vehicles", type=int, nargs="+", default=list(VEHICLES), help="of four wheelsets, by fleet")
    parser.add_argument("--minutes", type=float, default=3.0, help="of a journey (3)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/fleet_sizes.md")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="treadwatch-fleet-sizes-") as name:
        folder = Path(name)
        (folder / "load").mkdir()
        found = printed(rows(folder, workload(folder / "load", 1, options.minutes), sorted(options.vehicles)))
    command = " ".join(["python -m bench fleet_sizes", *arguments]) if options.write_docs else None
    return ended(found, "fleet_sizes", TITLE, command)
