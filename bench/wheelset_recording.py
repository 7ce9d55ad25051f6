"""The recorded windows that the years of the benches are made of."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from api.comparison.trial import Recorded, opened, receive
from api.settings import Settings
from bench.wheelset_year import SERIAL, Original, WheelsetYear
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.registry_file import load_registry
from ingest.simulator.fleet import run_fleet
from ingest.simulator.scenario_file import load_scenario


def recorded(context: JobContext, storage: SqlStorage, settings: Settings) -> Sequence[Original]:
    """Return the windows of the first vehicle's first campaign of demo_single on surveyed track, estimated."""
    plan = load_scenario("demo_single")
    plan = replace(
        plan,
        vehicles=plan.vehicles[:1],
        sessions=replace(plan.sessions, campaigns=1),
        section=replace(plan.section, surveyed=True),
    )
    with tempfile.TemporaryDirectory() as folder:
        report = run_fleet(plan, Path(folder), workers=1)
        with storage.write() as unit:
            load_registry(report.registry, unit, 1)
        sent = tuple((recording.vehicle, recording.path) for recording in report.recordings)
        receive(Recorded(sent, report.truth), settings)
    for name in ("refresh_alignment", "estimate_windows"):
        run_job(job_named(name), context, JobTrigger.CLI)
    with storage.read() as unit:
        found = [
            Original(unit.windows.load(SERIAL, record.start_ns), table, version)
            for record, table, version in unit.tables.stream(SERIAL, 0, None)
        ]
    assert found, "no window of the recording was estimated"
    return found


@contextmanager
def recorded_year(folder: Path) -> Iterator[WheelsetYear]:
    """Yield a new deployment in a folder which has received them, for a year that is put then."""
    settings = Settings(data_dir=folder, database_url=None, _env_file=None)
    upgrade(settings.url)
    with opened(settings) as (storage, context):
        yield WheelsetYear(context, storage, recorded(context, storage, settings))
