"""A whole scenario: every vehicle and campaign simulated and recorded, with registry and truth beside."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ingest.catalogue import default_catalogue
from ingest.frames import FrameBatch
from ingest.logs.blf_writer import write_blf
from ingest.simulator.bus_frames import vehicle_frames
from ingest.simulator.campaign import (
    SURVEY,
    failed,
    scenario_track,
    seed_of,
    vehicle_run,
    wheelset_motion,
    wheelset_record,
)
from ingest.simulator.scenario import Scenario, VehiclePlan
from ingest.simulator.sensors import SensorRecord
from ingest.simulator.side_files import WheelsetTruth, surveyed, wheelset_truth, write_registry, write_truth
from ingest.simulator.track import TrackTruth
from ingest.simulator.wear import gauge_grid, truth_of, wear_at, worn_contact

STAMP = "%Y%m%dT%H%M%SZ"


@dataclass(frozen=True, slots=True)
class Recording:
    """One campaign of one vehicle, written."""

    vehicle: str
    campaign: int  # from 1
    path: Path
    frames: int
    wheelset_seconds: float
    truths: tuple[WheelsetTruth, ...]


@dataclass(frozen=True, slots=True)
class FleetReport:
    """What a run of a scenario left behind."""

    recordings: tuple[Recording, ...]
    registry: Path
    truth: Path

    @property
    def frames(self) -> int:
        """Frames written."""
        return sum(item.frames for item in self.recordings)

    @property
    def wheelset_seconds(self) -> float:
        """Simulated time, summed over wheelsets, s."""
        return sum(item.wheelset_seconds for item in self.recordings)


Progress = Callable[[int, int, Recording], None]
"""Called after each recording with how many are done, how many there are, and the one just written."""


def run_fleet(
    scenario: Scenario,
    out: Path,
    *,
    vehicles: Sequence[str] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetReport:
    """Simulate ``scenario`` into ``out``: recordings per vehicle and campaign, ``registry.json``, ``truth.json``.

    Parameters
    ----------
    scenario
        What to simulate; the same scenario gives the same bytes, however many workers there are.
    out
        Folder, made where missing; recordings are ``<vehicle>/<vehicle>__<start, UTC>.blf``.
    vehicles
        Codes of the vehicles to simulate; all unless given. The registry always names all.
    workers
        Processes; as many as cores (at most the recordings) unless given. With 1 everything runs in this process.
    progress
        Called after each recording.

    Raises
    ------
    ScenarioError
        The scenario cannot be run: unknown vehicle, too little track, a wheelset that derails.
    OSError
        A file cannot be written.
    """
    chosen = [scenario.vehicle(code) for code in vehicles] if vehicles is not None else list(scenario.vehicles)
    track = scenario_track(scenario)
    registry = prepare(scenario, out)
    tasks = [(plan.code, campaign) for campaign in range(scenario.sessions.campaigns) for plan in chosen]
    count = workers if workers is not None else min(os.cpu_count() or 1, len(tasks))
    recordings = []
    for recording in _recordings(scenario, out, track, tasks, count):
        recordings.append(recording)
        if progress is not None:
            progress(len(recordings), len(tasks), recording)
    recordings.sort(key=lambda item: (item.campaign, item.vehicle))
    truth = write_truth(out, scenario, [truth for item in recordings for truth in item.truths])
    return FleetReport(tuple(recordings), registry, truth)


def prepare(scenario: Scenario, out: Path) -> Path:
    """Write the registry of ``scenario`` and the track that is on file into ``out``; return the registry's path."""
    out.mkdir(parents=True, exist_ok=True)
    track = scenario_track(scenario)
    return write_registry(out, scenario, track, surveyed(scenario, track, seed_of(scenario, SURVEY)))


def record(scenario: Scenario, out: Path, track: TrackTruth, vehicle: VehiclePlan, campaign: int) -> Recording:
    """Simulate one campaign (from 0) of one vehicle and write its recording, whole or not at all."""
    batch, truths = simulate_campaign(scenario, track, vehicle, campaign)
    start = datetime.fromtimestamp(scenario.start_ns(vehicle, campaign) // 1_000_000_000, tz=UTC).strftime(STAMP)
    path = out / vehicle.code / f"{vehicle.code}__{start}.blf"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_blf(path, batch)
    seconds = scenario.sessions.duration * len(vehicle.wheelsets)
    return Recording(vehicle.code, campaign + 1, path, len(batch), seconds, truths)


def simulate_campaign(
    scenario: Scenario, track: TrackTruth, vehicle: VehiclePlan, campaign: int
) -> tuple[FrameBatch, tuple[WheelsetTruth, ...]]:
    """Return all frames of one campaign (from 0) of one vehicle, and what is true of its wheelsets."""
    run = vehicle_run(scenario, track, vehicle, campaign)
    records: list[SensorRecord | None] = []
    truths: list[WheelsetTruth] = []
    for axle, plan in enumerate(vehicle.wheelsets):
        table = worn_contact(plan, wear_at(plan, run.odometer), scenario.section, gauge_grid(track))
        truths.append(wheelset_truth(vehicle, axle, campaign, run.odometer, truth_of(table)))
        if failed(plan, campaign):
            records.append(None)
            continue
        records.append(wheelset_record(scenario, run, axle, wheelset_motion(scenario, track, run, axle, table)))
    return vehicle_frames(default_catalogue(), scenario, run, records), tuple(truths)


def _recordings(
    scenario: Scenario, out: Path, track: TrackTruth, tasks: Sequence[tuple[str, int]], workers: int
) -> Iterator[Recording]:
    """Yield recordings as they are done; the first failure cancels what has not begun."""
    if workers <= 1:
        for code, campaign in tasks:
            yield record(scenario, out, track, scenario.vehicle(code), campaign)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures: list[Future[Recording]] = [
            pool.submit(record, scenario, out, track, scenario.vehicle(code), campaign) for code, campaign in tasks
        ]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
