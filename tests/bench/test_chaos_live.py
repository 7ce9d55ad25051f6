"""The short form of the chaos part of the live receiver: what it counts, not how long it takes."""

from __future__ import annotations

from pathlib import Path

import pytest
from multicast import multicast_problem

from bench.chaos.run import PARTS, ChaosSettings

pytestmark = pytest.mark.slow


@pytest.mark.usefixtures("live_bus")
def test_kills_while_the_database_is_away_lose_and_double_nothing(tmp_path: Path) -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    (part,) = (one for one in PARTS if one.name == "live")
    (row,) = part.rows(ChaosSettings(part.short, 0, tmp_path))
    assert row.met, row.measured
