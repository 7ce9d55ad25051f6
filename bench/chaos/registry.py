"""Mistakes in the registry, made at random and corrected: what is derived is as if they had never been made."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from api.factory import job_context, receiver, scheduled_jobs
from api.settings import Settings
from bench.chaos.part import ChaosSettings
from bench.report import BenchRow
from estimation.jobs.job import run_job
from estimation.values.registry import Mounting, Reprofiling
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.packed_values import pack_bin_table, pack_geometry, pack_trend
from fleet_db.registry_events import Decision, RecordKind
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import FleetReport, run_fleet
from ingest.simulator.scenario_file import load_scenario
from ingest.vehicle_class_file import class_of_package

SCENARIO = """\
name = "registry"
description = "one vehicle, two wheelsets, a reprofiling"
seed = 23

[fleet]
code = "C"
name = "Chaos"

[dynamics]
load = 12263.0

[section]
code = "C-3"
number = 3
name = "Section"
length_m = 3000.0
alignment_std_mm = 2.0
survey_alignment_std_mm = 0.05

[speed]
lowest_m_s = 15.0
highest_m_s = 25.0

[sensors]
kind = "mems"

[bus]
recorder_clock_offset_s = 1.5

[sessions]
start = 2024-01-08T05:30:00Z
campaigns = 2
minutes_each = 1.5
first_odometer_km = 1000.0
km_between = 30000.0
km_per_day = 500.0

[[vehicles]]
code = "C-1"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5]

[[vehicles.wheelsets]]
serial = "C-A"
wear_mm_per_100000_km = 1.2

[[vehicles.wheelsets]]
serial = "C-B"
initial_wear_mm = 2.4
initial_mileage_km = 250000.0
"""
SECTION, VEHICLE = "C-3", "C-1"
WINDOW_S = 30.0
HOUR_NS = 3_600_000_000_000
AFTERWARDS_NS = 1_710_500_000_000_000_000
"""Our time, some days behind the last campaign."""

FOUND_LATE = 0.8
"""Share of the mistakes that are found after they have had their effect."""

UNDONE = Decision("chaos", "a mistake")


@dataclass(slots=True)
class StandingClock:
    """Goes on by a millisecond at each look."""

    at_ns: int

    def now_ns(self) -> int:
        """Return nanoseconds UTC."""
        self.at_ns += 1_000_000
        return self.at_ns


Undo = Callable[[SqlUnitOfWork], None]


@dataclass(frozen=True)
class Deployment:
    """A database with its files, on which everything runs for real."""

    settings: Settings
    storage: SqlStorage
    clock: StandingClock
    receiver: Receiver
    registry: Path
    counts: dict[str, int] = field(default_factory=dict)

    def to_rest(self) -> None:
        """Run all jobs twice: alerts follow what the first run found."""
        context = replace(job_context(self.settings, self.storage), clock=self.clock)
        for job in (*scheduled_jobs(self.settings), *scheduled_jobs(self.settings)):
            run = run_job(job, context, JobTrigger.CLI)
            if run.outcome is not JobOutcome.SUCCEEDED:
                raise RuntimeError(f"job {run.job}: {run.error}")

    def load(self) -> None:
        """Load the registry file, which is right."""
        with self.storage.write() as unit:
            load_registry(self.registry, unit, self.clock.now_ns())


def deployment(folder: Path, report: FleetReport) -> Deployment:
    """Return a deployment that knows the registry, with the recordings of a fleet received and estimated.

    Parameters
    ----------
    folder
        Its own.
    report
        What the simulator wrote.
    """
    folder.mkdir()
    url = f"sqlite:///{folder / 'treadwatch.sqlite3'}"
    upgrade(url)
    settings = Settings(data_dir=folder, database_url=url, window_length_s=WINDOW_S, _env_file=None)
    storage = SqlStorage(database_engine(url), folder, class_of_package)
    clock = StandingClock(AFTERWARDS_NS)
    found = Deployment(settings, storage, clock, receiver(settings, storage, clock), report.registry)
    found.load()
    found.receiver.reassembler.work_off()
    for item in report.recordings:
        found.receiver.receive_file(item.path, item.vehicle)
    found.to_rest()
    return found


def derived(storage: SqlStorage) -> Mapping[str, object]:
    """Return all that is derived and served: windows, tables, positions, geometries, trends, open alerts.

    Times of recording and numbers of versions are left out, and a result of no window counts as none.

    Parameters
    ----------
    storage
        Of a deployment at rest.
    """
    found: dict[str, object] = {}
    with storage.read() as unit:
        for wheelset in unit.registry.wheelsets():
            serial = wheelset.serial
            found[f"windows {serial}"] = [
                (w.start_ns, w.axle, w.track_section, w.mileage_km, w.content_digest, w.state, w.reason)
                for w in unit.windows.list(serial)
            ]
            found[f"tables {serial}"] = [
                (w.start_ns, _digest(pack_bin_table(table))) for w, table, _ in unit.tables.stream(serial, 0, None)
            ]
            places = [unit.tracks.position(serial, w.start_ns) for w in unit.windows.list(serial)]
            found[f"positions {serial}"] = [
                None if one is None else (one.offset_m, one.scale, one.reason, one.content_digest) for one in places
            ]
            current = unit.geometries.current(serial)
            records = [*unit.geometries.intervals(serial), *([] if current is None else [current])]
            found[f"geometries {serial}"] = [
                (r.baseline, r.interval, r.mileage_km, r.from_ns, r.to_ns, _digest(pack_geometry(r.geometry)))
                for r in records
                if r.geometry.windows
            ]
            trend = unit.trends.latest(serial)
            found[f"trend {serial}"] = None if trend is None else (trend.baseline, _digest(pack_trend(trend.trend)))
        found["alerts"] = sorted((a.wheelset or "", a.kind, str(a.severity)) for a in unit.alerts.all_open())
    return found


def _digest(blob: bytes) -> str:
    return hashlib.sha256(blob).hexdigest()


def _mounting(unit: SqlUnitOfWork, serial: str) -> Mounting:
    return unit.registry.mountings(serial)[0]


def _void(kind: RecordKind, subject: str, at_ns: int | None = None) -> Undo:
    return lambda unit: void(unit, RecordKey(kind, subject, at_ns))


def void(unit: SqlUnitOfWork, key: RecordKey) -> None:
    """Void a record."""
    unit.corrections.void(key, UNDONE)


def swapped(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:  # noqa: ARG001 - as every mistake
    """Enter two wheelsets under each other's name; the right file puts it right."""
    first, second = _mounting(unit, "C-A"), _mounting(unit, "C-B")
    unit.registry.add_mountings([replace(first, axle=second.axle), replace(second, axle=first.axle)])
    return []


def turned_round(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter a wheelset the other way round."""
    was = _mounting(unit, str(rng.choice(["C-A", "C-B"])))
    unit.registry.add_mounting(replace(was, reversed=not was.reversed))
    return []


def other_mileage(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter another mileage of a wheelset."""
    was = _mounting(unit, str(rng.choice(["C-A", "C-B"])))
    unit.registry.add_mounting(
        replace(was, wheelset_mileage_km=was.wheelset_mileage_km + float(rng.integers(1, 90000)))
    )
    return []


def ended_early(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """End a mounting between two campaigns, and mount the wheelset again at the wrong axle."""
    was = _mounting(unit, str(rng.choice(["C-A", "C-B"])))
    end_ns = was.from_ns + int(rng.integers(1, 40)) * 24 * HOUR_NS
    unit.registry.add_mounting(replace(was, to_ns=end_ns))
    other = replace(was, from_ns=end_ns, reversed=bool(rng.integers(2)))
    unit.registry.add_mounting(other)
    return [_void(RecordKind.MOUNTING, other.wheelset, end_ns)]


def forgotten(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Take a mounting out that was right."""
    was = _mounting(unit, str(rng.choice(["C-A", "C-B"])))
    key = RecordKey(RecordKind.MOUNTING, was.wheelset, was.from_ns)
    void(unit, key)
    return [lambda unit: _restored(unit, key)]


def never_reprofiled(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter a reprofiling that never was."""
    was = _mounting(unit, str(rng.choice(["C-A", "C-B"])))
    at_ns = was.from_ns + int(rng.integers(1, 40)) * 24 * HOUR_NS
    unit.registry.add_reprofiling(Reprofiling(was.wheelset, at_ns, was.wheelset_mileage_km + 15_000.0))
    return [_void(RecordKind.REPROFILING, was.wheelset, at_ns)]


def other_radius(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter another nominal radius."""
    was = unit.registry.wheelset(str(rng.choice(["C-A", "C-B"])))
    unit.registry.add_wheelset(replace(was, nominal_radius_m=was.nominal_radius_m - 0.02, mounting=None), 1)
    return []


def other_offsets(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter axles at other places."""
    was = unit.registry.vehicle(VEHICLE)
    moved = tuple(offset + float(rng.uniform(0.5, 3.0)) for offset in was.axle_offsets_m)
    unit.registry.add_vehicle(replace(was, axle_offsets_m=moved), 1)
    return []


def other_number(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter the section under another number."""
    unit.tracks.add_section(replace(unit.tracks.section(SECTION), number=int(rng.integers(100, 999))))
    return []


def no_section(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:  # noqa: ARG001 - as every mistake
    """Void the section."""
    key = RecordKey(RecordKind.SECTION, SECTION)
    void(unit, key)
    return [lambda unit: _restored(unit, key)]


def _restored(unit: SqlUnitOfWork, key: RecordKey) -> None:
    unit.corrections.restore(key, UNDONE)


MISTAKES = (
    swapped,
    never_reprofiled,
    turned_round,
    other_mileage,
    ended_early,
    forgotten,
    other_radius,
    other_offsets,
    other_number,
    no_section,
)


@dataclass(frozen=True, slots=True)
class Corrected:
    """A mistake, whether it showed before it was corrected (None where no job ran), and what is not as it was."""

    name: str
    showed: bool | None
    wrong: tuple[str, ...]


def _mistaken(found: Deployment, size: int, seed: int, expected: Mapping[str, object]) -> Iterator[Corrected]:
    """Make mistakes and correct them."""
    rng = np.random.default_rng(seed)
    for number in range(size):
        mistake = MISTAKES[number % len(MISTAKES)]
        with found.storage.write() as unit:
            undo = mistake(unit, rng)
        showed = None
        if rng.random() < FOUND_LATE:
            found.to_rest()
            showed = derived(found.storage) != expected
        with found.storage.write() as unit:
            for step in undo:
                step(unit)
        found.load()
        found.to_rest()
        now = derived(found.storage)
        wrong = tuple(name for name, value in expected.items() if now[name] != value)
        yield Corrected(mistake.__name__, showed, wrong)


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Make mistakes, correct them, and compare with a state in which they were never made.

    Parameters
    ----------
    settings
        ``size`` is the number of mistakes.
    """
    scenario = settings.folder / "scenario.toml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    report = run_fleet(load_scenario(scenario), settings.folder / "recordings", workers=1)
    found = deployment(settings.folder / "mistaken", report)
    with closing(found.storage):
        expected = derived(found.storage)
        outcomes = list(_mistaken(found, settings.size, settings.seed, expected))
    wrong = [f"{one.name}: {', '.join(one.wrong)}" for one in outcomes if one.wrong]
    late = [one for one in outcomes if one.showed is not None]
    silent = [one.name for one in late if not one.showed]
    shown = f"{len(late) - len(silent)} of {len(late)}" + "".join(f"; {name}" for name in silent)
    yield BenchRow("mistakes that showed before they were corrected", shown, "all", not silent)
    measured = f"{len(outcomes) - len(wrong)} of {len(outcomes)} as never made" + "".join(f"; {one}" for one in wrong)
    yield BenchRow("mistakes in the registry, corrected", measured, "all as never made", not wrong)
