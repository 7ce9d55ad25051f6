"""Equivalent conicity: exact curves, an independent integration, cross-checks, and the rules for awkward curves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.conicity_methods import harmonic_conicity, linear_regression_conicity
from scipy.integrate import quad
from scipy.optimize import brentq

from estimation.contact.conicity import (
    equivalent_conicity,
    nonlinearity_parameter,
    zero_crossing,
)
from estimation.errors import ParameterError

Y = np.linspace(-10e-3, 10e-3, 401)
AMPLITUDES = np.arange(1, 7) * 1e-3


@given(tangent=st.floats(0.01, 1.0), offset=st.floats(-2e-3, 2e-3))
def test_a_straight_line_has_half_its_slope(tangent: float, offset: float) -> None:
    difference = 2 * tangent * (Y - offset)
    for method in (equivalent_conicity, harmonic_conicity, linear_regression_conicity):
        np.testing.assert_allclose(method(Y, difference, AMPLITUDES), tangent, rtol=1e-4)
    assert zero_crossing(Y, difference) == pytest.approx(offset, abs=1e-9)
    assert nonlinearity_parameter(Y, difference) == pytest.approx(0.0, abs=1e-6)


def test_a_cubic_against_the_pendulum_like_closed_form() -> None:
    """Delta r = c y^3: I = integral dy / sqrt(c/4 (A^4 - y^4)), the lemniscate integral, so tan grows with A^2."""
    c = 4e4
    lemniscate = 2 * quad(lambda t: 1 / math.sqrt(1 - t**4), 0, 1)[0]
    expected = math.pi**2 * c * AMPLITUDES**2 / (4 * lemniscate**2)
    y = np.linspace(-8e-3, 8e-3, 4001)
    np.testing.assert_allclose(equivalent_conicity(y, c * y**3, AMPLITUDES), expected, rtol=2e-4)
    assert nonlinearity_parameter(y, c * y**3) == pytest.approx((expected[3] - expected[1]) / 2, rel=1e-3)


def test_an_asymmetric_curve_against_an_independent_integration() -> None:
    """Turning points by root finding, the wavelength by adaptive quadrature, S as a polynomial."""
    a, b = 0.5, 30.0
    y = np.linspace(-9e-3, 9e-3, 3601)

    def potential(x: float) -> float:
        return a * x**2 / 2 + b * x**3 / 3

    for amplitude in (1e-3, 2.5e-3, 4e-3):
        high = brentq(lambda x, half=amplitude: potential(x) - potential(x - 2 * half), 0.0, 2 * amplitude)
        level, middle = potential(high), high - amplitude

        def travel(angle: float, middle: float = middle, half: float = amplitude, level: float = level) -> float:
            return half * math.cos(angle) / math.sqrt(level - potential(middle + half * math.sin(angle)))

        expected = (math.pi / quad(travel, -math.pi / 2, math.pi / 2)[0]) ** 2
        assert equivalent_conicity(y, a * y + b * y**2, [amplitude])[0] == pytest.approx(expected, rel=1e-3)


def test_harmonic_linearisation_agrees_on_a_smooth_curve_and_regression_does_not() -> None:
    difference = 0.3 * Y + 3e3 * Y**3
    exact = equivalent_conicity(Y, difference, AMPLITUDES)
    assert np.abs(harmonic_conicity(Y, difference, AMPLITUDES) - exact).max() < 0.006
    assert np.abs(linear_regression_conicity(Y, difference, AMPLITUDES) - exact).max() > 0.006


def test_amplitudes_that_leave_the_curve_are_not_known() -> None:
    y = np.linspace(-3e-3, 5e-3, 81)
    found = equivalent_conicity(y, 0.4 * (y - 1e-3), [2e-3, 3.9e-3, 4.1e-3])
    np.testing.assert_allclose(found[:2], 0.2, rtol=1e-6)
    assert math.isnan(found[2])
    assert math.isnan(nonlinearity_parameter(y[:60], 0.4 * y[:60]))


def test_a_curve_without_an_upward_crossing_has_no_conicity() -> None:
    for difference in (0.4 * Y + 0.1, -0.4 * Y, np.zeros_like(Y)):
        assert np.isnan(equivalent_conicity(Y, difference, AMPLITUDES)).all()
        assert math.isnan(zero_crossing(Y, difference))


def test_on_a_stretch_of_zeros_the_middle_counts_and_the_conicity_is_zero() -> None:
    difference = 0.8 * (np.maximum(Y - 2e-3, 0.0) + np.minimum(Y + 1e-3, 0.0))
    assert zero_crossing(Y, difference) == pytest.approx(0.5e-3, abs=5e-5)
    found = equivalent_conicity(Y, difference, [0.5e-3, 1.4e-3, 4e-3])
    np.testing.assert_allclose(found[:2], 0.0, atol=1e-6)
    assert found[2] > 0.05


def test_of_several_crossings_the_deepest_equilibrium_counts() -> None:
    knots = np.array([-8, -6, -5, -4, 2, 8.0]) * 1e-3
    values = np.array([-0.2, 0.1, 0.1, -0.6, 0.0, 3.0]) * 1e-3
    assert zero_crossing(knots, values) == pytest.approx(2e-3)


def test_where_the_potential_falls_outwards_the_wheelset_comes_to_rest() -> None:
    knots = np.array([-8, 0, 2, 3, 4, 8.0]) * 1e-3
    values = np.array([-8, 0, 1.0, -1.0, 1.0, 9.0]) * 1e-3
    found = equivalent_conicity(knots, values, np.array([0.5, 1.0, 2.1, 5.0]) * 1e-3)
    np.testing.assert_allclose(found[:2], [0.354, 0.354], atol=0.1)
    assert found[2] == 0.0
    assert found[3] > 0.05


@given(seed=st.integers(0, 2**32 - 1), noise=st.floats(0.0, 2e-4))
def test_an_estimated_curve_gives_finite_values_near_the_truth(seed: int, noise: float) -> None:
    y = np.linspace(-7e-3, 7e-3, 29)
    measured = 0.5 * y + noise * np.random.default_rng(seed).standard_normal(29)
    found = equivalent_conicity(y, measured, [2e-3, 3e-3, 4e-3])
    np.testing.assert_allclose(found, 0.25, atol=0.01 + 600 * noise)


def test_points_that_are_not_known_are_left_out() -> None:
    difference = 0.4 * Y
    difference[[3, 150, 200]] = np.nan
    np.testing.assert_allclose(equivalent_conicity(Y, difference, AMPLITUDES), 0.2, rtol=1e-6)
    assert np.isnan(equivalent_conicity(Y, np.full_like(Y, np.nan), AMPLITUDES)).all()
    assert np.isnan(equivalent_conicity([], [], AMPLITUDES)).all()


def test_impossible_arguments_are_refused() -> None:
    with pytest.raises(ParameterError, match="shape"):
        equivalent_conicity(Y, Y[:-1], AMPLITUDES)
    with pytest.raises(ParameterError, match="increase"):
        equivalent_conicity(Y[::-1], Y, AMPLITUDES)
    for bad in ([0.0], [-1e-3], [float("nan")]):
        with pytest.raises(ParameterError, match="positive"):
            equivalent_conicity(Y, Y, bad)
