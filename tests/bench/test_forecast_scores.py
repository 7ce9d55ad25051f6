"""Forecasts against what happened: the scores against a slow oracle, and a forecast that is calibrated."""

from __future__ import annotations

import numpy as np
import pytest

from bench.coverage import Verdict
from bench.forecast_scores import HORIZON_KM, ForecastFigures, Happened, Prediction
from estimation.values.quantities import Estimate, Status

UNKNOWN = Estimate.unknown(None, 0.0, Status.UNESTIMATED)
AHEAD = np.array([0.0, 4e4, 9e4, 2.2e5, 5e5])


def prediction(*reached: float) -> Prediction:
    return Prediction(UNKNOWN, UNKNOWN, AHEAD, np.array(reached))


def drawn(made: Prediction, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return distances that a forecast holds likely; inf beyond the horizon."""
    u = rng.random(count)
    far = np.interp(u, made.reached, made.ahead_km)
    return np.where(u <= made.reached[0], 0.0, np.where(u > made.reached[-1], np.inf, far))


@pytest.mark.parametrize("reached", [(0.0, 0.1, 0.5, 0.8, 1.0), (0.2, 0.2, 0.4, 0.9, 0.9), (0.0, 0.0, 0.0, 0.0, 0.05)])
@pytest.mark.parametrize("happened", [0.0, 3e4, 1.5e5, 4.9e5, float("inf")])
def test_the_score_is_that_of_a_sample(reached: tuple[float, ...], happened: float) -> None:
    made = prediction(*reached)
    sample = np.sort(np.minimum(drawn(made, 200_000, np.random.default_rng(1)), HORIZON_KM))
    rank = 2.0 * np.arange(1, len(sample) + 1) - len(sample) - 1.0
    apart = 2.0 * float(np.mean(rank * sample)) / len(sample)  # of two members of the sample
    oracle = float(np.mean(np.abs(sample - min(happened, HORIZON_KM)))) - 0.5 * apart
    assert made.crps(happened) == pytest.approx(oracle, abs=1500.0)


def test_a_sure_forecast_scores_its_error_and_quantiles_are_where_the_chance_is() -> None:
    made = Prediction(UNKNOWN, UNKNOWN, np.array([0.0, 1e5 - 1.0, 1e5, HORIZON_KM]), np.array([0.0, 0.0, 1.0, 1.0]))
    assert made.crps(1.3e5) == pytest.approx(3e4, abs=2.0)
    assert made.quantile(0.5) == pytest.approx(1e5, abs=1.0)
    assert made.quantile(0.0) == 0.0
    assert prediction(0.3, 0.4, 0.5, 0.6, 0.7).quantile(0.3) == 0.0
    assert prediction(0.3, 0.4, 0.5, 0.6, 0.7).quantile(0.71) == HORIZON_KM
    assert prediction(0.3, 0.3, 0.5, 0.6, 0.7).quantile(0.4) == pytest.approx(6.5e4)


def test_a_miss_costs_ten_times_how_far_it_misses() -> None:
    made = prediction(0.0, 0.1, 0.5, 0.9, 1.0)
    assert Happened.of(made, 1e5, 0.5).score == pytest.approx(1.8e5)
    assert Happened.of(made, 2.4e5, 0.5).score == pytest.approx(1.8e5 + 10.0 * 2e4)
    assert Happened.of(made, float("inf"), 0.5).score == pytest.approx(1.8e5 + 10.0 * 2.8e5)


def figures(*, stretched: float) -> ForecastFigures:
    """Return the figures of forecasts of which all happens ``stretched`` times later."""
    rng = np.random.default_rng(7)
    made = prediction(0.05, 0.3, 0.5, 0.8, 0.88)
    happened = stretched * drawn(made, 4000, rng)
    fleets = [
        [Happened.of(made, float(far), float(rng.random())) for far in of_fleet]
        for of_fleet in happened.reshape(200, 20)
    ]
    return ForecastFigures.of(fleets)


def test_the_transform_of_a_calibrated_forecast_is_even_with_chances_of_now_and_beyond() -> None:
    found = figures(stretched=1.0)
    assert found.histogram == pytest.approx(np.full(10, 0.1), abs=0.02)
    assert found.cover.verdict((0.77, 0.83), (0.75, 0.85)) is Verdict.YES
    assert found.calibrated(0.05, 0.02) is Verdict.YES
    assert figures(stretched=1.6).calibrated(0.05, 0.02) is Verdict.NO
