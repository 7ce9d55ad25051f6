"""What a fleet says of one of its wheelsets: calibrated, robust, never by its own points, little where it is small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimation.trend.extrapolation import beyond_reached, extrapolated
from estimation.trend.fleet import beyond_of, fleet_priors, own_wear, usual_wear
from estimation.trend.parameters import CURVES, FLEET
from estimation.trend.trend import refresh
from estimation.trend.wear_curve import WearCurve
from estimation.values.arrays import FloatArray
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.quantities import Estimate
from estimation.values.trend import BeyondReached, FleetWear, OwnWear, TrendPoint, WearComponent, WearTrend
from estimation.values.units import YEAR_NS

RATE, KM_PER_YEAR = 5e-7, 120_000.0
Points = tuple[FloatArray, FloatArray, FloatArray]  # km, value, noise


def points(rng: np.random.Generator, rate: float, *, span: float | None = None, count: int | None = None) -> Points:
    """Return points of a wheelset that wears straight, over 5,000 to 300,000 km."""
    count = int(rng.integers(3, 31)) if count is None else count
    span = float(np.exp(rng.uniform(np.log(5e3), np.log(3e5)))) if span is None else span
    x = np.sort(np.concatenate([[0.0, span], rng.uniform(0.0, span, count - 2)]))
    noise = np.full(count, rng.uniform(0.001, 0.002))
    return x, 0.1 + rate * x + noise * rng.standard_normal(count), noise


def fleet_of(seed: int, count: int = 12, spread: float = 0.2) -> tuple[list[Points], list[float]]:
    rng = np.random.default_rng(seed)
    rates = [RATE * float(np.exp(spread * rng.standard_normal())) for _ in range(count)]
    scales = 1.0 + 0.05 * rng.standard_normal(count)
    return [points(rng, scale * rate) for scale, rate in zip(scales.tolist(), rates, strict=True)], rates


def said_of(fleet: Sequence[Points]) -> list[FleetWear]:
    return fleet_priors([own_wear(*of) for of in fleet])


def trend_of(of: Points, fleet: FleetWear | None, shared: float = 0.0, limit: float = 0.4) -> WearTrend:
    rows = zip(*(column.tolist() for column in of), strict=True)
    given = [
        TrendPoint(km, round(km / KM_PER_YEAR * YEAR_NS), value, float(np.hypot(noise, shared)), noise)
        for km, value, noise in rows
    ]
    return refresh(given, limit, fleet=fleet, origin_km=0.0)


def half(estimate: Estimate) -> float:
    assert estimate.low is not None
    assert estimate.high is not None
    return 0.5 * (estimate.high - estimate.low)


def holds(estimate: Estimate, truth: float) -> bool:
    assert estimate.low is not None
    assert estimate.high is not None
    return estimate.low <= truth <= estimate.high


def test_slopes_of_fleets_are_covered_and_sharper_than_alone() -> None:
    covered, alone, widths = [], [], []
    for seed in range(8):
        fleet, rates = fleet_of(seed)
        for of, said, rate in zip(fleet, said_of(fleet), rates, strict=True):
            trend, by_itself = trend_of(of, said), trend_of(of, None)
            covered.append(holds(trend.slope_per_1000_km, 1e3 * rate))
            alone.append(half(by_itself.slope_per_1000_km))
            widths.append(half(trend.slope_per_1000_km))
    assert 0.9 <= np.mean(covered) <= 0.99
    assert np.median(widths) < 0.6 * np.median(alone)


def test_three_points_over_4500_km_say_what_the_fleet_says() -> None:
    rng = np.random.default_rng(3)
    fleet, rates = fleet_of(1)
    young = points(rng, RATE, span=4500.0, count=3)
    said = said_of([*fleet, young])[-1]
    slope = trend_of(young, said).slope_per_1000_km
    assert said.others == 12
    assert slope.value is not None
    assert abs(slope.value - 1e3 * np.mean(rates)) < 1e3 * 0.25 * RATE
    assert half(slope) < 1e3 * 1.0 * RATE
    assert half(trend_of(young, None).slope_per_1000_km) > 1e3 * RATE


def test_a_wheelset_that_left_its_fleet_keeps_its_own_slope_and_the_others_theirs() -> None:
    rng = np.random.default_rng(5)
    fleet, _ = fleet_of(2)
    fast = points(rng, 4.0 * RATE, span=1e5, count=25)
    said = said_of([*fleet, fast])
    slope = trend_of(fast, said[-1]).slope_per_1000_km
    assert slope.value == pytest.approx(4e3 * RATE, rel=0.1)
    without, together = rate_of(said_of(fleet)[0]), rate_of(said[0])
    assert abs(together - without) < 0.3 * RATE


def rate_of(said: FleetWear) -> float:
    """Return the rate at an age of 50,000 km."""
    return sum(part.weight * _rate_at(part, 5e4) for part in said.components)


def _rate_at(part: WearComponent, age: float) -> float:
    return part.rate + part.change * (age if np.isinf(part.length) else float(np.exp(-age / part.length)))


def test_what_is_said_of_a_wheelset_does_not_rest_on_its_own_points() -> None:
    fleet, _ = fleet_of(4, count=6)
    other = points(np.random.default_rng(9), 2.0 * RATE, span=2e5, count=20)
    assert fleet_priors([own_wear(*of) for of in fleet]) != said_of([*fleet[:5], other])
    first, second = said_of(fleet)[5], said_of([*fleet[:5], other])[5]
    rates = [rate_of(first), rate_of(second)]
    assert rates[0] == pytest.approx(rates[1], rel=0.15)  # what it is like decides how far others count, no more


def test_a_lone_wheelset_gets_what_is_known_of_any() -> None:
    fleet, _ = fleet_of(4, count=1)
    (said,) = said_of(fleet)
    assert said.others == 0
    for part, usual in zip(said.components, usual_wear().components, strict=True):
        assert part.weight == pytest.approx(usual.weight, abs=2.0 * FLEET.share_step)  # rounded alike, or just not
        assert (part.rate, part.rate_std) == pytest.approx((usual.rate, usual.rate_std), rel=0.2)
    spread = [part.rate_std for part in usual_wear().components]
    assert min(spread) > 1e-6
    assert sum(part.weight for part in usual_wear().components) == pytest.approx(1.0)


def test_two_wheelsets_say_less_than_twelve() -> None:
    fleet, _ = fleet_of(6)
    young = points(np.random.default_rng(3), RATE, span=4500.0, count=3)
    two, many = (half(trend_of(young, said_of([*some, young])[-1]).slope_per_1000_km) for some in (fleet[:1], fleet))
    assert two > 1.5 * many


def test_a_little_more_of_one_wheelset_leaves_what_is_said_of_the_others() -> None:
    fleet, _ = fleet_of(8)
    x, value, noise = fleet[0]
    moved = [(x, value + 1e-6 * np.arange(len(x)), noise), *fleet[1:]]
    before, after = said_of(fleet)[1:], said_of(moved)[1:]
    assert sum(one == other for one, other in zip(before, after, strict=True)) >= 9


def test_common_errors_widen_the_level_and_not_the_slope() -> None:
    of = points(np.random.default_rng(2), RATE, span=2e5, count=20)
    sharp, common = trend_of(of, None), trend_of(of, None, shared=0.02)
    assert common.slope_per_1000_km.std == pytest.approx(sharp.slope_per_1000_km.std, rel=1e-6)
    assert common.fitted.std is not None
    assert sharp.fitted.std is not None
    assert common.fitted.std == pytest.approx(np.hypot(sharp.fitted.std, 0.02), rel=0.02)


def test_a_slope_is_never_surer_than_the_scale_of_its_wheelset() -> None:
    x = np.linspace(0.0, 2e5, 60)
    trend = trend_of((x, 0.1 + RATE * x, np.full(60, 1e-5)), None)
    assert trend.slope_per_1000_km.std == pytest.approx(0.05 * 1e3 * RATE, rel=0.05)


def test_what_grows_is_what_draws_of_growing_wear_say() -> None:
    """Slopes now and 100,000 km ahead are above 0, but for the share that may fall."""
    mean = np.array([0.2, 2e-7, -1e-7])
    root = np.array([[0.01, 0.0, 0.0], [-2e-7, 4e-7, 0.0], [0.0, 1e-7, 2e-7]])
    curve = WearCurve(
        weight=np.ones(1),
        level=mean[:1],
        slope=mean[1:2],
        damped=mean[2:],
        covariance=(root @ root.T)[None],
        wandering=np.zeros(1),
        length=np.array([8e4]),
        share=np.ones(5),
    )
    grown = curve.growing(1e5, CURVES.falling_share)
    draws = mean + np.random.default_rng(1).standard_normal((400_000, 3)) @ root.T
    grows = (draws[:, 1] > 0.0) & (draws[:, 1] + draws[:, 2] * -np.expm1(-1e5 / 8e4) > 0.0)
    weight = np.where(grows, 1.0, 0.05)
    for distance in (0.0, 1e5, 3e5):
        later = distance - 8e4 * -np.expm1(-distance / 8e4)
        true = np.average(draws[:, 0] + draws[:, 1] * distance + draws[:, 2] * later, weights=weight)
        found = grown.level_after(distance)
        assert float(found.weight @ found.mean) == pytest.approx(true, abs=0.05 * (true - mean[0]) + 5e-4)
    assert grown.slope_now().above(0.0) > 0.93


NOTHING = OwnWear(3e-3, np.zeros((15, 2, 2)), np.zeros((15, 2)), np.zeros(15))


def reaching(*errors: float) -> list[OwnWear]:
    return [replace(NOTHING, beyond=(BeyondReached(2.5e-3, error, 0.06),)) for error in errors]


def test_wheelsets_that_reach_the_amplitude_show_by_how_much_the_catalogue_is_off() -> None:
    assert beyond_of(reaching(0.03)) == ()
    assert len(beyond_of(reaching(0.03, 0.03))) == 1
    (shown,) = beyond_of(reaching(0.030, 0.034, 0.026, 0.030))
    between = (2.0 * (0.3 * 0.06) ** 2 + 2.0 * 0.004**2) / 5.0
    assert shown.amplitude == 2.5e-3
    assert np.sqrt(1.25 * between) <= shown.std <= np.sqrt(1.25 * between) * 2.0 ** (1.0 / FLEET.std_steps)
    assert shown.error == pytest.approx(
        0.03 / (1.0 + between / (4.0 * 0.06**2)), abs=0.5 * shown.std / FLEET.mean_steps
    )
    (apart,) = beyond_of(reaching(0.08, -0.08, 0.06, -0.04))
    assert apart.std > 0.06


def interval(number: int, conicities: dict[float, float]) -> IntervalConicities:
    known = tuple(KnownConicity(1e-3 * mm, value, 0.004, 0.001) for mm, value in conicities.items())
    return IntervalConicities(0, number, 1e3 * number, number, number + 1, 5, "d", "v", known, None)


CURVE = {1.5: 0.13, 1.75: 0.135, 2.0: 0.14, 2.25: 0.15, 2.5: 0.16}


def test_an_extrapolation_is_moved_and_narrowed_by_wheelsets_of_its_fleet() -> None:
    known = interval(0, CURVE).known
    alone = extrapolated(known)
    assert alone is not None
    said = FleetWear((), 4, (BeyondReached(2.5e-3, 0.03, 0.5 * alone.spread),))
    moved = extrapolated(known, fleet=said)
    assert moved is not None
    assert moved.value == pytest.approx(alone.value + 0.03)
    assert moved.spread == pytest.approx(0.5 * alone.spread)
    assert np.std(moved.beyond) == pytest.approx(0.5 * np.std(alone.beyond))
    assert moved.measured_std == alone.measured_std
    wide = FleetWear((), 4, (BeyondReached(2.5e-3, 0.03, 1.1 * alone.spread),))
    assert extrapolated(known, fleet=wide) == alone
    elsewhere = FleetWear((), 4, (BeyondReached(2.25e-3, 0.03, 0.001),))
    assert extrapolated(known, fleet=elsewhere) == alone


def test_a_wheelset_that_reaches_3_mm_says_what_was_extrapolated_wrongly() -> None:
    alone = extrapolated(interval(0, CURVE).known)
    assert alone is not None
    shown = beyond_reached([interval(number, CURVE | {3.0: alone.value + 0.02}) for number in range(5)])
    assert [round(1e3 * one.amplitude, 2) for one in shown] == [1.75, 2.0, 2.25, 2.5]
    assert shown[-1].error == pytest.approx(0.02)
    assert shown[-1].std == pytest.approx(alone.spread)


def test_a_wheelset_that_moves_nearly_as_far_says_what_was_extrapolated_from_less() -> None:
    at_limit = extrapolated(interval(0, CURVE).known)
    less = extrapolated(interval(0, {amplitude: CURVE[amplitude] for amplitude in (1.5, 1.75, 2.0)}).known)
    assert at_limit is not None
    assert less is not None
    shown = {round(1e3 * one.amplitude, 2): one for one in beyond_reached([interval(0, CURVE)])}
    assert shown[2.0].error == pytest.approx(at_limit.value - less.value)
    assert shown[2.0].std == pytest.approx(less.spread)
    not_as_far = {amplitude: value for amplitude, value in CURVE.items() if amplitude < 2.5}
    assert beyond_reached([interval(0, not_as_far)]) == ()


@pytest.mark.parametrize("points", [2, 3])
def test_few_points_say_how_fast_and_not_whether_it_changes(points: int) -> None:
    x = np.linspace(0.0, 9000.0, points)
    own = own_wear(x, 0.2 + 3e-7 * x, np.full(points, 1e-3))
    assert np.isfinite(own.information).all()
    assert np.isfinite(own.moment).all()
    assert np.isfinite(own.evidence).all()
    assert all(np.isfinite(component.rate) for prior in fleet_priors([own] * 3) for component in prior.components)


def test_usual_wear_hardly_doubles_by_wandering_alone() -> None:
    """By the strongest wandering the rate has changed by itself after some 440,000 km, not after 30,000."""
    wandering = {component.wandering for component in usual_wear().components}
    assert wandering == {5e-11, 3e-10, 1.5e-9} == set(FLEET.wanderings)
    assert (FLEET.rate / max(wandering)) ** 2 == pytest.approx(444_444.0, rel=1e-4)
