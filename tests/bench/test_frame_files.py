"""How many files of the product one frame enters on its way from a log to the answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.house import TO_GEOMETRY, entered_files, figures, trace

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_a_frame_enters_no_more_files() -> None:
    traced, most = trace(ROOT), figures(ROOT)
    to_geometry = entered_files({stage: files for stage, files in traced.items() if stage in TO_GEOMETRY})
    assert 30 < len(to_geometry) <= most["files that a frame enters, to the geometry"], sorted(to_geometry)
    entered = entered_files(traced)
    assert len(to_geometry) < len(entered) <= most["files that a frame enters, to trend, alerts and REST"], sorted(
        entered
    )
