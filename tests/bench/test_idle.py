"""What a run of all jobs asks the database where nothing is new."""

from __future__ import annotations

import re

import pytest

from bench.idle import REACH_STATEMENTS, rows
from bench.idle_fleet import FleetSize


@pytest.mark.slow
def test_an_idle_run_asks_few_statements_on_both_databases() -> None:
    measured = {row.what: row.measured for row in rows(FleetSize(vehicles=4, sections=8))}
    for database in ("SQLite", "PostgreSQL"):
        statements = re.search(r"(\d+) statements", measured[f"{database}: idle run of all jobs"])
        assert statements is not None
        assert int(statements[1]) <= REACH_STATEMENTS
