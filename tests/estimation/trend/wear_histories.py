"""Seeded histories of straight, saturating and accelerating wear, with what is true at their end and beyond."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray


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
