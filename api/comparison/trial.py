"""A simulated fleet through the product: recordings, receiver, store, jobs; what ``compare`` and the bench share."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from api.factory import SystemClock, job_context, open_store, raw_store
from api.settings import Settings
from estimation.errors import TreadwatchError
from estimation.jobs import estimate_windows, refresh_alignment, refresh_geometry
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobTrigger
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
