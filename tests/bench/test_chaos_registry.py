"""The short form of the chaos part of the registry."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.chaos.run import PARTS, ChaosSettings

pytestmark = pytest.mark.slow


def test_mistakes_in_the_registry_that_were_corrected_leave_nothing_behind(tmp_path: Path) -> None:
    (part,) = (one for one in PARTS if one.name == "registry")
    rows = list(part.rows(ChaosSettings(part.short, 0, tmp_path)))
    assert [row for row in rows if not row.met] == []
