"""Wear that accelerates late: level and probability are about now; what is straight keeps all its points."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.trend import trend
from estimation.trend.trend import TrendParameters, fit_recent
from estimation.trend.wear_curve import WearCurve, fit_wear_curve
from estimation.values.arrays import FloatArray

SPAN_KM = 40_000.0


def lives(
    kind: str, count: int = 12, points: int = 40, std: float = 0.006
) -> list[tuple[FloatArray, FloatArray, float]]:
    """Return distance, values and the true level at the last of them."""
    random, x = np.random.default_rng(3), np.linspace(0.0, SPAN_KM, points)
    u = x / SPAN_KM
    true = {
        "straight": 0.12 + 0.25 * u,
        "exponential": 0.12 + 0.25 * np.expm1(4.0 * u) / np.expm1(4.0),
        "late": 0.12 + 0.03 * u + np.maximum(0.0, u - 0.85),
    }[kind]
    return [(x, true + std * random.standard_normal(points), float(true[-1])) for _ in range(count)]


def levels(kind: str, std: float = 0.006) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the level with the newest points, and with all of them."""
    pairs = []
    for x, value, true in lives(kind, std=std):
        curves = (
            fit_recent(x, value, np.full(len(x), std), TrendParameters()),
            fit_wear_curve(x, value, np.full(len(x), std)),
        )
        pairs.append([float(curve.weight @ curve.level) - true for curve in curves])
    newest, whole = np.array(pairs).T
    return newest, whole


@pytest.mark.parametrize(("kind", "low_before"), [("exponential", -0.01), ("late", -0.05)])
def test_the_level_of_wear_that_accelerates_does_not_lie_below_its_last_points(kind: str, low_before: float) -> None:
    newest, whole = levels(kind)
    assert np.mean(whole) < low_before
    assert abs(np.mean(newest)) < 0.01


def test_straight_wear_keeps_all_its_points() -> None:
    kept = [
        share_of(fit_recent(x, value, np.full(len(x), 0.006), TrendParameters())) for x, value, _ in lives("straight")
    ]
    assert np.mean(np.array(kept) == 40) >= 0.8
    newest, _ = levels("straight")
    assert abs(np.mean(newest)) < 0.002


def share_of(curve: WearCurve) -> int:
    return len(curve.share)


def test_one_outlier_at_the_end_moves_nothing() -> None:
    x, value, _ = lives("straight")[0]
    value = value.copy()
    value[-1] += 0.2
    assert share_of(fit_recent(x, value, np.full(len(x), 0.006), TrendParameters())) == 40


def test_the_scatter_counts_where_the_stated_std_is_mostly_common() -> None:
    """Points that state 0.03 and scatter by 0.003: wear that bends by 0.05 shows all the same."""
    x, value, true = lives("late", std=0.003)[0]
    curve = fit_recent(x, value, np.full(len(x), 0.03), TrendParameters())
    assert share_of(curve) < 40
    assert float(curve.weight @ curve.level) == pytest.approx(true, abs=0.02)


@pytest.mark.parametrize(("off", "agrees"), [(2.4, True), (2.6, False)])
def test_three_points_together_disagree_from_two_and_a_half_standard_deviations_on(*, off: float, agrees: bool) -> None:
    x, std = np.arange(9.0), np.full(9, 0.01)
    curve = fit_wear_curve(x, np.full(9, 0.3), std)
    value = np.full(9, 0.3)
    value[-3:] += off * 0.01 / np.sqrt(3.0)
    assert trend._agrees(curve, x, value, std, TrendParameters()) is agrees
    assert (
        trend._agrees(curve, x[1:], value[1:], std[1:], TrendParameters()) is True
    )  # of eight points three are too many


def test_six_points_are_left_at_least() -> None:
    x = np.arange(12.0)
    value = np.where(x > 8, 0.5, 0.1) + 0.001 * (-1.0) ** x
    assert share_of(fit_recent(x, value, np.full(12, 0.002), TrendParameters())) == 6
    assert share_of(fit_recent(x[:6], value[-6:], np.full(6, 0.002), TrendParameters())) == 6
