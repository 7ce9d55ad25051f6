"""Level, slope and forecast: rates over seeded histories, an independent oracle, and what must be refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq
from wear_histories import History, histories

from estimation.trend.parameters import CURVES
from estimation.trend.wear_curve import WearCurve, fit_wear_curve
from estimation.trend.wear_grid import Shapes, over_scatter, scaled_points, solve
from estimation.values.arrays import FloatArray
from estimation.values.mixture import NormalMixture
from estimation.values.quantities import Estimate


def holds(estimate: Estimate, truth: float) -> bool:
    assert estimate.low is not None
    assert estimate.high is not None
    return estimate.low <= truth <= estimate.high


def fitted(history: History) -> WearCurve:
    return fit_wear_curve(history.x, history.value, history.std)


def test_intervals_cover_and_quantiles_hit_their_rates() -> None:
    level, slope, hits = [], [], []
    for history in histories(11, 400):
        curve = fitted(history)
        level.append(holds(curve.level_now().estimate(1), history.true_level))
        slope.append(holds(curve.slope_now().estimate(1), history.true_slope))
        reached = [curve.reaches(history.level_ahead, p, 1e7) for p in (0.1, 0.5, 0.9)]
        hits.append([r is None or history.ahead <= r for r in reached])
    assert 0.92 <= np.mean(level) <= 0.99
    assert 0.92 <= np.mean(slope) <= 0.985
    p10, p50, p90 = np.mean(hits, axis=0)
    assert 0.05 <= p10 <= 0.15
    assert 0.42 <= p50 <= 0.60
    assert 0.85 <= p90 <= 0.95


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_straight_wear_is_covered_with_and_without_outliers(outliers: float) -> None:
    covered = [
        (
            holds(fitted(h).level_now().estimate(1), h.true_level),
            holds(fitted(h).slope_now().estimate(1), h.true_slope),
        )
        for h in histories(5, 200, points=(12, 40), shapes=(1.0, 0.0, 0.0), outliers=outliers)
    ]
    assert np.all(np.mean(covered, axis=0) >= 0.92)


def test_extra_scatter_is_found_where_standard_deviations_are_too_small() -> None:
    curves = [(fitted(h), h) for h in histories(7, 200, points=(12, 40), shapes=(1.0, 0.0, 0.0), scatter=2.5)]
    covered = [holds(c.level_now().estimate(1), h.true_level) for c, h in curves]
    naive = [
        abs(np.polyfit(h.x - h.x[-1], h.value, 1, w=1 / h.std)[1] - h.true_level) < 1.96 * _wls_std(h)
        for _, h in curves
    ]
    assert np.mean(covered) >= 0.86
    assert np.mean(naive) < 0.75  # what believing them costs


def _wls_std(history: History) -> float:
    design = np.column_stack([np.ones(len(history.x)), (history.x - history.x[-1]) / history.x[-1]])
    return float(np.sqrt(np.linalg.inv(design.T @ (design / history.std[:, None] ** 2))[0, 0]))


def test_one_point_in_ten_wrong_costs_little_where_least_squares_is_lost() -> None:
    robust: list[float] = []
    ordinary: list[float] = []
    clean: list[float] = []
    for bad, good in zip(
        histories(3, 150, points=(30,), shapes=(1.0, 0.0, 0.0), outliers=0.1),
        histories(3, 150, points=(30,), shapes=(1.0, 0.0, 0.0)),
        strict=True,
    ):
        for history, errors in ((bad, robust), (good, clean)):
            curve = fitted(history)
            errors.append(float(curve.weight @ curve.slope) / history.true_slope - 1.0)
        ordinary.append(np.polyfit(bad.x, bad.value, 1, w=1 / bad.std)[0] / bad.true_slope - 1.0)
    rms = [float(np.sqrt(np.mean(np.square(e)))) for e in (robust, ordinary, clean)]
    assert rms[0] < 0.5 * rms[1]
    assert rms[0] < 1.5 * rms[2]


def test_every_node_equals_generalised_least_squares_with_the_whole_covariance() -> None:
    """Level, rate and change of each scatter and knee, and what each of them is worth."""
    history = next(histories(2, 1, points=(15,)))
    points = scaled_points(history.x, history.value, history.std, None)
    wandering, bend, knee = 0.3, np.array([0.9, 1.7]), 40.0
    scatter, mean, design = np.array([0.7, 1.3]), np.array([0.2, -0.4]), points.design(1.0)
    shapes = Shapes(
        weight=np.ones(1),
        weight_behind=np.ones(1),
        lengths=np.ones(1),
        which=np.zeros(1, dtype=np.int64),
        precision=np.diag(bend**-2.0)[None],
        mean=mean[None],
        wandering=np.array([wandering]),
        knee=np.array([knee]),
    )
    nodes = solve(points, np.ones(15), scatter, np.array([0.4, 0.6]), shapes)
    knots = points.hinges.shape[1]
    expected = []
    for tau, prior in zip(scatter.tolist(), (0.4, 0.6), strict=True):
        for at in range(knots + 1):
            held = np.full(knots, wandering**2 * points.spacing)
            chance = 1.0 - CURVES.knee_chance
            if at:
                held[at - 1] += knee**2
                chance = CURVES.knee_chance / knots
            K = np.diag(points.variance + tau**2) + points.hinges @ np.diag(held) @ points.hinges.T
            precision = np.diag([0.0, *bend**-2.0])
            information = design[:, :3].T @ np.linalg.inv(K) @ design[:, :3] + precision
            moment = design[:, :3].T @ np.linalg.inv(K) @ points.z + precision @ [0.0, *mean]
            whole = K + design[:, 1:3] @ np.diag(bend**2) @ design[:, 1:3].T
            level = np.ones(15) @ np.linalg.inv(whole)
            rest = points.z - design[:, 1:3] @ mean
            rest -= level @ rest / level.sum()
            log_likelihood = np.linalg.slogdet(whole)[1] + np.log(level.sum()) + rest @ np.linalg.inv(whole) @ rest
            covariance = np.linalg.inv(information)
            expected.append((np.log(prior * chance) - 0.5 * log_likelihood, covariance @ moment, covariance))
    weights = np.exp([log - max(one for one, _, _ in expected) for log, _, _ in expected])
    weights /= weights.sum()
    moments: list[tuple[FloatArray, FloatArray]] = []
    counted = [number for number, weight in enumerate(weights) if weight > CURVES.negligible_share]
    assert len(counted) > 3
    for number in counted:
        _, beta, covariance = expected[number]
        node = int(np.argmin(np.abs(nodes.beta - beta).sum(axis=1)))
        np.testing.assert_allclose(nodes.beta[node], beta, rtol=1e-6)
        np.testing.assert_allclose(nodes.covariance[node], covariance, rtol=1e-6)
        assert nodes.weight[node] == pytest.approx(weights[number], rel=2.0 * CURVES.negligible_share)
    merged = over_scatter(nodes)
    assert len(merged.weight) == len(np.unique(nodes.knee)) < len(nodes.weight)
    for of in (nodes, merged):
        mean = of.weight @ of.beta
        moments.append(
            (mean, np.einsum("m,mij->ij", of.weight, of.covariance + of.beta[:, :, None] * of.beta[:, None]))
        )
    for whole, kept in zip(*moments, strict=True):
        np.testing.assert_allclose(kept, whole, rtol=1e-9)


def test_a_mixture_has_the_quantiles_of_its_draws() -> None:
    mixture = NormalMixture(np.array([0.2, 0.8]), np.array([-1.0, 2.0]), np.array([0.5, 1.5]))
    rng = np.random.default_rng(1)
    draws = np.where(rng.random(400_000) < 0.2, rng.normal(-1.0, 0.5, 400_000), rng.normal(2.0, 1.5, 400_000))
    for p in (0.025, 0.3, 0.9):
        assert mixture.quantile(p) == pytest.approx(np.quantile(draws, p), abs=0.02)
        assert mixture.above(mixture.quantile(p)) == pytest.approx(1.0 - p, abs=1e-6)
    estimate = mixture.estimate(1.0)
    assert estimate.value == pytest.approx(np.mean(draws), abs=0.01)
    assert estimate.std == pytest.approx(np.std(draws), abs=0.01)


def test_the_crossing_of_a_line_known_exactly_is_where_geometry_puts_it() -> None:
    x = np.linspace(0.0, 1000.0, 80)
    curve = fit_wear_curve(x, 3.0 + 0.01 * x, np.full(80, 1e-4))
    for p in (0.1, 0.5, 0.9):
        assert curve.reaches(18.0, p, 1e4) == pytest.approx(500.0, rel=0.01)
    assert curve.reaches(12.0, 0.9, 1e4) == 0.0
    assert curve.reaches(1000.0, 0.5, 1e4) is None


def first_above(curve: WearCurve, limit: float, probability: float, horizon: float) -> float | None:
    """Return where the limit is reached, looking at one distance after the other."""

    def short(distance: float) -> float:
        return curve.level_after(distance).above(limit) - probability

    before = 0.0
    for distance in (horizon * np.linspace(0.0, 1.0, CURVES.points_ahead) ** 2).tolist():
        if short(distance) >= 0.0:
            return float(brentq(short, before, distance, xtol=1e-6 * horizon)) if distance else 0.0
        before = distance
    return None


def test_looking_at_all_distances_at_once_finds_what_one_after_the_other_finds() -> None:
    found = []
    for history in histories(5, 30):
        curve = fitted(history)
        for probability in (0.1, 0.5, 0.9):
            for horizon in (0.3 * history.ahead, 10.0 * history.ahead):
                reached = curve.reaches(history.level_ahead, probability, horizon)
                assert reached == first_above(curve, history.level_ahead, probability, horizon)
                found.append(reached)
    assert 0 < sum(reached is None for reached in found) < len(found)


def test_quantiles_of_the_crossing_agree_with_draws_of_lines() -> None:
    curve = WearCurve(
        weight=np.array([1.0]),
        level=np.array([0.2]),
        slope=np.array([1e-6]),
        damped=np.array([0.0]),
        covariance=np.array([[[4e-6, 2e-11, 0.0], [2e-11, 4e-14, 0.0], [0.0, 0.0, 1e-30]]]),
        wandering=np.array([0.0]),
        length=np.array([1e5]),
        share=np.ones(5),
    )
    draws = stats.multivariate_normal([0.2, 1e-6], curve.covariance[0, :2, :2], allow_singular=True).rvs(
        200_000, random_state=3
    )
    crossing = (0.3 - draws[:, 0]) / draws[:, 1]
    for p in (0.1, 0.5, 0.9):
        assert curve.reaches(0.3, p, 1e6) == pytest.approx(np.quantile(crossing, p), rel=0.01)


@pytest.mark.parametrize(
    ("x", "std"), [([1.0], [0.1]), ([1.0, 1.0], [0.1, 0.1]), ([1.0, 2.0], [0.1, 0.0]), ([1.0, 2.0], [0.1, np.nan])]
)
def test_what_is_no_curve_is_refused(x: list[float], std: list[float]) -> None:
    with pytest.raises(ValueError, match="wear curve"):
        fit_wear_curve(np.array(x), np.ones(len(x)), np.array(std))
