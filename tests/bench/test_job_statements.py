"""How many SQL statements a run of all jobs executes over six windows of two wheelsets."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.house import CORE_JOBS, figures, job_statements

MOST = {
    "refresh_alignment": 40,
    "estimate_windows": 50,
    "refresh_geometry": 39,
    "refresh_adhesion": 101,
    "refresh_fleet": 40,
    "refresh_trends": 20,
    "evaluate_alerts": 52,
    "refresh_rails": 55,
    "refresh_signatures": 66,
}
ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_no_job_asks_the_database_more_often() -> None:
    executed = job_statements()
    assert {name: executed[name] for name in MOST if executed[name] > MOST[name]} == {}
    most = figures(ROOT)["SQL statements from alignment to alerts, six windows of two wheelsets"]
    assert sum(executed[name] for name in CORE_JOBS) <= most
