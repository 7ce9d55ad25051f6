"""The hidden slow displacement: against every path of a small chain, and on a curve whose jumps are known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimators_by_hand import smoothed_by_enumeration
from smooth_wheelset import ideal, run

from estimation.contact.conicity import equivalent_conicity
from estimation.errors import ParameterError
from estimation.estimators import hidden_displacement
from estimation.estimators.hidden_displacement import GRID, HIDDEN, HiddenDisplacement, smooth, stepped, steps, weigh
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.windows import Motion

LEVER, V = 2 * 0.7452 * 0.45, 20.0
BAND_LIMITED = EstimatorParameters(
    uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0), alignment_noise=4e-5),
    band_limited=True,
)
STILL = (
    "lateral_velocity", "lateral_acceleration", "yaw", "yaw_acceleration", "roll", "roll_rate",
    "suspension_deflection", "suspension_deflection_rate",
)  # fmt: skip
LEFT, RIGHT, SLOPE, STEP = -1.31e-3, 1.14e-3, 0.36, 0.8e-3  # m, m, 1, m


def true_curve(x: np.ndarray) -> np.ndarray:
    return SLOPE * x + STEP * ((x > RIGHT) - 1.0 * (x < LEFT))


@cache
def hidden_motion(seed: int = 1, windows: int = 8, slow: float = 0.08e-3) -> tuple[Motion, ...]:
    """Return windows of 60 s at 250 Hz whose y - d has lost a slow part (``slow``, m, std); R has 0.03 mm of noise."""
    rng, n, dt = np.random.default_rng(seed), 15_000, 4e-3
    found = []
    for window in range(windows):
        t = dt * np.arange(n)
        waves = sum(
            1.0e-3 * np.cos(2 * np.pi * f * t + p)
            for f, p in zip(rng.uniform(0.8, 2.4, 4), rng.uniform(0, 7, 4), strict=True)
        )
        lost = sum(
            slow * np.cos(2 * np.pi * f * t + p)
            for f, p in zip(rng.uniform(0.1, 0.35, 2), rng.uniform(0, 7, 2), strict=True)
        )
        R = true_curve(waves) + 0.03e-3 * rng.standard_normal(n)
        zero = np.zeros(n)
        moved = dict.fromkeys(STILL, zero) | {"displacement": waves - lost, "yaw_rate": -V / LEVER * R}
        moved |= {"speed": np.full(n, V), "valid": np.ones(n, bool), "block": 3 * window + (t / 20.0).astype(np.int64)}
        found.append(Motion(**moved, band_limited=True, sample_interval_s=dt))
    return tuple(found)


def estimated(
    estimator: HiddenDisplacement, motions: tuple[Motion, ...], parameters: EstimatorParameters = BAND_LIMITED
) -> CurveEstimate:
    state = estimator.init(parameters)
    for motion in motions:
        state = estimator.update(state, motion)
    return estimator.result(state)


def errors(found: CurveEstimate) -> np.ndarray:
    """Return the errors of the conicity at 0.75 to 3 mm."""
    x = np.sort(np.concatenate([np.linspace(-6e-3, 6e-3, 2001), [LEFT - 1e-9, LEFT, RIGHT, RIGHT + 1e-9]]))
    true = equivalent_conicity(x, true_curve(x), found.amplitude[1:11])
    given = [np.nan if one.value is None else one.value for one in found.conicity[1:11]]
    return np.abs(np.array(given) - true)


def test_forward_and_backward_give_what_all_paths_give() -> None:
    rng = np.random.default_rng(3)
    likelihood, prior = rng.uniform(size=(5, 3)), np.array([0.2, 0.5, 0.3])
    up, down = steps(prior, 0.3)
    transition = np.diag(1.0 - up - down) + np.diag(up[:-1], 1) + np.diag(down[1:], -1)
    np.testing.assert_allclose(prior @ transition, prior, atol=1e-15)
    posterior = np.empty((5, 3))
    evidence = smooth(likelihood, prior, 0.3, posterior)
    np.testing.assert_allclose(posterior, smoothed_by_enumeration(likelihood, prior, transition), rtol=1e-12)
    state = prior * likelihood[0]
    for one in likelihood[1:]:
        state = (state @ transition) * one
    assert evidence == pytest.approx(np.log(state.sum()))


def test_the_likelihood_is_students() -> None:
    x, R, curve = np.array([0.1e-3, 0.3e-3]), np.array([0.2e-3, 0.1e-3]), 0.3 * (np.arange(20) * 1e-4 + 0.5e-4 - 1e-3)
    likelihood, grid = np.empty((1, 3)), np.array([-1e-4, 0.0, 1e-4])
    left_out = weigh(x, R, 2, curve, -1e-3, 1e-4, grid, 5e-5, 0.5, likelihood)
    apart = (R[:, None] - 0.3 * (x[:, None] + grid)) / 5e-5
    expected = -0.5 * 3.5 * np.log1p(apart**2 / 6.0).sum(axis=0)
    np.testing.assert_allclose(np.log(likelihood[0]) + left_out, expected, rtol=1e-9)


def test_jumps_are_found_where_they_are_although_a_slow_part_is_lost() -> None:
    found = estimated(HiddenDisplacement(), hidden_motion())
    assert found.status is Status.ESTIMATED
    rises = np.flatnonzero(np.diff(found.difference) > 0.5 * STEP)
    places = found.displacement[rises]
    assert len(places) == 2
    assert places[1] - places[0] == pytest.approx(RIGHT - LEFT, abs=0.035e-3)
    as_observed = estimated(HiddenDisplacement(), hidden_motion(), replace(BAND_LIMITED, band_limited=False))
    assert errors(found).max() < 0.01
    assert errors(as_observed).max() > 0.02


def test_the_order_of_windows_does_not_matter_to_the_hidden_part() -> None:
    motions = hidden_motion()[:4]
    forth, back = (estimated(HiddenDisplacement(rounds=2), order) for order in (motions, motions[::-1]))
    np.testing.assert_allclose(forth.difference, back.difference, rtol=0, atol=1e-10)


def test_the_intervals_cover_next_to_jumps() -> None:
    inside = []
    for seed in range(2, 6):
        found = estimated(HiddenDisplacement(), hidden_motion(seed, windows=4))
        off = errors(found)
        halves = [np.nan if one.high is None or one.value is None else one.high - one.value for one in found.conicity]
        inside += list(off <= np.array(halves[1:11]))
    assert np.mean(inside) >= 0.9


def test_where_nothing_is_lost_nothing_is_moved() -> None:
    parameters = replace(BAND_LIMITED, band_limited=False)
    one, many = (estimated(HiddenDisplacement(rounds=n), (ideal(run(120)),), parameters) for n in (1, 6))
    np.testing.assert_array_equal(one.difference, many.difference)
    assert one.status is Status.ESTIMATED


def test_the_interval_between_samples_must_be_known() -> None:
    motion = replace(hidden_motion()[0], sample_interval_s=float("nan"))
    with pytest.raises(ParameterError, match="sample_interval_s"):
        HiddenDisplacement().update(HiddenDisplacement().init(BAND_LIMITED), motion)


def test_a_window_costs_its_own_samples_alone() -> None:
    estimator, motions = HiddenDisplacement(), hidden_motion()[:3]
    state = estimator.init(BAND_LIMITED)
    for number, motion in enumerate(motions):
        after = estimator.update(state, motion)
        assert all(old is new for old, new in zip(state.pieces, after.pieces, strict=False)), "nothing is copied"
        assert len(after.pieces) == number + 1
        state = after
    assert state.samples == sum(len(motion) for motion in motions)


def test_the_grid_reaches_three_times_as_far_as_the_slow_part() -> None:
    assert GRID[-1] == pytest.approx(3 * HIDDEN.prior_std)
    assert np.diff(GRID) == pytest.approx(0.02e-3)


def risen(step: float, spread: float) -> hidden_displacement.Stepped:
    """Return a line with a step of ``step`` m that is spread evenly over some way (``spread``, m, std)."""
    x = 0.04e-3 * (np.arange(200) - 99.5)
    half = np.sqrt(3.0) * spread
    return stepped(x, 0.2 * x + step * np.clip((x - 1e-3) / (2 * half) + 0.5, 0.0, 1.0))


@pytest.mark.parametrize(
    ("step", "spread", "jumps"),
    [(0.8e-3, 0.05e-3, 1), (0.8e-3, 0.095e-3, 0), (0.15e-3, 0.03e-3, 1), (0.1e-3, 0.03e-3, 0)],
)
def test_a_rise_that_is_high_and_narrow_is_a_jump(step: float, spread: float, jumps: int) -> None:
    found = risen(step, spread)
    assert len(found.jumps) == jumps
    assert found.difference[-1] - found.difference[0] == pytest.approx(0.2 * 199 * 0.04e-3 + step)
    if jumps:
        assert found.jumps[0] == pytest.approx(1e-3, abs=2e-6)
        at = np.searchsorted(found.displacement, found.jumps[0])
        assert found.difference[at] - found.difference[at - 1] == pytest.approx(step, rel=0.05)


def test_a_line_has_no_jump() -> None:
    x = 0.04e-3 * (np.arange(200) - 99.5)
    found = stepped(x, 0.2 * x)
    assert len(found.jumps) == 0
    np.testing.assert_allclose(found.difference, 0.2 * x, atol=1e-15)
