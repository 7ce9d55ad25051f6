"""SQL statements: of one wheelset more in a fleet, of one window more after days of history, and of an idle run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from bench.growth import REACH_IDLE, costs, of_one_more, runs
from bench.measuring import INGEST
from bench.small_fleets import FOUR_AXLES, Workload, deployed, small_fleet
from tests.postgres_server import stoppable_server

MINUTES = 1.5
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
MOST_OF_JOB, NOT_EVERY_DAY = 150, 20


def worn(folder: Path, server: str | None = None) -> Workload:
    """Return recordings of a vehicle so worn that alerts follow from them."""
    return deployed(folder, small_fleet("K", {"1": [(2.4, 0.0)] * 4}, FOUR_AXLES, MINUTES), server)


def is_flat(of_job: Sequence[int]) -> bool:
    """Return whether the last days cost no more than the third did, but for what not every day brings."""
    return max(of_job[2:]) <= of_job[2] + NOT_EVERY_DAY


@pytest.mark.slow
def test_a_wheelset_costs_few_statements_in_any_fleet_and_none_where_nothing_is_new(tmp_path: Path) -> None:
    load = worn(tmp_path / "load")
    found = {size: costs(tmp_path / str(size), load, size) for size in VEHICLES}
    each = of_one_more({size: received.statements for size, (received, _) in found.items()})
    assert {name: count for name, count in each.items() if count > MOST_OF_ONE.get(name, 0.0)} == {}
    assert each["evaluate_alerts"] > 0.0
    assert max(idle.statements.total() for _, idle in found.values()) <= REACH_IDLE


@pytest.mark.slow
def test_an_idle_run_asks_a_server_few_statements(tmp_path: Path) -> None:
    with stoppable_server() as server:
        _, idle = costs(tmp_path / "fleet", worn(tmp_path / "load", server.url), 2)
    assert idle.statements.total() <= REACH_IDLE


@pytest.mark.slow
def test_no_job_needs_more_statements_for_a_window_after_days_of_history(tmp_path: Path) -> None:
    by_day = [stages.statements for stages in runs(tmp_path, 1, DAYS, MINUTES, surveyed=True, quiet_s=0.0)]
    for name in by_day[0]:
        of_job = [executed[name] for executed in by_day]
        assert max(of_job) <= MOST_OF_JOB, (name, of_job)
        assert is_flat(of_job), (name, of_job)
