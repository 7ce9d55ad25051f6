"""How often intervals cover: the interval of that share holds the true one, and it decides no more than it can."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bench.coverage import Coverage, Verdict
from estimation.values.units import NORMAL_95

WHEELSETS, AMPLITUDES = 8, 9


def fleets(rng: np.random.Generator, count: int, shares: tuple[float, float], scale: float) -> list[tuple[int, int]]:
    """Return numbers of fleets and how many are held: shares of the errors' variance are of fleets and wheelsets."""
    fleet, wheelset = shares
    z = np.sqrt(fleet) * rng.standard_normal((count, 1, 1))
    z = z + np.sqrt(wheelset) * rng.standard_normal((count, WHEELSETS, 1))
    z = z + np.sqrt(1.0 - fleet - wheelset) * rng.standard_normal((count, WHEELSETS, AMPLITUDES))
    held = (np.abs(scale * z) <= NORMAL_95).sum(axis=(1, 2))
    return [(WHEELSETS * AMPLITUDES, int(one)) for one in held]


def true_share(scale: float) -> float:
    return float(2.0 * norm.cdf(NORMAL_95 / scale) - 1.0)


@pytest.mark.parametrize("shares", [(0.0, 0.1), (0.0, 0.9), (0.4, 0.5), (0.9, 0.05)])
@pytest.mark.parametrize(("count", "scale"), [(10, 1.0), (20, 1.0), (20, 1.5)])
def test_the_interval_of_the_share_holds_the_true_one(shares: tuple[float, float], count: int, scale: float) -> None:
    rng, trials = np.random.default_rng(1), 150
    found = [Coverage.of(fleets(rng, count, shares, scale)) for _ in range(trials)]
    held = np.mean([one.low <= true_share(scale) <= one.high for one in found])
    assert held >= 0.78  # 83 % or more, less two stds of as many trials
    if shares[0] < 0.5:
        assert np.median([one.high - one.low for one in found]) < 0.2


def test_numbers_of_one_wheelset_do_not_count_as_many() -> None:
    rng = np.random.default_rng(2)
    apart = Coverage.of(fleets(rng, 20, (0.0, 0.0), 1.0))
    alike = Coverage.of(fleets(rng, 20, (0.0, 0.95), 1.0))
    assert alike.high - alike.low > 2.0 * (apart.high - apart.low)


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, Verdict.YES), (0.2, Verdict.NO), (1.6, Verdict.NO)])
def test_enough_fleets_decide(scale: float, verdict: Verdict) -> None:
    assert Coverage.of(fleets(np.random.default_rng(3), 60, (0.0, 0.5), scale)).verdict() is verdict


def test_few_numbers_that_are_all_held_decide_nothing_and_so_does_none() -> None:
    assert Coverage.of([(72, 72)]).verdict() is Verdict.OPEN
    assert Coverage.of([(72, 72)] * 3).verdict() is Verdict.OPEN
    assert Coverage.of([(72, 72)] * 60).verdict() is Verdict.NO
    assert Coverage.of([]).verdict() is Verdict.OPEN
    assert str(Coverage.of([(0, 0)])) == ""


def test_far_too_few_held_are_decided_by_a_fleet() -> None:
    assert Coverage.of([(72, 20)]).verdict() is Verdict.NO


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.901, 0.989, Verdict.YES),
        (0.899, 0.96, Verdict.OPEN),
        (0.95, 0.991, Verdict.OPEN),
        (0.981, 0.985, Verdict.NO),
        (0.902, 0.919, Verdict.NO),
    ],
)
def test_a_share_is_right_where_its_whole_interval_is(low: float, high: float, verdict: Verdict) -> None:
    assert Coverage(0.5 * (low + high), low, high).verdict() is verdict


def test_one_that_falls_short_decides() -> None:
    assert Verdict.all([Verdict.YES, Verdict.OPEN, Verdict.NO]) is Verdict.NO
    assert Verdict.all([Verdict.YES, Verdict.OPEN]) is Verdict.OPEN
    assert Verdict.all([]) is Verdict.YES
