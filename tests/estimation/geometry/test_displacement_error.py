"""What an error of the displacement does to a curve, and whether intervals know: against samples that are drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.contact.conicity import equivalent_conicity
from estimation.geometry.conicity import CurveEstimates, CurveParameters, CurveReplicates, curve_estimates
from estimation.geometry.parameters import PRIORS
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import FloatArray

WIDTH = 0.25e-3  # m
EDGES = (np.arange(-20, 22) - 0.5) * WIDTH
CENTRE = 0.5 * (EDGES[:-1] + EDGES[1:])
BINS, GROUPS, SAMPLES = len(CENTRE), 12, 24_000
SPREAD, NOISE = 1.6e-3, 0.02e-3  # m, of the displacement, of the radius difference
SEEDS = 6
NO_ERROR = DisplacementError(0.0, 0.0, 0.0)
PARAMETERS = CurveParameters()


def smooth(x: FloatArray) -> FloatArray:
    return 0.2 * x + 3e3 * x**3


def stepped(x: FloatArray) -> FloatArray:
    """Return a curve with two contact jumps, each inside a bin."""
    jumps = 0.25e-3 * (x > 1.1e-3) - 0.2e-3 * (x < -1.6e-3)
    return 0.1 * x + 3e3 * x**3 + jumps


@cache
def drawn(curve: Callable[[FloatArray], FloatArray], std: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return quadratics (1 + groups, bins, 3) fitted to samples whose displacement has an error, and their number."""
    rng = np.random.default_rng(seed)
    x = SPREAD * rng.standard_normal(SAMPLES)
    difference = curve(x) + NOISE * rng.standard_normal(SAMPLES)
    measured = x + std * rng.standard_normal(SAMPLES)
    at = (measured - EDGES[0]) / WIDTH
    inside = (at >= 0) & (at < BINS)
    index = at[inside].astype(int)
    u = at[inside] - index - 0.5
    powers = np.stack([np.ones_like(u), u, u**2], axis=1)
    products = np.concatenate(
        [powers[:, :, None] * powers[:, None, :], (powers * difference[inside, None])[..., None]], 2
    )
    sums = np.zeros((GROUPS, BINS, 3, 4))
    np.add.at(sums, (rng.integers(0, GROUPS, len(u)), index), products)
    replicates = np.concatenate([[sums.sum(axis=0)], sums.sum(axis=0) - sums])
    samples = sums[..., 0, 0].sum(axis=0)
    found = np.full((1 + GROUPS, BINS, 3), np.nan)
    many = samples > 100
    found[:, many] = np.linalg.solve(replicates[:, many, :, :3], replicates[:, many, :, 3:])[..., 0]
    return found, samples


def estimates(
    curve: Callable[[FloatArray], FloatArray], std: float, seed: int, error: DisplacementError | None = None
) -> CurveEstimates:
    difference, samples = drawn(curve, std, seed)
    assumed = error or DisplacementError.of(std, CENTRE, samples, integrated=False)
    certain = np.zeros((BINS, 1, 3))  # vehicle parameters are known
    return curve_estimates(
        CurveReplicates(EDGES, difference, certain, samples > 100, assumed, 10.0, band_limited=True), PARAMETERS
    )


def judged(
    curve: Callable[[FloatArray], FloatArray], std: float, error: DisplacementError | None = None
) -> tuple[float, float]:
    """Return the share of intervals of the conicity that cover, and their mean half width."""
    x = np.linspace(-6e-3, 6e-3, 24_001)
    true = equivalent_conicity(x, curve(x), PARAMETERS.amplitudes)
    covered, half = [], []
    for seed in range(SEEDS):
        for estimate, value in zip(estimates(curve, std, seed, error).conicity, true, strict=True):
            if estimate.low is not None and estimate.high is not None:
                covered.append(estimate.low <= value <= estimate.high)
                half.append(0.5 * (estimate.high - estimate.low))
    assert len(covered) > 10 * SEEDS
    return float(np.mean(covered)), float(np.mean(half))


@pytest.mark.parametrize("std", [0.0, 0.1e-3, 0.2e-3, 0.3e-3])
@pytest.mark.parametrize("curve", [smooth, stepped])
def test_intervals_cover_whatever_the_error_of_the_displacement(
    curve: Callable[[FloatArray], FloatArray], std: float
) -> None:
    covered, half = judged(curve, std)
    assert covered > 0.93
    assert half < 0.015


def test_without_what_is_known_of_the_error_they_would_not() -> None:
    assert judged(smooth, 0.3e-3, NO_ERROR)[0] < 0.5


def test_a_jump_inside_a_bin_widens_the_intervals_of_amplitudes_near_it() -> None:
    """Bins cannot place a jump; the conicity depends on its place just above it, and hardly far above."""
    width = [
        np.array([e.high - e.low if e.high is not None and e.low is not None else np.nan for e in found.conicity])
        for found in (estimates(stepped, 0.0, 1), estimates(smooth, 0.0, 1))
    ]
    near = np.abs(np.array(PARAMETERS.amplitudes) - 1.25e-3) < 0.3e-3
    assert (width[0][near] > 3 * width[1][near]).all()
    assert np.nanmax(width[0][near]) > 2 * np.nanmin(width[0])


@pytest.mark.parametrize("std", [0.1e-3, 0.4e-3])
def test_a_measured_displacement_is_too_large_by_the_excess(std: float) -> None:
    rng = np.random.default_rng(1)
    x = SPREAD * rng.standard_normal(400_000)
    measured = x + std * rng.standard_normal(400_000)
    samples = np.histogram(measured, EDGES)[0].astype(float)
    found = DisplacementError.of(std, CENTRE, samples, integrated=False)
    assert 1.0 - found.excess == pytest.approx(float(measured @ x / (measured @ measured)), abs=0.003)


def test_the_excess_is_bounded_and_scale_errors_add_up() -> None:
    samples = np.ones(BINS)
    assert DisplacementError.of(1.0, CENTRE, samples, integrated=False).excess == PRIORS.most_error_share
    assert DisplacementError.of(1e-4, CENTRE, 0 * samples, integrated=False).excess == 0.0
    alone = DisplacementError.of(1e-4, CENTRE, samples, integrated=True).scale
    both = DisplacementError.of(1e-4, CENTRE, samples, integrated=True, scale=0.02).scale
    assert both == pytest.approx(np.hypot(alone, 0.02))
    assert DisplacementError.of(1e-4, CENTRE, samples, integrated=False, scale=0.02).scale == 0.02


@given(
    coefficients=st.tuples(st.floats(-0.3, 0.3), st.floats(-20, 20), st.floats(-4e3, 4e3)),
    std=st.floats(0.01e-3, 0.3e-3),
)
def test_rounding_is_the_mean_over_a_normal_error(coefficients: tuple[float, float, float], std: float) -> None:
    """Of a + b x + c x^2 + d x^3 the mean over x + N(0, std) adds c std^2 + 3 d x std^2."""
    b, c, d = coefficients
    x = np.linspace(-3e-3, 3e-3, 1201)
    values = b * x + c * x**2 + d * x**3
    inner = np.abs(x) < 2e-3
    expected = values + c * std**2 + 3 * d * x * std**2
    rounded = DisplacementError(std, 0.0, 0.0).rounded(x, values)
    np.testing.assert_allclose(rounded[inner], expected[inner], atol=1e-9)


def test_what_is_left_unknown_of_bins_is_their_stretch_and_nothing_without_a_curve() -> None:
    line = 0.2 * CENTRE
    everywhere = np.ones(BINS, dtype=np.bool_)
    error = DisplacementError(0.0, 0.03, 0.04)
    left = error.std_of_bins(CENTRE, line, everywhere, everywhere)
    np.testing.assert_allclose(left, 0.05 * 0.2 * np.abs(CENTRE), atol=1e-12)
    some = np.abs(CENTRE) < 2e-3
    np.testing.assert_array_equal(error.std_of_bins(CENTRE, line, some, everywhere)[~some], 0.0)
    one = np.arange(BINS) == 3
    assert not error.std_of_bins(CENTRE, line, one, one).any()


def test_samples_cross_a_jump_into_the_bins_beside_it() -> None:
    error = DisplacementError(0.2e-3, 0.0, 0.0)
    values = 0.3e-3 * (CENTRE > 1.1e-3)
    everywhere = np.ones(BINS, dtype=np.bool_)
    left = error.std_of_bins(CENTRE, values, everywhere, everywhere)
    beside = int(np.searchsorted(CENTRE, 1.1e-3))
    assert left[beside] > 0.02e-3
    assert left[beside - 1] > 0.02e-3
    assert left[beside - 8] == pytest.approx(0.0, abs=1e-9)
    quiet = replace(error, std=0.0).std_of_bins(CENTRE, values, everywhere, everywhere)
    np.testing.assert_allclose(quiet, 0.0, atol=1e-15)
