"""SQL statements: of one wheelset more in a fleet, and of one window more after days of history."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from made_once import made_once

from bench.statements import INGEST, REACH_OF_JOB, is_flat, of_days, of_fleet, of_one_more, simulated
from ingest.simulator.fleet import FleetReport

DAYS = 6
VEHICLES = (2, 8)
MOST_OF_ONE = {
    INGEST: 8.0,
    "refresh_alignment": 2.0,
    "estimate_windows": 2.0,
    "refresh_geometry": 4.0,
    "refresh_adhesion": 4.0,
    "refresh_trends": 2.0,
    "evaluate_alerts": 5.0,
    "refresh_rails": 8.0,
    "refresh_signatures": 1.0,
}


@pytest.fixture
def report(tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    """Return the recordings of a vehicle, simulated once for all test processes."""

    def simulate(folder: Path) -> None:
        (folder / "report").write_bytes(pickle.dumps(simulated(folder / "recordings", DAYS)))

    folder = made_once(tmp_path_factory, "statements", simulate)
    found: FleetReport = pickle.loads((folder / "report").read_bytes())  # noqa: S301 - written by simulate
    return found


@pytest.mark.slow
def test_a_wheelset_costs_few_statements_in_any_fleet(report: FleetReport, tmp_path: Path) -> None:
    each = of_one_more({size: of_fleet(tmp_path / str(size), report, size) for size in VEHICLES})
    assert {name: count for name, count in each.items() if count > MOST_OF_ONE.get(name, 0.0)} == {}


@pytest.mark.slow
def test_no_job_needs_more_statements_for_a_window_after_days_of_history(report: FleetReport, tmp_path: Path) -> None:
    by_day = of_days(tmp_path, report)
    for name in by_day[0]:
        of_job = [executed[name] for executed in by_day]
        assert max(of_job) <= REACH_OF_JOB, (name, of_job)
        assert is_flat(of_job), (name, of_job)
