"""A few results of every stage, and those recorded for the version of the numerics.

``python tests/estimation/numerics_results.py`` records them again, once ``NUMERICS_VERSION`` has been raised.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from gauge_passes import passes, section
from paper_class import BINS, WINDOWS
from smooth_wheelset import alignment, mems_windows, run, track

from estimation.geometry.estimate import estimate_geometry
from estimation.jobs.settings import JobSettings
from estimation.numerics_version import NUMERICS_VERSION
from estimation.tables import bin_table
from estimation.tables.bin_table import cells_of_window
from estimation.track.panel.basis import PanelParameters
from estimation.track.section import estimate_section
from estimation.track.settings import SectionParameters
from estimation.trend.trend import refresh
from estimation.values.arrays import FloatArray
from estimation.values.geometry import FilledCells
from estimation.values.quantities import Estimate
from estimation.values.trend import TrendPoint

RECORDED = Path(__file__).with_name("numerics_results.json")
DAY_NS = 86_400 * 10**9

Results = Mapping[str, list[float | None]]


def results() -> Results:
    """Return a few numbers of every stage."""
    return {"geometry": _geometry(), "alignment": _alignment(), "trend": _trend()}


def record() -> None:
    """Write the results of a version that has none yet."""
    if RECORDED.exists() and json.loads(RECORDED.read_text(encoding="utf-8"))["version"] == NUMERICS_VERSION:
        sys.exit("results of this version are recorded already: raise NUMERICS_VERSION first")
    found = {"version": NUMERICS_VERSION, "results": results()}
    RECORDED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _geometry() -> list[float | None]:
    settings = JobSettings().estimation
    windows = mems_windows(run(120, seed=1, cone=0.12, swing=4.0), seed=1)
    tables = [cells_of_window(window, alignment(track(1)), WINDOWS) for window in windows]
    merged = bin_table.merge_all([table for table in tables if isinstance(table, FilledCells)], BINS)
    found = estimate_geometry(merged, BINS, settings.geometry)
    difference = found.rolling_radius_difference
    curve = [column[np.isfinite(column)][::6] for column in (difference.value, difference.std)]
    return [*_numbers(np.concatenate(curve)), *(n for estimate in found.conicity for n in _estimate(estimate))]


def _alignment() -> list[float | None]:
    wheelsets = {"A": 0.05, "B": 0.10, "C": 0.16, "D": 0.22}
    parameters = SectionParameters(panel=PanelParameters(length=1200.0))
    found = estimate_section("S", passes(section(0.0), wheelsets, 2), None, parameters)
    assert found.alignment is not None, found.report.reason
    columns = (found.alignment.alignment, found.alignment.alignment_std)
    return _numbers(np.concatenate([column[np.isfinite(column)][::100] for column in columns]))


def _trend() -> list[float | None]:
    rng = np.random.default_rng(5)
    points = [
        TrendPoint(1000.0 * i, 7 * i * DAY_NS, 0.1 + 0.004 * i + 0.006 * float(rng.standard_normal()), 0.006)
        for i in range(20)
    ]
    found = refresh(points, 0.3)
    ahead = found.distance_to_limit_km
    later = found.over_ahead[::10].tolist()
    return [*_estimate(found.fitted), *_estimate(found.slope_per_1000_km), ahead.p10, ahead.p50, ahead.p90, *later]


def _estimate(estimate: Estimate) -> list[float | None]:
    return [estimate.value, estimate.std]


def _numbers(column: FloatArray) -> list[float | None]:
    return [float(value) for value in column]


if __name__ == "__main__":
    record()
