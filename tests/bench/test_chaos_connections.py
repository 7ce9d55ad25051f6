"""The short form of the chaos part of connections: what it counts, not how long it takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.chaos.run import PARTS, ChaosSettings

pytestmark = pytest.mark.slow


def test_300_half_open_connections_are_cut_and_leave_a_short_log(tmp_path: Path) -> None:
    (part,) = (one for one in PARTS if one.name == "connections")
    rows = list(part.rows(ChaosSettings(part.short, 0, tmp_path)))
    counted = [row for row in rows if not row.reach.endswith(" s")]
    assert len(counted) == 3
    assert [row for row in counted if not row.met] == []
    for log in tmp_path.glob("*/log"):
        assert "out of system resource" not in log.read_text()
