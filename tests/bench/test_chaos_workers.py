"""The short form of the chaos part of many workers: what it counts, not how long it takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.chaos.run import PARTS, ChaosSettings

pytestmark = pytest.mark.slow


def test_workers_that_are_harmed_lose_and_double_nothing(tmp_path: Path) -> None:
    (part,) = (one for one in PARTS if one.name == "workers")
    rows = [row for row in part.rows(ChaosSettings(part.short, 1, tmp_path)) if not row.reach.endswith(" s")]
    assert len(rows) == 3
    assert [(row.what, row.measured) for row in rows if not row.met] == []
    assert f"{part.short} faults" in rows[0].what
