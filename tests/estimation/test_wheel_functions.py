"""One radius function per wheel out of places where a wheelset sat; what they say of size and sign of a gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gauge_passes import Wheels
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.track.gauge.wheel_functions import (
    WHEELS,
    ContactSamples,
    WheelFunctions,
    fit_wheels,
    gauge_factor,
    gauge_shift_of,
    gauge_sign,
    remove_common_shift,
)
from estimation.values.arrays import FloatArray
from estimation.values.track import GaugeShift

SAMPLES = 6000
SEEN = np.linspace(-2.5e-3, 2.5e-3, 51)  # m, where many samples were


def contact_samples(cone: float, *, size: float = 1.0, seed: int = 1, noise: float = 2e-6) -> ContactSamples:
    """Return contact samples of wheels of ``cone`` whose gauge deviation is given ``size`` times too small."""
    rng = np.random.default_rng(seed)
    x, e = 2e-3 * rng.standard_normal(SAMPLES), 2e-3 * rng.standard_normal(SAMPLES)
    difference = Wheels(cone).difference(x, e) + noise * rng.standard_normal(SAMPLES)
    return ContactSamples(x, np.zeros(SAMPLES), difference, e / size)


def without_constant(values: FloatArray) -> FloatArray:
    return np.asarray(values - values.mean())


def true_shift(cone: float, difference: FloatArray, gauge: float) -> FloatArray:
    """Return x at R (n,) and a gauge deviation less x at R and nominal gauge, read off R over x."""
    x = np.linspace(-9e-3, 9e-3, 20_001)
    at, nominal = (np.interp(difference, Wheels(cone).difference(x, np.full_like(x, e)), x) for e in (gauge, 0.0))
    return np.asarray(at - nominal)


@pytest.mark.parametrize("cone", [0.05, 0.16])
def test_the_radius_of_each_wheel_comes_out_up_to_a_constant(cone: float) -> None:
    found = fit_wheels(contact_samples(cone))
    for side in ("left", "right"):
        radius = np.interp(SEEN, found.knots, getattr(found, side))
        true = getattr(Wheels(cone), side)(SEEN)
        np.testing.assert_allclose(without_constant(radius), without_constant(true), atol=3e-6)


@pytest.mark.parametrize("cone", [0.05, 0.16])
@pytest.mark.parametrize("gauge", [-2e-3, 1e-3])
def test_where_a_gauge_puts_a_wheelset_is_where_its_radii_differ_as_much(cone: float, gauge: float) -> None:
    table = gauge_shift_of(fit_wheels(contact_samples(cone)))
    difference = Wheels(cone).difference(np.linspace(-2e-3, 2e-3, 41), np.zeros(41))
    found = table.at(difference, np.full(41, gauge))
    np.testing.assert_allclose(found, true_shift(cone, difference, gauge), atol=0.03e-3)
    np.testing.assert_allclose(table.at(difference, np.zeros(41)), 0.0, atol=1e-15)


def test_a_contact_jump_is_a_step_of_the_radius_difference_that_moves_with_the_gauge() -> None:
    """R at the foot of the step of the left wheel: half the gauge deviation further out, whatever its size."""
    knots = np.linspace(-9e-3, 9e-3, 721)
    jump = np.where(knots > 1e-3, 0.3e-3, 0.0)
    table = gauge_shift_of(WheelFunctions(knots, 0.1 * knots + jump, 0.1 * knots))
    before, after = 0.2 * 0.9e-3, 0.2 * 1.1e-3 + 0.3e-3  # at nominal gauge, on both sides of the step
    middle = np.array([0.5 * (before + after)])
    for gauge in (-1e-3, 1e-3):
        assert table.at(middle, np.array([gauge]))[0] == pytest.approx(gauge / 2, abs=0.06e-3)


def test_a_radius_difference_that_falls_is_never_run_through() -> None:
    knots = np.linspace(-9e-3, 9e-3, 181)
    hollow = 0.1 * knots - np.where(knots > 1e-3, 0.2e-3, 0.0)
    table = gauge_shift_of(WheelFunctions(knots, hollow, 0.1 * knots))
    assert np.isfinite(table.shift).all()
    assert np.abs(table.shift).max() < 22e-3


@settings(max_examples=20)
@given(
    slopes=st.tuples(st.floats(0.05, 0.3), st.floats(0.05, 0.3)),
    R=st.floats(-0.5e-3, 0.5e-3),
    e=st.floats(-4e-3, 4e-3),
)
def test_of_straight_wheels_a_gauge_shifts_by_the_share_of_their_slopes(
    slopes: tuple[float, float], R: float, e: float
) -> None:
    """From sL (x - e/2) + sR (x + e/2) = R."""
    knots = np.linspace(-9e-3, 9e-3, 19)
    table = gauge_shift_of(WheelFunctions(knots, slopes[0] * knots, slopes[1] * knots))
    expected = 0.5 * e * (slopes[0] - slopes[1]) / (slopes[0] + slopes[1])
    assert table.at(np.array([R]), np.array([e]))[0] == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("size", [0.6, 1.0, 1.7])
def test_a_gauge_of_wrong_size_is_put_nearer_and_one_of_right_size_stays(size: float) -> None:
    """The rounds ask again."""
    seen = {
        f"W{number}": contact_samples(cone, size=size, seed=number) for number, cone in enumerate((0.05, 0.1, 0.16))
    }
    left = abs(np.log(size / gauge_factor(seen)))
    assert left < 0.1 + 0.6 * abs(np.log(size))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_sign_of_a_gauge_is_that_which_makes_wheels_steeper_towards_the_flange(sign: int) -> None:
    seen = {
        f"W{number}": contact_samples(cone, size=sign, seed=number) for number, cone in enumerate((0.05, 0.1, 0.16))
    }
    shifts = {name: gauge_shift_of(fit_wheels(one.inliers())) for name, one in seen.items()}
    assert gauge_sign(seen, shifts) == sign


def test_what_all_wheelsets_do_alike_belongs_to_the_track() -> None:
    tables = {f"W{cone}": gauge_shift_of(fit_wheels(contact_samples(cone))) for cone in (0.05, 0.1, 0.16)}
    left = remove_common_shift(tables)
    middle = len(tables["W0.1"].difference) // 2
    at_zero = np.stack([one.shift[middle] for one in left.values()])
    np.testing.assert_allclose(at_zero.mean(axis=0), 0.0, atol=1e-12)
    for name, one in left.items():  # what is apart between wheelsets, and over R, stays
        taken = tables[name].shift - one.shift
        np.testing.assert_allclose(taken, np.broadcast_to(taken[0], taken.shape), atol=1e-12)


def test_places_that_the_model_does_not_reach_are_left_out() -> None:
    seen = contact_samples(0.1)
    misfit = np.where(np.arange(SAMPLES) % 3 == 0, 2 * WHEELS.inlier_misfit, 0.0)
    inliers = replace(seen, misfit=misfit).inliers()
    np.testing.assert_array_equal(inliers.displacement, seen.displacement[misfit == 0.0])
    assert len(seen.inliers(4).gauge) == SAMPLES / 4


@given(R=st.floats(-8e-3, 8e-3), e=st.floats(-9e-3, 9e-3))
def test_between_the_grids_a_shift_is_straight_and_beyond_them_flat(R: float, e: float) -> None:
    difference, gauge = np.linspace(-5e-3, 5e-3, 11), np.linspace(-4e-3, 4e-3, 5)
    table = GaugeShift(difference, gauge, 0.1 * difference[:, None] + 0.3 * gauge[None, :])
    expected = 0.1 * np.clip(R, -5e-3, 5e-3) + 0.3 * np.clip(e, -4e-3, 4e-3)
    assert table.at(np.array([R]), np.array([e]))[0] == pytest.approx(expected, abs=1e-12)


def test_shifts_over_many_gauges_are_those_at_each() -> None:
    draw = np.random.default_rng(4)
    table = GaugeShift(np.linspace(-5e-3, 5e-3, 11), np.linspace(-4e-3, 4e-3, 5), 1e-3 * draw.standard_normal((11, 5)))
    R, e = draw.uniform(-7e-3, 7e-3, 40), draw.uniform(-6e-3, 6e-3, 9)
    one_by_one = table.at(np.repeat(R, len(e)), np.tile(e, len(R))).reshape(len(R), len(e))
    np.testing.assert_allclose(table.over(R, e), one_by_one, rtol=0, atol=1e-15)
