"""A small fleet on rails of changing friction, estimated up to the geometries of its wheelsets."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from adhesion_fleet import EstimatedFleet

from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, run_jobs
from ingest.simulator.scenario_file import load_scenario

SCENARIO = Path(__file__).parents[3] / "bench" / "adhesion_scenarios" / "low.toml"


@pytest.fixture(scope="session")
def estimated_fleet() -> Iterator[EstimatedFleet]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = SCENARIO.read_text(encoding="utf-8").replace("length_m = 10000.0", "length_m = 2000.0")
        (folder / "s.toml").write_text(text.replace("vehicles = 4", "vehicles = 2"), encoding="utf-8")
        scenario = load_scenario(folder / "s.toml")
        settings = deploy(scenario, folder / "deployed")
        receive(record(scenario, folder / "cache", workers=1), settings)
        with opened(settings) as (_, context):
            run_jobs(context, ESTIMATION)
        yield EstimatedFleet(scenario, settings)
