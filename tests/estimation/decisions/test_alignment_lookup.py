"""Where the alignment along a window is known, and how its long wavelengths are brought back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_windows import plain_track
from scipy.interpolate import CubicSpline
from test_agreement_limits import smooth

from estimation.filters import local_cubic_kernel
from estimation.motion.window_motion import alignment_at, deconvolved
from estimation.values.arrays import FloatArray
from estimation.values.track import TrackAlignment

FIRST, LAST = 100.0, 300.0
S = np.arange(FIRST, LAST + 1.0)
D = 1e-3 * smooth(3, len(S))


def track(s: FloatArray = S, alignment: FloatArray = D, cutoff_wavelength: float = np.inf) -> TrackAlignment:
    zero = np.zeros(len(s))
    return replace(
        plain_track(),
        s=s, alignment=alignment, alignment_std=zero, gauge_deviation=zero, gauge_deviation_std=zero,
        passes=np.zeros(len(s), dtype=np.int64), cutoff_wavelength=cutoff_wavelength,
    )  # fmt: skip


def at(*distance: float, alignment: FloatArray = D) -> FloatArray:
    return alignment_at(np.array(distance), track(S[: len(alignment)], alignment), 40.0)


def test_an_alignment_is_looked_up_by_a_cubic_spline_from_end_to_end_of_the_section() -> None:
    places = (99.9, 100.0, 130.3, 200.7, 299.5, 300.0, 300.1, np.nan)
    expected = np.where([False, *[True] * 5, False, False], CubicSpline(S, D)(places), np.nan)
    np.testing.assert_allclose(at(*places), expected, atol=1e-12)
    np.testing.assert_allclose(at(200.7, 203.1), CubicSpline(S, D)([200.7, 203.1]), atol=1e-12)  # a short window
    assert np.isnan(at(10.0, np.nan)).all()


def without(*points: int, n: int = len(S)) -> FloatArray:
    """Return the first n points of the alignment, some of them not known."""
    d = D[:n].copy()
    d[list(points)] = np.nan
    return d


def test_places_beside_a_point_that_is_not_known_are_not_known() -> None:
    found = at(148.9, 149.0, 149.5, 150.0, 150.5, 151.0, 151.1, alignment=without(50))
    np.testing.assert_array_equal(np.isfinite(found), [True, True, False, False, False, False, True])
    # at the ends only their own two neighbours count
    assert np.isfinite(at(100.0, 100.5, alignment=without(2, 29, n=30))).all()
    assert np.isfinite(at(128.5, 129.0, alignment=without(0, 27, n=30))).all()
    assert np.isnan(at(100.0, 100.5, alignment=without(1, n=30))).all()


def test_a_spline_needs_four_points() -> None:
    for points, known in ((3, False), (4, True)):
        assert np.isfinite(at(100.5, alignment=without(*range(points, 30), n=30)))[0] == known


LONG = np.arange(0.0, 4000.0)
CUTOFF = 60.0  # m


@pytest.mark.parametrize(("cutoff_wavelength", "raw"), [(29.9, True), (30.1, False)])
def test_an_alignment_that_reaches_twice_as_far_as_the_motion_is_taken_as_it_is(
    cutoff_wavelength: float, *, raw: bool
) -> None:
    wave = 1e-3 * np.sin(2 * np.pi * LONG / 80.0)
    filtered = track(LONG, wave, CUTOFF)
    expected = wave if raw else deconvolved(filtered)
    found = alignment_at(LONG[1500:2500], filtered, cutoff_wavelength)
    np.testing.assert_allclose(found, expected[1500:2500], atol=1e-12)
    assert np.abs(deconvolved(filtered) - wave)[1500:2500].max() > 0.1e-3


@pytest.mark.parametrize("step", [0.5, 1.0])
@pytest.mark.parametrize("wavelength", [30.0, 60.0, 100.0, 150.0, 240.0])
def test_what_the_filter_left_of_a_wave_is_undone_but_for_what_it_left_too_little_of(
    wavelength: float, step: float
) -> None:
    s = np.arange(0.0, 6000.0, step)
    wave = 1e-3 * np.sin(2 * np.pi * s / wavelength)
    found = deconvolved(track(500.0 + s, wave, CUTOFF))
    weights = local_cubic_kernel(CUTOFF, step)
    away = step * (np.arange(len(weights)) - len(weights) // 2)
    left = 1.0 - sum(w * np.cos(2 * np.pi * x / wavelength) for w, x in zip(weights, away, strict=True))
    middle = slice(len(s) // 2 - 500, len(s) // 2 + 500)
    gain = left / (left**2 + 0.03**2)
    np.testing.assert_allclose(found[middle], gain * wave[middle], atol=2e-3 * gain * 1e-3)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_a_cutoff_is_lost_at_both_ends_of_what_is_known(step: float) -> None:
    n = round(800.0 / step)
    s, lost = step * np.arange(n), round(60.0 / step)
    d = 1e-3 * smooth(5, n)
    holes = np.where((np.arange(n) == n // 2) | (np.arange(n) == n // 2 + lost), np.nan, d)
    found = deconvolved(track(s, holes, CUTOFF))
    known = np.zeros(n, dtype=bool)
    known[lost : n // 2 - lost] = True
    known[n // 2 + lost + 1 + lost : n - lost] = True  # what stands between the holes is too short
    np.testing.assert_array_equal(np.isfinite(found), known)
    behind = slice(n // 2 + lost + 1, n)
    alone = deconvolved(track(s[: n - behind.start], d[behind], CUTOFF))
    np.testing.assert_allclose(found[behind], alone, atol=1e-15)
    assert not found.flags.writeable


def test_an_alignment_without_cutoff_is_as_it_is() -> None:
    whole = track()
    assert deconvolved(whole) is whole.alignment


@pytest.mark.parametrize(("std", "usual", "known"), [(0.249e-3, 1e-5, True), (0.251e-3, 1e-5, False),
                                                     (0.29e-3, 1e-4, True), (0.31e-3, 1e-4, False)])  # fmt: skip
def test_a_place_far_less_certain_than_the_rest_is_left_out(std: float, usual: float, *, known: bool) -> None:
    stds = np.where(np.arange(len(S)) == 100, std, usual)
    passed = replace(track(), alignment_std=stds, passes=np.ones(len(S), dtype=np.int64))
    found = alignment_at(np.array([150.0, 200.0]), passed, 40.0)
    assert np.isfinite(found).tolist() == [True, known]
    unpassed = replace(passed, passes=np.zeros(len(S), dtype=np.int64))
    assert np.isfinite(alignment_at(np.array([200.0]), unpassed, 40.0)).all()
