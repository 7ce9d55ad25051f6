"""The version of the numerics is raised when results change."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numerics_results import RECORDED, Results, results

from estimation.numerics_version import NUMERICS_VERSION

RELATIVE = {"geometry": 1e-5, "alignment": 5e-4, "trend": 1e-6}
"""What results of one version may differ by; processors differ by up to a third of it."""

CHANGED = (
    "results changed: raise NUMERICS_VERSION in estimation/numerics_version.py, "
    "then run python tests/estimation/numerics_results.py"
)


@pytest.fixture(scope="module")
def found() -> Results:
    return results()


def test_results_are_recorded_for_this_version() -> None:
    assert json.loads(RECORDED.read_text(encoding="utf-8"))["version"] == NUMERICS_VERSION, CHANGED


@pytest.mark.parametrize("stage", sorted(RELATIVE))
def test_results_are_those_recorded(found: Results, stage: str) -> None:
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))["results"]
    expected, seen = (np.array(item[stage], dtype=np.float64) for item in (recorded, found))
    assert len(seen) == len(expected), CHANGED
    assert np.isfinite(expected).sum() >= 7
    assert np.array_equal(np.isnan(seen), np.isnan(expected)), CHANGED
    rounding = RELATIVE[stage] * np.nanmedian(np.abs(expected))
    assert np.allclose(seen, expected, rtol=RELATIVE[stage], atol=rounding, equal_nan=True), CHANGED
