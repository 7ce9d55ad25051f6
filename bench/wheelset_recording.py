"""The recorded windows that the years of the benches are made of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, run_jobs
from bench.wheelset_year import SERIAL, Original, WheelsetYear
from ingest.simulator.scenario_file import load_scenario


@contextmanager
def recorded_year(folder: Path) -> Iterator[WheelsetYear]:
    """Yield a new deployment that has the windows of a recording, estimated, for a year that is put then.

    They are those of the first vehicle's first campaign of demo_single on surveyed track.
    """
    plan = load_scenario("demo_single")
    plan = replace(
        plan,
        vehicles=plan.vehicles[:1],
        sessions=replace(plan.sessions, campaigns=1),
        section=replace(plan.section, surveyed=True),
    )
    settings = deploy(plan, folder)
    receive(record(plan, folder / "recordings", workers=1), settings)
    with opened(settings) as (storage, context):
        run_jobs(context, ESTIMATION[:2])
        with storage.read() as unit:
            found = [
                Original(unit.windows.load(SERIAL, stored.start_ns), table, version)
                for stored, table, version in unit.tables.stream(SERIAL, 0, None)
            ]
        assert found, "no window of the recording was estimated"
        yield WheelsetYear(context, storage, found)
