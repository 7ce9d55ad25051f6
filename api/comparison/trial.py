"""A simulated fleet through the product: recordings, receiver, store, jobs; the geometry by any estimator."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from api.factory import SystemClock, open_store, raw_store
from api.pipeline import job_context
from api.settings import Settings
from estimation.errors import PurgedError, TreadwatchError
from estimation.estimators.catalogue import SHIPPED, estimator_named
from estimation.estimators.interface import Estimator, EstimatorParameters, geometry_from_motion
from estimation.geometry.estimate import contradictions
from estimation.jobs import estimate_windows, refresh_alignment, refresh_geometry
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.refresh_geometry import RolledGeometries, geometries_of
from estimation.jobs.steps.estimated_geometry import EstimatedWith
from estimation.jobs.steps.load_window import load_window
from estimation.jobs.steps.rolling import Part, members
from estimation.motion.integration import WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.storage import Storage, UnitOfWork
from estimation.values.geometry import WheelsetGeometry
from estimation.values.reasons import Reason
from estimation.values.roll_up import Member
from estimation.values.runs import JobTrigger
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Motion
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import Recording, prepare, run_fleet
from ingest.simulator.scenario import Scenario
from ingest.simulator.section import SurveyPlan
from ingest.simulator.side_files import TRUTH_FILE

Progress = Callable[[str, int, int], None]  # what, done, of
ESTIMATION: tuple[Job, ...] = (refresh_alignment.JOB, estimate_windows.JOB, refresh_geometry.JOB)


@dataclass(frozen=True, slots=True)
class Recorded:
    """The recordings of a scenario and its truth."""

    recordings: tuple[tuple[str, Path], ...]  # vehicle and file, in the order of their begin
    truth: Path


def no_progress(_what: str, _done: int, _of: int) -> None:
    """Report nothing."""


def recording_key(scenario: Scenario) -> str:
    """Return a digest of everything that shapes the recordings; track, profiles and class on file do not."""
    section = replace(scenario.section, surveyed=False, gauge_surveyed=False, survey=SurveyPlan())
    drawn = None if scenario.drawn is None else replace(scenario.drawn, profiles_measured=0)
    shaping = replace(scenario, name="", description="", section=section, drawn=drawn, class_on_file=None)
    digest = hashlib.sha256(repr(shaping).encode())
    for path in scenario.files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:20]


def record(
    scenario: Scenario, cache: Path, *, workers: int | None = None, progress: Progress = no_progress
) -> Recorded:
    """Return the recordings of a scenario, simulated where ``cache`` does not hold them."""
    folder = cache / recording_key(scenario)
    if not (folder / TRUTH_FILE).exists():  # written last

        def show(done: int, total: int, _recording: Recording) -> None:
            progress("simulate", done, total)

        progress("simulate", 0, 1)
        run_fleet(scenario, folder, workers=workers, progress=show)
    files = sorted(folder.glob("*/*.blf"), key=lambda path: path.stem.rpartition("__")[2])
    return Recorded(tuple((path.parent.name, path) for path in files), folder / TRUTH_FILE)


def deploy(scenario: Scenario, folder: Path) -> Settings:
    """Return the settings of a new data folder whose store knows the registry of ``scenario``."""
    settings = Settings(  # type: ignore[call-arg] # of pydantic-settings
        data_dir=folder / "data", database_url=None, raw_store=None, _env_file=None
    )
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    upgrade(settings.url)
    register(scenario, settings, folder)
    return settings


def register(scenario: Scenario, settings: Settings, folder: Path) -> None:
    """Load the registry of ``scenario``, written into ``folder``, into an existing store."""
    with closing(open_store(settings)) as storage, storage.write() as unit:
        load_registry(prepare(scenario, folder / "registry"), unit, SystemClock().now_ns())


def receive(recorded: Recorded, settings: Settings, progress: Progress = no_progress) -> None:
    """Receive every recording, in the order of time, as ``treadwatch ingest`` does."""
    with closing(open_store(settings)) as storage:
        catalogue = default_catalogue()
        receiver = Receiver(storage, raw_store(settings), catalogue, SystemClock(), settings.window_length_s)
        for done, (vehicle, path) in enumerate(recorded.recordings):
            progress("ingest", done, len(recorded.recordings))
            receiver.receive_file(path, vehicle)


def copied(settings: Settings, folder: Path) -> Settings:
    """Return a deployment in ``folder`` with everything that another has stored so far."""
    shutil.copytree(settings.data_dir, folder / "data")
    return settings.model_copy(update={"data_dir": folder / "data"})


@contextmanager
def opened(settings: Settings) -> Iterator[tuple[SqlStorage, JobContext]]:
    """Yield the store of a deployment and the context of its jobs."""
    with closing(open_store(settings)) as storage:
        yield storage, job_context(settings, storage)


def run_jobs(context: JobContext, jobs: Sequence[Job] = ESTIMATION, progress: Progress = no_progress) -> None:
    """Run jobs one after the other; the first that fails ends it."""
    for job in jobs:

        def show(done: int, total: int, job: Job = job) -> None:
            progress(job.name.replace("_", " "), done, total)

        show(0, 1)
        run = run_job(job, replace(context, progress=show), JobTrigger.CLI)
        if run.error is not None:
            raise TreadwatchError(f"job {job.name} failed: {run.error}")


def replayed(
    unit: UnitOfWork, members: Sequence[Member], parameters: WindowParameters
) -> Iterator[tuple[Member, Motion]]:
    """Yield each window with its motion, as ``estimate_windows`` tabulated it.

    A window is left out whose position or content has changed since, so that it is refused today, and one whose
    samples have been purged.
    """

    @lru_cache
    def alignment(section: str, version: int | None) -> TrackAlignment | None:
        return unit.tracks.alignment(section, version)

    @lru_cache
    def layout(section: str) -> TrackLayout | None:
        return unit.tracks.layout(section)

    for member in members:
        record, section = member.window.record, member.window.record.track_section
        position = unit.tracks.position(record.wheelset, record.start_ns)
        if position is not None and position.content_digest != record.content_digest:
            position = None  # found from other content
        mounting = unit.registry.mounting_at(record.vehicle, record.axle, record.start_ns)
        try:
            window = load_window(unit, record, parameters.vehicle_class)
        except PurgedError:
            continue
        if isinstance(window, Reason):
            continue
        moved = window_motion(
            window,
            alignment(section, member.window.track_version) if section is not None else None,
            parameters,
            Correction(position.offset_m, position.scale, position.middle_m) if position is not None else None,
            position.reason if position is not None else None,
            mounted_reversed=mounting is not None and mounting.reversed,
            layout=layout(section) if section is not None else None,
        )
        if not isinstance(moved, Reason):
            yield member, moved


def geometry_by(storage: Storage, context: JobContext, serial: str, estimator: str) -> WheelsetGeometry | None:
    """Return the current geometry of a wheelset as an estimator finds it; nothing is stored."""
    with storage.read() as unit:
        rolled = geometries_of(unit, [serial], context)[serial]
        if estimator != SHIPPED:
            return _by_rival(unit, rolled, estimator_named(estimator))
        current = [record.geometry for record in rolled.records() if record.interval is None]
        return current[-1] if current else None


def _by_rival(unit: UnitOfWork, rolled: RolledGeometries, rival: Estimator[Any]) -> WheelsetGeometry | None:
    """Return the geometry by a rival; what the data say against class and registry holds for it, too."""
    parts = rolled.current_parts()
    if not parts:
        return None
    used = rolled.estimated_with(parts)
    motions, key = _weighted(unit, rolled, used, parts), f"{used.bins.key} {rival.name}"
    geometry = geometry_from_motion(rival, parameters_of(used), motions, used.bins.edges, key)
    for contradiction in contradictions(rolled.forgetting_sum(parts), used.bins, used.uncertainty):
        geometry = geometry.against(contradiction)
    return geometry.against(rolled.contradiction(parts, (parts[0].roll_up.key.baseline, None)))


def parameters_of(used: EstimatedWith) -> EstimatorParameters:
    """Return what all estimators share, as the job has it."""
    settings = used.settings
    return EstimatorParameters(
        used.assumed.window_parameters.vehicle,
        used.uncertainty,
        settings.geometry.curve,
        settings.signals.source,
        band_limited=True,
    )


def _weighted(
    unit: UnitOfWork, rolled: RolledGeometries, used: EstimatedWith, parts: Sequence[Part]
) -> Iterator[tuple[float, Motion]]:
    """Yield weight and motion of the windows that have samples, oldest first; the newest has weight 1."""
    together = [member for part in parts for member in members(unit, rolled.rules, part)]
    ordered = sorted(together, key=lambda member: member.start_ns)
    newest_km = max((part.roll_up for part in parts), key=lambda roll_up: roll_up.last_ns).last_km
    for member, moved in replayed(unit, ordered, used.assumed.window_parameters):
        yield 0.5 ** ((newest_km - member.mileage_km) / rolled.rules.half_life_km), moved
