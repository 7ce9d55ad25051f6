"""Conicity at the limit's amplitude: as estimated, extrapolated from pairs that are left out, or not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wheelset_life import geometry_of

from bench.worn_family import PAIRS, conicities_of
from estimation.contact.wear import HOLLOWS
from estimation.trend.extrapolation import (
    WornFamily,
    conicity_at_limit_amplitude,
    conicity_points,
    extrapolated,
    worn_family,
)
from estimation.trend.trend import refresh
from estimation.values.geometry import GeometryRecord, KnownConicity, WheelsetGeometry, interval_conicities
from estimation.values.quantities import Estimate, Forecast, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode, code_of

FAMILY = worn_family()
STD = 0.01
NOT_COVERED = Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "not covered"))
ALL = len(FAMILY.amplitude)
TO_2_25, TO_2, TO_1_75, TO_1_5 = ALL - 3, ALL - 4, ALL - 5, ALL - 6  # amplitudes covered


def geometry(conicity: np.ndarray, covered: int, std: float = STD) -> WheelsetGeometry:
    """Return a geometry that covers the first amplitudes of the family."""
    known = [with_interval(float(value), std, count=6.0) for value in conicity[:covered]]
    return replace(
        geometry_of(conicity=0.3),
        amplitude=FAMILY.amplitude,
        conicity=(*known, *[NOT_COVERED] * (ALL - covered)),
        reported_amplitude=float(FAMILY.amplitude[covered - 1]) if covered else 3e-3,
        equivalent_conicity=known[-1] if covered else NOT_COVERED,
    )


def record(number: int, found: WheelsetGeometry) -> GeometryRecord:
    at = 1_700_000_000_000_000_000 + number * 10**15
    return GeometryRecord("W", 0, number, 5000.0 * number, at, at + 8, found, f"d{number}", {}, {}, "v", 1)


def test_the_kept_table_is_what_the_pairs_give() -> None:
    for pair in (0, 13):
        kept = FAMILY.conicity[FAMILY.pair == pair]
        np.testing.assert_allclose(kept, conicities_of(PAIRS[pair]), atol=0.51e-4)


def without(wheel: str) -> WornFamily:
    others = [PAIRS[i].wheel != wheel for i in FAMILY.pair]
    return WornFamily(FAMILY.amplitude, FAMILY.conicity[others], FAMILY.pair[others])


@pytest.mark.parametrize("covered", [ALL - 1, ALL - 2, TO_2_25, TO_2, TO_1_75, TO_1_5])
def test_intervals_cover_for_wheels_that_are_not_in_the_family(covered: int) -> None:
    """95 % intervals of wheelsets, new and worn, whose wheel is left out of the family on whatever rail."""
    rng = np.random.default_rng(covered)
    others = {name: without(name) for name in HOLLOWS}
    inside, errors, stds = [], [], []
    for i in rng.choice(len(FAMILY.pair), 400, replace=False):
        true = FAMILY.conicity[i]
        noise = STD * np.sqrt(0.5) * (rng.standard_normal() + rng.standard_normal(ALL))
        known = [
            KnownConicity(float(a), float(g), STD, STD)
            for a, g in zip(FAMILY.amplitude[:covered], (true + noise)[:covered], strict=True)
        ]
        found = extrapolated(known, others[PAIRS[FAMILY.pair[i]].wheel])
        if found is None:
            continue
        errors.append(found.value - true[-1])
        stds.append(found.std)
        inside.append(found.mixture().quantile(0.025) <= true[-1] <= found.mixture().quantile(0.975))
    assert len(inside) > 300
    assert 0.9 <= np.mean(inside) <= 0.99
    assert abs(np.mean(errors)) < 0.03
    assert 0.7 < np.std(errors) / np.sqrt(np.mean(np.square(stds))) < 1.15


def test_what_covers_three_millimetres_is_taken_as_it_is() -> None:
    whole = geometry(FAMILY.conicity[100], ALL)
    assert conicity_at_limit_amplitude(whole) == whole.conicity[-1]
    assert conicity_at_limit_amplitude(whole) == whole.equivalent_conicity


def test_what_covers_less_is_extrapolated_and_says_so() -> None:
    found = conicity_at_limit_amplitude(geometry(FAMILY.conicity[100], TO_2_25))
    assert found.status is Status.ESTIMATED
    assert code_of(found.reason) is ReasonCode.AMPLITUDE_EXTRAPOLATED
    assert "2.25 mm" in str(found.reason)
    assert found.std is not None
    assert found.std > STD
    assert found.count == 6.0


@pytest.mark.parametrize("covered", [1, 3, TO_1_5 - 1])
def test_from_less_than_one_and_a_half_millimetres_nothing_is_said(covered: int) -> None:
    found = conicity_at_limit_amplitude(geometry(FAMILY.conicity[100], covered))
    assert (found.value, code_of(found.reason)) == (None, ReasonCode.AMPLITUDE_NOT_COMPARABLE)


def test_a_shape_unlike_all_of_the_family_is_not_extrapolated() -> None:
    odd = np.where(np.arange(ALL) % 2 == 0, 0.2, 0.7)
    assert conicity_at_limit_amplitude(geometry(odd, TO_2_25)).status is Status.UNESTIMATED
    assert conicity_at_limit_amplitude(geometry(FAMILY.conicity[100], TO_2_25, std=0.09)).status is Status.UNESTIMATED


def test_a_wheelset_beside_all_those_alike_is_extrapolated() -> None:
    """A cone of 0.118, whose errors alone put it beside all members that are like it."""
    rng = np.random.default_rng(0)
    cone, std = np.full(ALL, 0.118), 0.019
    near = np.exp(-np.abs(np.subtract.outer(FAMILY.amplitude, FAMILY.amplitude)) / 0.5e-3)
    errors = np.linalg.cholesky(0.5 + 0.5 * near) @ rng.standard_normal((ALL, 100))
    found = [conicity_at_limit_amplitude(geometry(cone + std * error, TO_1_75, std)) for error in errors.T]
    assert all(one.status is Status.ESTIMATED for one in found)
    low, high = (np.array([getattr(one, name) for one in found]) for name in ("low", "high"))
    assert np.mean((low <= 0.118) & (high >= 0.118)) >= 0.94


def test_a_member_that_rises_beyond_counts_for_more_up_to_a_bound() -> None:
    """Members alike up to 2 mm, of which half rise beyond, the others stay or fall: 2 against 1 or 0.3."""
    up, even, down = (np.full((100, ALL), 0.2) for _ in range(3))
    up[:, TO_2:], down[:, TO_2:] = 0.4, 0.1
    known = [KnownConicity(float(a), 0.2, 0.001, 0.001) for a in FAMILY.amplitude[:TO_2]]
    for other, weight in ((even, 1.0), (down, 0.3)):
        family = WornFamily(FAMILY.amplitude, np.concatenate([up, other]), np.zeros(200, dtype=np.int64))
        found = extrapolated(known, family)
        assert found is not None
        assert found.value == pytest.approx((2.0 * 0.4 + weight * other[0, -1]) / (2.0 + weight))


def test_a_wheelset_without_any_conicity_keeps_its_reason() -> None:
    found = conicity_at_limit_amplitude(geometry(FAMILY.conicity[100], 0))
    assert code_of(found.reason) is ReasonCode.AMPLITUDE_NOT_COVERED


def test_a_trend_is_extrapolated_as_a_whole_and_knows_it_not_better_than_the_shapes() -> None:
    records = [record(k, geometry(FAMILY.conicity[100], TO_2_25)) for k in range(12)]
    chosen = conicity_points([interval_conicities(one) for one in records])
    assert (chosen.quantity, chosen.amplitude, len(chosen.points)) == ("equivalent_conicity", 3e-3, 12)
    assert code_of(chosen.note) is ReasonCode.AMPLITUDE_EXTRAPOLATED
    trend = refresh(chosen.points, 0.4, note=chosen.note)
    assert trend.fitted.std is not None
    assert code_of(trend.fitted.reason) is ReasonCode.AMPLITUDE_EXTRAPOLATED
    spread = np.median([np.sqrt(point.std**2 - (point.noise or 0.0) ** 2) for point in chosen.points])
    assert spread > 0.0
    alone = refresh([replace(point, std=point.noise or 0.0) for point in chosen.points], 0.4, note=chosen.note)
    assert alone.fitted.std is not None
    assert trend.fitted.std == pytest.approx(np.hypot(alone.fitted.std, spread), rel=1e-6)


def test_no_limit_is_held_against_another_amplitude() -> None:
    """All points far above the limit, at 1.25 mm: neither reached nor a distance."""
    records = [record(k, geometry(FAMILY.conicity[100] + 0.5, TO_1_5 - 1)) for k in range(6)]
    chosen = conicity_points([interval_conicities(one) for one in records])
    assert chosen.quantity == "equivalent_conicity_1.25_mm"
    trend = refresh(chosen.points, 0.2, note=chosen.note, not_comparable=chosen.not_comparable)
    assert trend.status is Status.ESTIMATED
    assert trend.slope_per_1000_km.value is not None
    assert (trend.probability_over_limit, trend.distance_to_limit_km) == (None, Forecast(None, None, None))
    assert trend.date_of_limit_ns == Forecast(None, None, None)
    assert code_of(trend.not_comparable) is ReasonCode.AMPLITUDE_NOT_COMPARABLE
