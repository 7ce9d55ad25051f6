"""The short form of the run on damaged log files: no crash, no file over its limits, no damage of BLF unseen."""

from __future__ import annotations

from pathlib import Path

from bench.chaos.run import PARTS, ChaosSettings


def test_damaged_log_files_are_refused_or_read_within_the_limits(tmp_path: Path) -> None:
    part = next(item for item in PARTS if item.name == "mutations")
    found = list(part.rows(ChaosSettings(part.short, 7, tmp_path)))
    assert [row.what for row in found if not row.met] == []
    assert {row.what.partition(":")[0] for row in found} == {".blf", ".log", ".asc", "inside .blf", ".mf4"}
