"""Long waves of the rolling radius difference in a bogie: factors are found where both ways of measuring are good."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from estimation.motion import rolling_radius_difference
from estimation.motion.rolling_radius_difference import FUSED, long_waves_in_bogie
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters

COACH = VehicleParameters(yaw_stiffness=62.8e6)
SOFT = VehicleParameters(yaw_stiffness=2.5e6)
FACTORS = np.array([0.8, 0.6, 1.3])


@dataclass(frozen=True, slots=True)
class BogieYaws:
    """Yaws (m,), rad, that :func:`long_waves_in_bogie` takes."""

    rolling: FloatArray
    creep: FloatArray
    frame: FloatArray


def smooth(seed: int, count: int, size: float) -> FloatArray:
    """Return noise of wavelengths from some 8 m up."""
    values = gaussian_filter1d(np.random.default_rng(seed).standard_normal(count), 1.6 / FUSED.grid_step)
    return np.asarray(size * values / values.std())


def yaws(metres: float) -> BogieYaws:
    count = round(metres / FUSED.grid_step)
    return BogieYaws(smooth(1, count, 1e-3), smooth(2, count, 1e-4), smooth(3, count, 5e-4))


def terms(one: BogieYaws, speed: float, p: VehicleParameters) -> FloatArray:
    """Return rolling, spring and creep terms (3, m), m, written out once more."""
    slope = np.gradient(one.rolling, FUSED.grid_step)
    per_moment = p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    spring = p.yaw_stiffness * (one.rolling - one.frame) + p.yaw_inertia * speed**2 * np.gradient(
        slope, FUSED.grid_step
    )
    rolling = -2.0 * p.half_contact_distance * p.nominal_radius * slope
    return np.stack([rolling, -per_moment * spring, -per_moment * p.yaw_stiffness * one.creep])


def test_factors_are_found_although_the_yaw_sensor_is_noisy() -> None:
    one, V = yaws(3000.0), 20.0
    true = FACTORS @ terms(one, V, COACH)
    noise = smooth(9, len(true), 0.3 * true.std())
    R, stiffness_term = long_waves_in_bogie(true + noise, *astuple(one), np.full(len(true), V), COACH)
    inner = slice(400, -400)
    assert np.std((R - true)[inner]) < 0.06 * true.std(), "a tenth of what the noise would leave, or two"
    rolling = terms(BogieYaws(one.rolling + one.creep, one.creep, one.frame), V, COACH)[0]
    np.testing.assert_allclose(stiffness_term + rolling, R, atol=1e-15)


@pytest.mark.parametrize(("parameters", "divisor"), [(SOFT, None), (COACH, 0.5)])
def test_a_short_pass_has_the_factors_expected_of_gravity(parameters: VehicleParameters, divisor: float | None) -> None:
    """1 + (k_psi/c) g with g of the contact angles of usual pairs, and no less than a half."""
    one, V = yaws(2.9 * FUSED.end_margin), 20.0
    p = parameters
    if divisor is None:
        stiffness = p.load / 2 - p.lateral_spin_creep_coefficient / p.nominal_radius
        g = 0.5 * 112.0 * stiffness / p.lateral_creep_coefficient
        compliance = p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
        divisor = 1.0 + compliance * p.yaw_stiffness * g
        assert 0.5 < divisor < 1.0
    expected = terms(one, V, p).sum(axis=0) / divisor
    R, _ = long_waves_in_bogie(np.zeros(len(expected)), *astuple(one), np.full(len(expected), V), p)
    np.testing.assert_allclose(R, expected, rtol=1e-9, atol=1e-15)


def test_what_is_expected_counts_as_much_as_the_weight_beforehand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the weight beforehand of a pass that shows little brings the factors to what is expected."""
    one = yaws(400.0)
    small = BogieYaws(1e-3 * one.rolling, 1e-3 * one.creep, 1e-3 * one.frame)
    speed = np.full(len(one.rolling), 20.0)
    expected = 2.0 * terms(small, 20.0, COACH).sum(axis=0)
    found, _ = long_waves_in_bogie(np.zeros(len(expected)), *astuple(small), speed, COACH)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.02 * expected.std())
    without = replace(rolling_radius_difference.FUSED, prior_weight=0.0)
    monkeypatch.setattr(rolling_radius_difference, "FUSED", without)
    found, _ = long_waves_in_bogie(np.zeros(len(expected)), *astuple(small), speed, COACH)
    np.testing.assert_allclose(found, 0.0, atol=1e-6 * expected.std())
