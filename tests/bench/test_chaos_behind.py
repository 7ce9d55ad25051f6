"""The short form of the chaos part of services that are behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.chaos.run import PARTS, ChaosSettings

pytestmark = pytest.mark.slow


def test_chunks_that_nobody_decodes_are_kept_or_refused_and_assembled_later(tmp_path: Path) -> None:
    (part,) = (one for one in PARTS if one.name == "behind")
    rows = list(part.rows(ChaosSettings(part.short, 0, tmp_path)))
    assert len(rows) == 4
    assert [(row.what, row.measured) for row in rows if not row.met] == []
