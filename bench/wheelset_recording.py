"""The recorded windows that the years of the benches are made of."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from api.comparison.trial import ESTIMATION, opened, receive, record, register, run_jobs
from api.settings import Settings
from bench.wheelset_year import SERIAL, Original, WheelsetYear
from estimation.jobs.job import JobContext
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
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
    with tempfile.TemporaryDirectory() as name:
        register(plan, settings, Path(name))
        receive(record(plan, Path(name) / "recordings", workers=1), settings)
    run_jobs(context, ESTIMATION[:2])
    with storage.read() as unit:
        windows = [
            Original(unit.windows.load(SERIAL, stored.start_ns), table, version)
            for stored, table, version in unit.tables.stream(SERIAL, 0, None)
        ]
    assert windows, "no window of the recording was estimated"
    return windows


@contextmanager
def recorded_year(folder: Path) -> Iterator[WheelsetYear]:
    """Yield a new deployment in a folder which has received them, for a year that is put then."""
    settings = Settings(data_dir=folder, database_url=None, _env_file=None)
    upgrade(settings.url)
    with opened(settings) as (storage, context):
        yield WheelsetYear(context, storage, recorded(context, storage, settings))
