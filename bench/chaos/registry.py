"""Mistakes in the registry, made at random and corrected: what is derived is as if they had never been made."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import psycopg
import sqlalchemy
from psycopg import sql

from api.pipeline import job_context, receiver, scheduled_jobs
from api.settings import Settings
from bench.chaos.part import ChaosSettings
from bench.chaos.registry_mistakes import MISTAKES, RESTORED
from bench.report import BenchRow
from bench.standing_clock import StandingClock
from estimation.jobs.job import run_job
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.packed_values import pack_bin_table, pack_geometry, pack_value
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import FleetReport, run_fleet
from ingest.simulator.scenario_file import load_scenario
from ingest.vehicle_class_schema import class_of_package
from tests.postgres_server import PostgresServer, stoppable_server

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
WINDOW_S = 30.0
AFTERWARDS_NS = 1_710_500_000_000_000_000
"""Our time, some days behind the last campaign."""

SHORT = 4
"""Up to so many mistakes no PostgreSQL server is started for them."""

FOUND_LATE = 0.8
"""Share of the mistakes that are found after they have had their effect."""


@dataclass(frozen=True)
class Deployment:
    """A database with its files, on which everything runs for real."""

    settings: Settings
    storage: SqlStorage
    clock: StandingClock
    receiver: Receiver
    registry: Path

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


def deployment(folder: Path, url: str, report: FleetReport) -> Deployment:
    """Return a deployment that knows the registry, with the recordings of a fleet received and estimated.

    Args:
        url: Its empty database.
    """
    folder.mkdir()
    upgrade(url)
    found = _opened(folder, url, report.registry, AFTERWARDS_NS)
    found.load()
    found.receiver.reassembler.work_off()
    for item in report.recordings:
        found.receiver.receive_file(item.path, item.vehicle)
    found.to_rest()
    return found


def _opened(folder: Path, url: str, registry: Path, now_ns: int) -> Deployment:
    settings = Settings(data_dir=folder, database_url=url, window_length_s=WINDOW_S, _env_file=None)
    storage = SqlStorage(database_engine(url), folder, class_of_package)
    clock = StandingClock(now_ns)
    return Deployment(settings, storage, clock, receiver(settings, storage, clock), registry)


def sqlite_url(folder: Path) -> str:
    """Return the URL of the SQLite database in a folder."""
    return f"sqlite:///{folder / 'treadwatch.sqlite3'}"


def derived(storage: SqlStorage) -> Mapping[str, object]:
    """Return all that is derived and served: windows, tables, positions, geometries, trends, open alerts.

    Times of recording and numbers of versions are left out, and a result of no window counts as none.
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
            found[f"trend {serial}"] = None if trend is None else (trend.baseline, _digest(pack_value(trend.trend)))
        found["alerts"] = sorted((a.wheelset or "", a.kind, str(a.severity)) for a in unit.alerts.all_open())
    return found


def _digest(blob: bytes) -> str:
    return hashlib.sha256(blob).hexdigest()


@dataclass(frozen=True, slots=True)
class Corrected:
    """A round: the mistake, whether it showed before it was corrected (None: no job ran), what is not as never made."""

    number: int
    name: str
    showed: bool | None
    wrong: tuple[str, ...]

    def __str__(self) -> str:
        """Return the round with what is wrong."""
        return f"round {self.number}: {', '.join(self.wrong)}"


def differing(expected: Mapping[str, object], now: Mapping[str, object]) -> tuple[str, ...]:
    """Return the names of what is derived and not the same."""
    return tuple(sorted(name for name in expected.keys() | now.keys() if expected.get(name) != now.get(name)))


def corrected(found: Deployment, number: int, rng: np.random.Generator, expected: Mapping[str, object]) -> Corrected:
    """Make one mistake, correct it, and return what is not as before.

    Args:
        number: Of the round, from 0; it decides which mistake.
        expected: What is derived where it was never made.
    """
    mistake = MISTAKES[number % len(MISTAKES)]
    with found.storage.write() as unit:
        undo = mistake(unit, rng)
    showed = None
    if rng.random() < FOUND_LATE:
        found.to_rest()
        showed = bool(differing(expected, derived(found.storage)))
    with found.storage.write() as unit:
        for step in undo:
            step(unit)
    if mistake not in RESTORED:
        found.load()
    found.to_rest()
    return Corrected(number, mistake.__name__, showed, differing(expected, derived(found.storage)))


def rounds(
    settings: ChaosSettings, numbers: Sequence[int], report: FleetReport, server: PostgresServer | None = None
) -> Iterator[Corrected]:
    """Make mistakes one after another; one that leaves something wrong is followed by another deployment.

    Args:
        server: Where the databases are; without one they are SQLite files.
    """
    settings.folder.mkdir()
    never = settings.folder / "never"
    reference = deployment(never, _new_database(never, server, "template0"), report)
    with closing(reference.storage):
        expected = derived(reference.storage)
    for number in numbers:
        if number == numbers[0]:
            found = _copied(reference, settings.folder / "mistaken-0", server)
        rng = np.random.default_rng((settings.seed, number))
        one = corrected(found, number, rng, expected)
        yield one
        if one.wrong:
            found.storage.close()
            found = _copied(reference, settings.folder / f"mistaken-{number + 1}", server)
    found.storage.close()


def _copied(reference: Deployment, folder: Path, server: PostgresServer | None) -> Deployment:
    """Return a deployment with the files and the database of another, which is closed."""
    shutil.copytree(reference.settings.data_dir, folder)
    return _opened(folder, _new_database(folder, server, "never"), reference.registry, reference.clock.at_ns)


def _new_database(folder: Path, server: PostgresServer | None, template: str) -> str:
    """Return the URL of the database of a folder; on a server it is made from a template."""
    if server is None:
        return sqlite_url(folder)
    names = sql.Identifier(folder.name), sql.Identifier(template)
    with psycopg.connect(server.url, autocommit=True) as connection:
        connection.execute(sql.SQL("CREATE DATABASE {} TEMPLATE {}").format(*names))
    url = sqlalchemy.make_url(server.url).set(drivername="postgresql", database=folder.name)
    return url.render_as_string(hide_password=False)


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Make mistakes, correct them, and compare with a state in which they were never made.

    Args:
        settings: ``size`` is the number of mistakes, half of them on each database; few are made on SQLite alone.
    """
    scenario = settings.folder / "scenario.toml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    report = run_fleet(load_scenario(scenario), settings.folder / "recordings", workers=1)
    half = settings.size if settings.size <= SHORT else settings.size // 2
    outcomes = list(rounds(replace(settings, folder=settings.folder / "sqlite"), range(half), report))
    if half < settings.size:
        apart = replace(settings, folder=settings.folder / "postgresql")
        with stoppable_server() as server:
            outcomes += rounds(apart, range(half, settings.size), report, server)
    late = [one for one in outcomes if one.showed is not None]
    silent = [f"round {one.number}, {one.name}" for one in late if not one.showed]
    shown = "; ".join((f"{len(late) - len(silent)} of {len(late)}", *silent))
    yield BenchRow("mistakes that showed before they were corrected", shown, "all", not silent)
    for name in dict.fromkeys(one.name for one in outcomes):
        yield _row(f"corrected: {name}", [one for one in outcomes if one.name == name])
    yield _row("mistakes in the registry, corrected, sqlite", outcomes[:half])
    if half < settings.size:
        yield _row("mistakes in the registry, corrected, postgresql", outcomes[half:])


def _row(what: str, outcomes: Sequence[Corrected]) -> BenchRow:
    wrong = [one for one in outcomes if one.wrong]
    measured = f"{len(outcomes) - len(wrong)} of {len(outcomes)} as never made"
    return BenchRow(what, "; ".join((measured, *map(str, wrong))), "all as never made", not wrong)
