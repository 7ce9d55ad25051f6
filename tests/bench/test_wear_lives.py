"""Simulated wear: points are about what is true, and a fitter that knows nothing does worse than a good one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from bench.coverage import Verdict
from bench.forecast_scores import HORIZON_KM, ForecastFigures, Prediction
from bench.trend import FITTERS, LIVES_COVER, LIVES_TOLERATED, Reach, judged
from bench.wear_lives import ALIKE, DEMO, LAWS, MIXED, OF_LAWS, Observed, lives
from estimation.values.quantities import with_interval


def test_stated_errors_are_those_of_the_points() -> None:
    known = [life for seed in range(40) for life in lives(replace(DEMO, constant_std=0.01), seed)]
    last = np.array([life.observed.value[-1] - life.level for life in known])
    std = np.array([life.observed.std[-1] for life in known])
    assert np.sqrt(np.mean((last / std) ** 2)) == pytest.approx(1.0, abs=0.15)
    apart = np.array([_scatter(life.observed) for life in known])
    assert np.median(apart) < 0.4 * np.median(std)  # most of an error is common


def _scatter(observed: Observed) -> float:
    """Return how far points scatter about their line."""
    line = np.polyfit(observed.x, observed.value, 1)
    return float(np.std(observed.value - np.polyval(line, observed.x), ddof=2))


@pytest.mark.parametrize("law", LAWS)
def test_the_limit_is_reached_where_the_level_is(law: str) -> None:
    for life in lives(OF_LAWS[law], 3):
        span = float(life.observed.x[-1])
        assert 0.1 * span * 0.99 <= life.distance_km <= 1.2 * span * 1.01
        assert life.law == law


def test_a_railway_has_many_wheelsets_by_class_line_and_position() -> None:
    known = lives(ALIKE, 1)
    assert len(known) == 300
    keys = {(one.observed.vehicle_class, one.observed.line, one.observed.position) for one in known}
    assert len(keys) == 100
    by_fleet: dict[tuple[str, str], set[str]] = {}
    for life in known:
        by_fleet.setdefault((life.observed.vehicle_class, life.observed.line), set()).add(life.law)
    assert all(len(laws) == 1 for laws in by_fleet.values())
    assert len({life.law for life in lives(MIXED, 1)[:12]}) > 2
    assert sum(np.isfinite([life.distance_km for life in known])) > 150


def vague(observed: Sequence[Observed]) -> list[Prediction]:
    """Forecast the same of every wheelset."""
    level, slope = with_interval(0.2, 0.1), with_interval(1e-6, 1e-6)
    return [Prediction(level, slope, np.array([0.0, HORIZON_KM]), np.array([0.0, 1.0])) for _ in observed]


def test_fitters_are_compared_on_the_same_lives_and_the_product_forecasts_better_than_nothing() -> None:
    small = replace(ALIKE, classes=2, lines=2, points=(6, 12))
    rows = judged(small, FITTERS | {"vague": vague}, [0])
    found = {name: ForecastFigures.of(row.fleets) for name, row in rows.items()}
    assert found["product"].count == found["vague"].count == 48
    assert found["product"].crps < 0.7 * found["vague"].crps
    assert rows["vague"].verdict(Reach((LIVES_COVER, LIVES_TOLERATED), score=130_000.0)) is Verdict.NO
