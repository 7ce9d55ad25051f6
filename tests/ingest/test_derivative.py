"""The derivative of rates and angles: the trapezoidal integral of it is what was measured, and noise stays bounded."""

from __future__ import annotations

import numpy as np
import pytest

from ingest.units import REACH, clipped_reach, derivative, derivative_with_gaps

DT = 0.004


def integral(values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * DT * (values[1:] + values[:-1]))])


@pytest.mark.parametrize(("hertz", "share"), [(1.0, 1e-9), (10.0, 1e-7), (40.0, 4e-3)])
def test_the_running_integral_of_the_derivative_is_the_signal(hertz: float, share: float) -> None:
    t = DT * np.arange(5000)
    rate = np.sin(2 * np.pi * hertz * t + 0.3)
    found = integral(derivative(rate, DT)[REACH:-REACH])
    expected = rate[REACH:-REACH] - rate[REACH]
    assert np.abs(found - expected - (found - expected).mean()).max() < share


def test_an_angle_is_differentiated_twice() -> None:
    t = DT * np.arange(5000)
    found = derivative(np.sin(12.0 * t), DT, times=2)
    assert np.isnan(found[: 2 * REACH]).all()
    assert np.nanmax(np.abs(found + 144.0 * np.sin(12.0 * t))) < 0.1  # the trapezoidal rule itself is off by (w dt)^2/6
    inside = found[2 * REACH : -2 * REACH]
    slope = integral(inside)
    slope += 12.0 * np.cos(12.0 * t[2 * REACH]) - slope[0]
    assert np.abs(slope - slope.mean() - 12.0 * np.cos(12.0 * t[2 * REACH : -2 * REACH])).max() < 0.15


def test_noise_of_a_gyroscope_does_not_grow_with_time() -> None:
    noise = np.random.default_rng(1).standard_normal(200_000)
    found = derivative(noise, 1.0)
    assert np.nanstd(found[-50_000:]) == pytest.approx(np.nanstd(found[:50_000]), rel=0.05)


def test_what_is_near_a_long_gap_is_not_known_and_short_gaps_are_bridged() -> None:
    tick = np.arange(1000, 2000)
    rate = np.sin(0.02 * tick)
    values = rate.copy()
    values[100] = np.nan
    kept = np.ones(1000, bool)
    kept[500:530] = False
    found = derivative_with_gaps(tick[kept], values[kept], DT, bridged=3)
    whole = derivative(rate, DT)[kept]
    assert np.isnan(found[100])
    assert np.isnan(found[500 - REACH : 500 + REACH]).all()
    known = ~np.isnan(found)
    assert known.sum() == 1000 - 30 - 1 - 4 * REACH
    assert np.abs(found[known] - whole[known]).max() < 2e-3 * np.nanmax(np.abs(whole))


def test_a_clipped_rate_clips_the_derivatives_that_it_is_part_of() -> None:
    flags = np.zeros(50, bool)
    flags[20] = True
    assert np.flatnonzero(clipped_reach(flags)).tolist() == list(range(20 - REACH, 20 + REACH + 1))
