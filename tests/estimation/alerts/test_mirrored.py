"""A wheelset turned end for end is found by its history, where one interval against the next cannot show it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from wheelset_life import geometry_of

from estimation.alerts.identity import Mistake, Observation, Parts, identity_events, newest_mirrored, reversed_between
from estimation.alerts.parameters import FINDINGS

AT = np.arange(0.125, 3.5, 0.25)
SHAPE = (AT / 3.0) ** 2 - np.mean((AT / 3.0) ** 2)
SHAPE = SHAPE / np.sqrt(np.mean(SHAPE**2))
COUNT, TURNED = 20, 12
MONTH_NS = 30 * 86_400 * 10**9


def parts(
    size: float, after: float, *, odd: float = 0.0, common: float = 0.08, seed: int = 0, count: int = COUNT
) -> Parts:
    """Return curves (mm) whose even part has one size before and another after, with errors that all share."""
    rng = np.random.default_rng(seed)
    behind = np.arange(count) >= TURNED
    base = common * rng.standard_normal() * np.sin(AT)
    even = np.where(behind, after, size)[:, None] * SHAPE + base + 0.005 * rng.standard_normal((count, len(AT)))
    straight = 0.4 * AT / 3.0 + (odd * behind)[:, None] * SHAPE + 0.004 * rng.standard_normal((count, 1))
    x = 8000.0 * np.arange(count)
    return Parts(
        x, x / 1e5 * 365.25 * 86_400e9, 1e-3 * even, 1e-3 * straight, np.full(even.shape, 1e-3 * max(common, 5e-3))
    )


@pytest.mark.parametrize("size", [0.04, -0.15])
def test_a_sign_that_changes_is_seen_below_the_published_std_and_only_from_three_curves(size: float) -> None:
    for seed in range(4):
        found = newest_mirrored(parts(size, -size, seed=seed))
        assert found is not None
        assert (found.last, found.first) == (TURNED - 1, TURNED)
        assert found.left < 1.5
        assert newest_mirrored(parts(size, -size, seed=seed, count=TURNED + 2)) is None


def test_wheels_that_hardly_differ_are_not_shown_and_no_other_change_is_taken_for_it() -> None:
    for seed in range(4):
        for size, after in ((0.0, 0.0), (0.01, -0.01), (0.1, 0.1)):
            assert newest_mirrored(parts(size, after, seed=seed)) is None


@pytest.mark.parametrize(("share", "shown"), [(0.9, True), (1.1, False)])
def test_the_odd_part_stays_as_it_is(share: float, shown: bool) -> None:  # noqa: FBT001
    assert FINDINGS.mirrored_odd_share == 0.35
    found = newest_mirrored(parts(0.1, -0.1, odd=share * FINDINGS.mirrored_odd_share * 0.2))
    assert (found is not None) is shown


@pytest.mark.parametrize(("share", "shown"), [(0.8, True), (1.2, False)])
def test_the_size_stays_the_same_but_for_what_is_common(share: float, shown: bool) -> None:  # noqa: FBT001
    assert (FINDINGS.size_tolerance, FINDINGS.common_stds) == (0.25, 2.0)
    common = 0.005 * np.abs(SHAPE).sum() / len(AT) * FINDINGS.common_stds
    step = 0.4
    unlike = share * (FINDINGS.size_tolerance * step + common)
    found = newest_mirrored(parts(0.5 * (step + unlike), -0.5 * (step - unlike), common=0.0))
    assert (found is not None) is shown


def test_a_year_of_monthly_visits_shows_a_turned_wheelset_that_pairs_of_intervals_do_not() -> None:
    rng = np.random.default_rng(4)
    seen = []
    for month in range(14):
        plain = geometry_of(conicity=0.2 + 0.005 * month, even=0.012)
        values = plain.rolling_radius_difference
        curve = -values.value[::-1] if month >= 8 else values.value
        curve = curve * (1.0 + 0.01 * rng.standard_normal()) + 3e-6 * rng.standard_normal(len(curve))
        geometry = replace(plain, rolling_radius_difference=replace(values, value=curve))
        seen.append(Observation("A", month * MONTH_NS, (month + 1) * MONTH_NS - 1, 1e4 * month, geometry))
    assert all(reversed_between(*pair) is None for pair in pairwise(seen))
    event = identity_events({"A": seen})["A"]
    assert event.mistake is Mistake.REVERSED
    assert (event.before_ns, event.after_ns) == (seen[7].to_ns, seen[8].from_ns)
