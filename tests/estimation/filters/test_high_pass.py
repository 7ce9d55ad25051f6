"""The high-pass against a Kalman filter with its smoother, and what it must take out whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.filters import remove_wander, subtract_smoothing_spline
from estimation.values.arrays import FloatArray

CUT_OFF = 40.0
STEP = 0.5


def rauch_tung_striebel(u: FloatArray, step: float, cutoff_wavelength: float) -> FloatArray:
    """Return u less the smoothed state of a third-order integrated random walk, sample by sample."""
    mu = (cutoff_wavelength / (2 * np.pi)) ** 6
    A = np.array([[1, step, step**2 / 2], [0, 1, step], [0, 0, 1]])
    h = step
    Q = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])
    Q, R = Q / mu, 1 / step  # sum of step (u - w)^2 + mu integral of w'''^2
    means, covariances, predicted = [], [], []
    m, P = np.zeros(3), np.diag([1e6, 1e4, 1e2])
    for k, value in enumerate(u):
        if k:
            m, P = A @ m, A @ P @ A.T + Q
        predicted.append((m, P))
        gain = P[:, 0] / (P[0, 0] + R)
        m, P = m + gain * (value - m[0]), P - np.outer(gain, P[0])
        means.append(m)
        covariances.append(P)
    smooth = [means[-1]]
    for k in range(len(u) - 2, -1, -1):
        G = np.linalg.solve(predicted[k + 1][1], A @ covariances[k]).T
        smooth.append(means[k] + G @ (smooth[-1] - predicted[k + 1][0]))
    return u - np.array(smooth[::-1])[:, 0]


def high_passed(u: FloatArray, distance: FloatArray) -> FloatArray:
    return remove_wander(u[None, :], distance, np.ones(len(u), dtype=bool), CUT_OFF)[0]


def test_the_smoother_is_the_kalman_smoother_of_the_wander() -> None:
    s = STEP * np.arange(800)
    rng = np.random.default_rng(1)
    u = np.cumsum(np.cumsum(rng.standard_normal(len(s)))) * 0.01 + rng.standard_normal(len(s))
    expected = rauch_tung_striebel(u, STEP, CUT_OFF)
    found = subtract_smoothing_spline(u[None, :], s, np.ones(len(s), dtype=bool), CUT_OFF, np.empty((0, len(s))))[0]
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.std())


@pytest.mark.parametrize(("wavelength", "left"), [(20.0, 64 / 65), (40.0, 0.5), (80.0, 1 / 65)])
def test_what_is_left_of_a_wave_follows_the_formula(wavelength: float, left: float) -> None:
    s = STEP * np.arange(4000)
    wave = np.cos(2 * np.pi * s / wavelength)
    inner = slice(400, -400)
    found = high_passed(wave, s)[inner]
    assert found @ wave[inner] / (wave[inner] @ wave[inner]) == pytest.approx(left, abs=0.01)


@settings(max_examples=15)
@given(
    seed=st.integers(0, 10_000),
    gaps=st.lists(st.tuples(st.integers(300, 2500), st.integers(2, 60)), max_size=3),
)
def test_what_offsets_and_gaps_integrate_to_is_taken_out_whole(seed: int, gaps: list[tuple[int, int]]) -> None:
    """Whatever the speed: a line and a parabola in time, and after each gap a jump and a line."""
    rng = np.random.default_rng(seed)
    n = 3000
    t = np.arange(n) * 4e-3
    speed = 15.0 + rng.uniform(-0.5, 0.8) * t
    distance = np.concatenate([[0.0], np.cumsum(speed[1:] * 4e-3)])
    known = np.ones(n, dtype=bool)
    wander = rng.normal(0, 1, 3) @ np.stack([np.ones(n), t, t * t])
    for at, length in gaps:
        known[at : at + length] = False
        wander = wander + np.where(np.arange(n) >= at + length // 2, rng.normal() + rng.normal() * (t - t[at]), 0.0)
    signal = rng.standard_normal(n)
    parts = np.stack([signal, signal + wander])
    parts[:, ~known] = rng.normal(0, 100)  # what stands in a gap counts for nothing
    alone, wandering = remove_wander(parts, distance, known, CUT_OFF)
    np.testing.assert_allclose(wandering[known], alone[known], atol=1e-3)


def test_half_the_speed_is_half_the_frequency() -> None:
    """The filter goes by distance: the same track passed at two speeds loses the same waves."""
    rng = np.random.default_rng(3)
    s = np.linspace(0.0, 600.0, 6001)
    track = np.interp(s, np.arange(0, 601, 5), rng.standard_normal(121))
    fast, slow = (high_passed(np.interp(at, s, track), at) for at in (s, np.linspace(0.0, 600.0, 12_001)))
    inner = slice(500, -500)
    np.testing.assert_allclose(slow[::2][inner], fast[inner], atol=2e-3)
