"""A wheelset is the same whichever way its vehicle runs and whichever way round it is mounted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from paper_class import BINS, WINDOWS
from section_runs import SETTINGS, mirror_mounted, turned_windows, windows
from smooth_wheelset import alignment, track

from estimation.geometry.estimate import estimate_geometry
from estimation.motion.checks import direction
from estimation.tables import bin_table
from estimation.tables.bin_table import cells_of_window
from estimation.values.reasons import Reason
from estimation.values.windows import Window

KNOWN = alignment(track(1))


def curve(found: tuple[Window, ...], *, mounted_reversed: bool = False) -> np.ndarray:
    tables = [cells_of_window(window, KNOWN, WINDOWS, mounted_reversed=mounted_reversed) for window in found]
    assert not any(isinstance(table, Reason) for table in tables), tables
    merged = bin_table.merge_all([table for table in tables if not isinstance(table, Reason)], BINS)
    return estimate_geometry(merged, BINS, SETTINGS.geometry).rolling_radius_difference.value


def test_a_wheelset_that_runs_the_other_way_is_the_mirror_image_of_itself_and_comes_out_the_same() -> None:
    here, there = curve(windows(2)), curve(turned_windows(2))
    known = np.isfinite(here + there)
    assert known.sum() >= 8
    # asymmetric by 0.02 of 0.34 in its cone: were the sides exchanged, the even part would have the other sign
    assert np.abs((here - there)[known]).max() < 0.04 * np.abs(here[known]).max()


def test_a_wheelset_mounted_reversed_is_its_own_mirror_image() -> None:
    plain = curve(windows(2))
    reversed_curve = curve(windows(2), mounted_reversed=True)
    np.testing.assert_allclose(reversed_curve, -plain[::-1], atol=1e-7, equal_nan=True)


def reason(window: Window) -> str:
    refusal = cells_of_window(window, KNOWN, WINDOWS)
    assert isinstance(refusal, Reason)
    return refusal.text


def test_a_window_that_contradicts_itself_is_refused_with_its_reason() -> None:
    window = windows(1)[0]
    n = len(window.valid)
    assert "stands or runs too slowly" in reason(replace(window, speed=np.zeros(n)))
    assert "axes point against the direction" in reason(mirror_mounted([window])[0])
    jumped = window.distance + 12.0 * (np.arange(n) > n // 2)
    assert "the position jumps once against the speed, by 12.0 m" in reason(replace(window, distance=jumped))
    there_and_back = np.minimum(window.distance, window.distance[::-1])
    assert "both ways" in reason(replace(window, distance=there_and_back))


@pytest.mark.parametrize("number", range(6))
def test_valid_windows_lead_one_way(number: int) -> None:
    assert {direction(window) for window in windows(number)} == {1}
    assert {direction(window) for window in turned_windows(number % 2 * 2)} == {-1}
