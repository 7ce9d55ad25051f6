"""How many files of the product one frame enters on its way from a log to the answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.house import TO_GEOMETRY, entered_files, trace

MOST_TO_GEOMETRY, MOST_TO_ALERTS = 80, 100


@pytest.mark.slow
def test_a_frame_enters_no_more_files() -> None:
    traced = trace(Path(__file__).resolve().parents[2])
    to_geometry = entered_files({stage: files for stage, files in traced.items() if stage in TO_GEOMETRY})
    assert 30 < len(to_geometry) <= MOST_TO_GEOMETRY, sorted(to_geometry)
    assert len(to_geometry) < len(entered_files(traced)) <= MOST_TO_ALERTS, sorted(entered_files(traced))
