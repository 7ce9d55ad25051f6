"""How many SQL statements a run of all jobs executes over six windows of two wheelsets."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.house import job_statements

MOST = {
    "refresh_alignment": 203,
    "estimate_windows": 124,
    "refresh_geometry": 76,
    "refresh_adhesion": 118,
    "refresh_trends": 41,
    "evaluate_alerts": 95,
    "refresh_rails": 67,
    "refresh_signatures": 105,
}


@pytest.mark.slow
def test_no_job_asks_the_database_more_often() -> None:
    executed = job_statements(Path(__file__).resolve().parents[2])
    assert {name: executed[name] for name in MOST if executed[name] > MOST[name]} == {}
