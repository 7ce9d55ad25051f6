"""A fleet of one vehicle with two wheelsets, small enough for tests and run for real, from frames to alerts."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_once import made_once
from sqlalchemy import select

from api.factory import raw_store
from api.pipeline import job_context
from api.settings import Settings
from bench.standing_clock import StandingClock
from estimation.jobs.catalogue import run_all
from estimation.values.geometry import GeometryRecord
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.packed_values import pack_geometry
from fleet_db.records import ChunkRecord
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.tables import Base
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import FleetReport, Recording, run_fleet
from ingest.simulator.scenario import Scenario

WORN, DEAD = "T-WORN", "T-DEAD"
SCENARIO = f"""\
name = "tiny"
description = "one vehicle, two wheelsets, four campaigns of ninety seconds, one reprofiling, one node that dies"
seed = 11

[fleet]
code = "T"
name = "Tiny fleet"

[dynamics]
load = 12263.0

[section]
code = "T-3"
number = 3
name = "Short section"
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
campaigns = 4
minutes_each = 1.5
first_odometer_km = 1000.0
km_between = 30000.0
km_per_day = 500.0

[[vehicles]]
code = "T-1"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5]

[[vehicles.wheelsets]]
serial = "{WORN}"
wear_mm_per_100000_km = 1.2
reprofiled_at_odometer_km = [45000.0]

[[vehicles.wheelsets]] # over the limit from the first campaign on, and out of sight from the third
serial = "{DEAD}"
initial_wear_mm = 2.4
initial_mileage_km = 250000.0

[vehicles.wheelsets.fault]
kind = "sensor_fault"
from_campaign = 3
"""
WINDOW_S = 30.0
HOUR_NS = 3_600_000_000_000
BOOK_KEEPING = ("job_runs", "stage_marks")


@dataclass(frozen=True)
class Deployment:
    """A database with its folder, a receiver, and the jobs."""

    settings: Settings
    storage: SqlStorage
    clock: StandingClock
    receiver: Receiver

    def receive(self, recordings: Iterable[Recording]) -> list[ChunkRecord]:
        """Receive recordings, none before it was made."""
        recordings = list(recordings)
        for name in (item.path.stem for item in recordings if "__" in item.path.stem):
            begun = datetime.strptime(name.rpartition("__")[2], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
            self.clock.at_ns = max(self.clock.at_ns, round(begun.timestamp()) * 10**9)
        return [self.receiver.receive_file(item.path, item.vehicle).record for item in recordings]

    def run_jobs(self) -> list[JobRun]:
        context = job_context(self.settings, self.storage)
        runs = run_all(replace(context, clock=self.clock), JobTrigger.CLI)
        assert {run.outcome for run in runs} == {"succeeded"}, runs
        return runs

    def campaign_over(self, recordings: Sequence[Recording]) -> None:
        """Put the clock an hour behind the last of the recordings."""
        ends = [record.last_ns for record in self.receive(recordings)]
        self.clock.at_ns = max(self.clock.at_ns, *(end + HOUR_NS for end in ends if end is not None))


def recorded_once(factory: pytest.TempPathFactory, scenario: Scenario) -> FleetReport:
    """Return the recordings of a scenario, simulated once for all test processes."""

    def simulate(folder: Path) -> None:
        (folder / "report").write_bytes(pickle.dumps(run_fleet(scenario, folder / "recordings", workers=1)))

    folder = made_once(factory, f"fleet-{scenario.name}", simulate)
    report: FleetReport = pickle.loads((folder / "report").read_bytes())  # noqa: S301 - written by simulate
    return report


def deployment(url: str, directory: Path, report: FleetReport) -> Deployment:
    """Return a deployment on a migrated database that knows the registry."""
    settings = Settings(
        data_dir=directory,
        database_url=url,
        window_length_s=WINDOW_S,
        port=0,
        _env_file=None,
    )
    storage = SqlStorage(database_engine(url), directory)
    with storage.write() as unit:
        load_registry(report.registry, unit, 1)
    clock = StandingClock(1_704_000_000_000_000_000)
    receiver = Receiver(storage, raw_store(settings), default_catalogue(), clock, window_length_s=WINDOW_S)
    return Deployment(settings, storage, clock, receiver)


def whole_history(found: Deployment, report: FleetReport) -> None:
    """Receive campaign by campaign and run the jobs after each."""
    for recording in report.recordings:
        found.campaign_over([recording])
        found.run_jobs()


def rows(storage: SqlStorage) -> dict[str, list[tuple[Any, ...]]]:
    """Return every row of every table, but for the record of what the jobs ran and looked at."""
    with storage.engine.connect() as connection:
        return {
            table.name: sorted((tuple(row) for row in connection.execute(select(table))), key=repr)
            for table in Base.metadata.sorted_tables
            if table.name not in BOOK_KEEPING
        }


NOT_COMPARED = frozenset({"recorded_ns", "running_km"})
"""Times, and the mileage that is kept of a window once the stored sums hold its table: the last few wait for others."""


def results(storage: SqlStorage) -> dict[str, Any]:
    """Return what was made of the recordings, by key and to the last bit, without the times of recording."""
    found = rows(storage)
    names = {table.name: [column.name for column in table.columns] for table in Base.metadata.sorted_tables}
    kept = {}
    for name in ("windows", "window_bin_tables"):
        dicts = [dict(zip(names[name], row, strict=True)) for row in found[name]]
        kept[name] = [{k: v for k, v in row.items() if k not in NOT_COMPARED} for row in dicts]
    with storage.read() as unit:
        records = {serial: unit.geometries.intervals(serial) for serial in (WORN, DEAD)}
        current = {serial: unit.geometries.current(serial) for serial in (WORN, DEAD)}
        alerts = [(alert.wheelset, alert.kind, alert.condition) for alert in unit.alerts.all_open()]
    kept["geometries"] = {
        serial: [_without_time(record) for record in [*records[serial], current[serial]]] for serial in (WORN, DEAD)
    }
    kept["alerts"] = sorted(alerts)
    return kept


def _without_time(record: GeometryRecord | None) -> dict[str, object] | None:
    if record is None:
        return None
    values = {name: getattr(record, name) for name in GeometryRecord.__slots__ if name != "recorded_ns"}
    return values | {"geometry": pack_geometry(record.geometry)}


def true_conicity(truth: Path, serial: str, mileage_km: float, amplitude_mm: float) -> float:
    """Return what the simulator says was true in the campaign nearest to a mileage."""
    wheelsets = json.loads(truth.read_text(encoding="utf-8"))["wheelsets"]
    (campaigns,) = (item["campaigns"] for item in wheelsets if item["serial"] == serial)
    seen = min(campaigns, key=lambda c: abs(c["mileage_km"] - mileage_km))
    return float(np.interp(amplitude_mm, seen["amplitude_mm"], seen["equivalent_conicity"]))
