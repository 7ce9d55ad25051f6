"""One radius function per wheel out of places where a wheelset sat, and the size of a gauge that is known in shape."""

from __future__ import annotations

import numpy as np
import pytest
from gauge_passes import Wheels
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.arrays import FloatArray
from estimation.track.wheel_functions import Places, fit, gauge_factor
from estimation.types import WheelFunctions

SEEN = np.linspace(-3e-3, 3e-3, 61)  # m, where many samples were


def places(cone: float, *, size: float = 1.0, seed: int = 1, noise: float = 2e-6) -> Places:
    """Return places of wheels of ``cone`` whose gauge deviation is told ``size`` times too small."""
    rng = np.random.default_rng(seed)
    x, e = 2e-3 * rng.standard_normal(4000), 2e-3 * rng.standard_normal(4000)
    return Places(x, Wheels(cone).difference(x, e) + noise * rng.standard_normal(4000), e / size)


def without_constant(values: FloatArray) -> FloatArray:
    return np.asarray(values - values.mean())


@pytest.mark.parametrize("cone", [0.05, 0.16])
def test_the_radius_of_each_wheel_comes_out_up_to_a_constant(cone: float) -> None:
    found, misfit = fit(places(cone))
    for side in ("left", "right"):
        radius = np.interp(SEEN, found.knots, getattr(found, side))
        true = getattr(Wheels(cone), side)(SEEN)
        np.testing.assert_allclose(without_constant(radius), without_constant(true), atol=3e-6)
    assert np.sqrt(misfit / 4000) == pytest.approx(2e-6, rel=0.2)


def test_what_a_gauge_adds_is_nothing_at_nominal_gauge_and_right_elsewhere() -> None:
    found, _ = fit(places(0.1))
    x = np.linspace(-2e-3, 2e-3, 41)
    np.testing.assert_array_equal(found.gauge_effect(x, np.zeros(41)), np.zeros(41))
    for gauge in (-2e-3, 1e-3):
        e = np.full(41, gauge)
        true = Wheels(0.1).difference(x, e) - Wheels(0.1).difference(x, np.zeros(41))
        np.testing.assert_allclose(found.gauge_effect(x, e), true, atol=5e-6)


@settings(max_examples=20, deadline=None)
@given(
    slopes=st.tuples(st.floats(0.01, 0.3), st.floats(0.01, 0.3)),
    x=st.floats(-4e-3, 4e-3),
    e=st.floats(-4e-3, 4e-3),
)
def test_of_straight_wheels_a_gauge_adds_half_itself_times_the_difference_of_their_slopes(
    slopes: tuple[float, float], x: float, e: float
) -> None:
    knots = np.linspace(-9e-3, 9e-3, 19)
    wheels = WheelFunctions(knots, slopes[0] * knots, slopes[1] * knots)
    expected = 0.5 * e * (slopes[1] - slopes[0])
    assert wheels.gauge_effect(np.array([x]), np.array([e]))[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("size", [0.6, 1.0, 1.7, -1.3])
def test_a_gauge_of_wrong_size_or_sign_is_put_right(size: float) -> None:
    """Wheels that fit best tell the size, wheels that are steeper towards the flange the sign."""
    seen = {f"W{number}": places(cone, size=size, seed=number) for number, cone in enumerate((0.05, 0.1, 0.16))}
    assert gauge_factor(seen) == pytest.approx(size, rel=0.05)
