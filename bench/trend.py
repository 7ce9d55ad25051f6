"""Coverage of the trend over seeded wear histories: straight, saturating and accelerating, and all three mixed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bench.report import BenchRow, row_bench
from estimation.trend.trend import TrendParameters, fit_recent
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate


@dataclass(frozen=True, slots=True)
class History:
    """Points of a wear history, x in km, with what is true at the last of them and ``ahead`` km later."""

    x: FloatArray
    value: FloatArray
    std: FloatArray
    true_level: float
    true_slope: float
    ahead: float
    level_ahead: float


def histories(
    seed: int,
    count: int,
    *,
    points: tuple[int, ...] = (3, 6, 12, 25, 60),
    shapes: tuple[float, float, float] = (0.5, 0.25, 0.25),
    outliers: float = 0.0,
    scatter: float = 1.0,
) -> Iterator[History]:
    """Yield histories; ``scatter`` is by how much the stated standard deviations are too small."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        n = int(rng.choice(points))
        span = rng.uniform(3e4, 2e5)
        x = np.sort(np.concatenate([[0.0, span], rng.uniform(0.0, span, n - 2)]))
        rate, scale = rng.uniform(0.5e-6, 2e-6), span * rng.uniform(1.0, 4.0)
        level, slope = _shape(str(rng.choice(["straight", "saturating", "accelerating"], p=shapes)), rate, scale)
        std = rng.uniform(0.003, 0.012, n)
        value = level(x) + scatter * std * rng.standard_normal(n)
        wrong = rng.random(n) < outliers
        value[wrong] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(5.0, 20.0, wrong.sum()) * std[wrong]
        ahead = span * rng.uniform(0.1, 1.2)
        last = np.array([span, span + ahead])
        now, later = level(last)
        yield History(x, value, std, float(now), float(slope(last)[0]), ahead, float(later))


_Curve = Callable[[FloatArray], FloatArray]


def _shape(name: str, rate: float, scale: float) -> tuple[_Curve, _Curve]:
    if name == "saturating":
        return (
            lambda x: 0.1 + rate * scale * (1.0 - np.exp(-x / scale)),
            lambda x: rate * np.exp(-x / scale),
        )
    if name == "accelerating":
        return lambda x: 0.1 + rate * x * (1.0 + 0.5 * x / scale), lambda x: rate * (1.0 + x / scale)
    return lambda x: 0.1 + rate * x, lambda x: rate + 0.0 * x


HISTORIES = 400
SEED = 11
PROBABILITIES = (0.1, 0.5, 0.9)
HORIZON_KM = 1e7
MIXED = (0.5, 0.25, 0.25)
"""Shares of straight, saturating and accelerating wear."""

SHAPES = {"straight": (1.0, 0.0, 0.0), "saturating": (0.0, 1.0, 0.0), "accelerating": (0.0, 0.0, 1.0)}
SCATTER = 2.5


@dataclass(frozen=True, slots=True)
class Rates:
    """Shares of histories: intervals that contain the truth, and limits that were reached by a quantile."""

    level: float
    slope: float
    reached: tuple[float, float, float]  # by p10, p50, p90

    def __str__(self) -> str:
        """Return the rates as a cell of the table."""
        reached = ", ".join(f"{share:.0%}" for share in self.reached)
        return f"level {self.level:.0%}, slope {self.slope:.0%}; limit reached by p10, p50, p90: {reached}"


def rows() -> Iterator[BenchRow]:
    """Yield the rows on trends."""
    mixed = rates(MIXED)
    met = mixed.level >= 0.92 and mixed.slope >= 0.92 and mixed.reached[0] <= 0.15 and mixed.reached[2] >= 0.85
    reach = "intervals 92 % or more; p10 at most 15 %, p90 at least 85 %"
    yield BenchRow(f"trend, {HISTORIES} histories, half straight, the rest curved", str(mixed), reach, met)
    for name, shapes in SHAPES.items():
        yield BenchRow(f"trend, {HISTORIES} histories, {name} wear alone", str(rates(shapes)), "for information", True)  # noqa: FBT003 - nothing to be reached
    scattered = rates(SHAPES["straight"], SCATTER)
    what = f"trend, {HISTORIES} histories, straight wear, stated std too small by {SCATTER:g}"
    yield BenchRow(what, f"level {scattered.level:.0%}", "88 % or more", scattered.level >= 0.88)


def rates(shapes: tuple[float, float, float], scatter: float = 1.0) -> Rates:
    """Return the rates over seeded histories."""
    level, slope, reached = [], [], []
    for history in histories(SEED, HISTORIES, shapes=shapes, scatter=scatter):
        curve = fit_recent(history.x, history.value, history.std, TrendParameters())
        level.append(_contains(curve.level_now().estimate(1), history.true_level))
        slope.append(_contains(curve.slope_now().estimate(1), history.true_slope))
        reached.append([_reached(history, curve.reaches(history.level_ahead, p, HORIZON_KM)) for p in PROBABILITIES])
    p10, p50, p90 = (float(share) for share in np.mean(reached, axis=0))
    return Rates(float(np.mean(level)), float(np.mean(slope)), (p10, p50, p90))


def _contains(estimate: Estimate, truth: float) -> bool:
    return estimate.low is not None and estimate.high is not None and estimate.low <= truth <= estimate.high


def _reached(history: History, forecast: float | None) -> bool:
    return forecast is None or history.ahead <= forecast


main = row_bench("trend", "Coverage of trend and forecast", __doc__, lambda _options, _folder: rows()).run
