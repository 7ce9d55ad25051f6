"""The tiny fleet, recorded once for all tests of the main job."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from in_process_command import Run
from page_place import Place
from tiny_fleet import SCENARIO, Deployment, deployment, recorded_once

from ingest.simulator.fleet import FleetReport
from ingest.simulator.scenario_file import load_scenario


@pytest.fixture(scope="session")
def scenario_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "tiny.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def report(scenario_file: Path, tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    """Return the recordings of the tiny fleet, in the order of their campaigns."""
    return recorded_once(tmp_path_factory, load_scenario(scenario_file))


@pytest.fixture
def fleet(storage_url: str, tmp_path: Path, report: FleetReport) -> Iterator[Deployment]:
    """Yield a deployment that has received nothing yet, once on each database."""
    found = deployment(storage_url, tmp_path / "fleet", report)
    yield found
    found.storage.close()


@pytest.fixture
def second_fleet(migrated_sqlite_file: Path, tmp_path: Path, report: FleetReport) -> Iterator[Deployment]:
    """Yield another, on SQLite, to compare with."""
    file = tmp_path / "second.sqlite3"
    shutil.copyfile(migrated_sqlite_file, file)
    found = deployment(f"sqlite:///{file}", tmp_path / "second", report)
    yield found
    found.storage.close()


@pytest.fixture
def place(tmp_path: Path, report: FleetReport, treadwatch: Run) -> Place:
    """Return a folder with a registry and one recording, as the pages have them."""
    return Place(tmp_path, report, treadwatch)
