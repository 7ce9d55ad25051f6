"""What an error of the displacement leaves unknown, against the calculation bin by bin."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import BoolArray, FloatArray

WIDTH = 0.25e-3
CENTRE = WIDTH * np.arange(-8, 9)
BINS = len(CENTRE)
EVERY = np.ones(BINS, dtype=bool)
SAMPLES = np.full(BINS, 10.0)
VARIANCE = float((CENTRE**2).mean())


def test_integration_leaves_three_per_mille_of_scale_and_five_micrometres_of_origin() -> None:
    ideal = DisplacementError.of(0.0, CENTRE, SAMPLES, integrated=False)
    assert (ideal.scale, ideal.origin, ideal.jump_position_std) == (0.0, 0.0, 0.0)
    real = DisplacementError.of(0.0, CENTRE, SAMPLES, integrated=True)
    assert (real.scale, real.origin) == (pytest.approx(0.003), pytest.approx(5e-6))
    more = DisplacementError.of(0.0, CENTRE, SAMPLES, integrated=True, scale=0.004, jump_position_std=1e-4)
    assert (more.scale, more.jump_position_std) == (pytest.approx(0.005), 1e-4)


@pytest.mark.parametrize(("share", "excess"), [(0.04, 0.04), (0.19, 0.19), (0.21, 0.2), (3.0, 0.2)])
def test_the_excess_is_the_share_of_the_variance_up_to_a_fifth(share: float, excess: float) -> None:
    found = DisplacementError.of(np.sqrt(share * VARIANCE), CENTRE, SAMPLES, integrated=False)
    assert found.excess == pytest.approx(excess)
    assert found.std == pytest.approx(np.sqrt(share * VARIANCE))


def test_the_variance_is_that_of_the_samples() -> None:
    two = np.where(np.abs(np.abs(CENTRE) - 1e-3) < 1e-9, 5.0, 0.0)
    assert DisplacementError.of(0.1e-3, CENTRE, two, integrated=False).excess == pytest.approx(0.01)
    assert DisplacementError.of(0.1e-3, CENTRE, 0 * two, integrated=False).excess == 0.0
    at_zero = np.where(CENTRE == 0.0, 5.0, 0.0)
    assert DisplacementError.of(0.1e-3, CENTRE, at_zero, integrated=False).excess == 0.0


@pytest.mark.parametrize(
    ("excess", "left", "mean", "expected"),
    [
        (0.0, 0.0, 0.0, 0.03e-3),
        (0.5e-3, 0.0, 0.0, 0.05e-3),
        (0.0, 0.3e-3, 0.0, 0.0949e-3),
        (0.0, 0.3e-3, 0.1e-3, 0.1378e-3),
    ],
)
def test_a_contact_jump_is_placed_to_hundredths_of_a_millimetre_and_less_well_by_blur(
    excess: float, left: float, mean: float, expected: float
) -> None:
    error = DisplacementError.of(0.1e-3, CENTRE, SAMPLES, integrated=True, jump_mean_std=mean)
    assert error.jump_place_std(excess, left) == pytest.approx(expected, rel=1e-3)


def rounded(std: float, x: FloatArray, values: FloatArray) -> FloatArray:
    """Return the mean over a normal error by three-point Gauss-Hermite; straight lines go on beyond the ends."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    result = np.zeros(len(x))
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        for k, place in enumerate(x + node * std):
            i = int(np.clip(np.searchsorted(x, place) - 1, 0, len(x) - 2))
            slope = (values[i + 1] - values[i]) / (x[i + 1] - x[i])
            result[k] += weight * (values[i] + slope * (place - x[i]))
    return result


CURVE = 0.2 * CENTRE + 4e4 * CENTRE**3 + 0.1e-3 * (CENTRE > 0.6e-3) + 2e-4


def test_a_curve_is_rounded_by_the_error() -> None:
    for std in (0.1e-3, 0.3e-3):
        found = DisplacementError(std, 0.0, 0.0).rounded(CENTRE, CURVE)
        np.testing.assert_allclose(found, rounded(std, CENTRE, CURVE), atol=1e-12)


def slow_std(error: DisplacementError, smooth: BoolArray, observed: BoolArray) -> FloatArray:
    """Return the std bin by bin: scale, origin and a quarter of the place of jumps, scatter over 2.5 std."""
    x, values = CENTRE[smooth], CURVE[smooth]
    slope = np.gradient(values, x)
    middle = np.interp(0.0, x, values)
    scatter = np.hypot(2.5 * error.std, error.jump_position_std)
    lost = np.zeros(BINS)
    lost[observed] = rounded(float(scatter), CENTRE[observed], CURVE[observed]) - CURVE[observed]
    result = np.zeros(BINS)
    for k, b in enumerate(np.flatnonzero(smooth)):
        stretch = max(abs(slope[k] * x[k]), abs(values[k] - middle))
        by_scale = stretch**2 * (error.excess**2 + error.scale**2)
        by_origin = slope[k] ** 2 * (error.origin**2 + (0.25 * error.jump_position_std) ** 2)
        result[b] = np.sqrt(by_scale + by_origin + lost[b] ** 2)
    return result


@pytest.mark.parametrize(
    "error",
    [
        DisplacementError(0.0, 0.03, 0.04),
        DisplacementError(0.0, 0.0, 0.0, 0.05e-3),
        DisplacementError(0.0, 0.0, 0.0, 0.0, 0.3e-3),
        DisplacementError(0.08e-3, 0.0, 0.0),
        DisplacementError(0.08e-3, 0.02, 0.01, 0.02e-3, 0.2e-3),
    ],
)
def test_what_is_unknown_of_a_bin_is_scale_origin_and_rounding(error: DisplacementError) -> None:
    smooth = EVERY.copy()
    smooth[[11, 15]] = False
    observed = EVERY.copy()
    observed[15] = False
    found = error.std_of_bins(CENTRE, CURVE, smooth, observed)
    np.testing.assert_allclose(found, slow_std(error, smooth, observed), atol=1e-12)
    assert found[smooth].max() > 1e-6
    assert not found[~smooth].any()


def test_two_bins_have_a_slope_and_one_has_none() -> None:
    error = DisplacementError(0.0, 0.0, 0.0, 0.1e-3)
    two, one = np.isin(np.arange(BINS), [8, 9]), np.arange(BINS) == 8
    np.testing.assert_allclose(
        error.std_of_bins(CENTRE, CURVE, two, two)[two], abs(CURVE[9] - CURVE[8]) / WIDTH * 0.1e-3
    )
    assert not error.std_of_bins(CENTRE, CURVE, one, one).any()
