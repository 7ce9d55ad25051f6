"""What passes of a place have wrong in common: as far as places show it, and never less than the least."""

from __future__ import annotations

import numpy as np
import pytest
from test_friction import a_pass

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.pass_sums import common_std, pass_sums
from estimation.values.arrays import FloatArray
from estimation.values.units import NORMAL_90

USUAL, PLACES = 0.3, 60


def stds(off: float, places: int = PLACES, passes: int = 8) -> FloatArray:
    """Return the stds of places whose passes are all wrong by ``off`` of their creep (std)."""
    errors = list(np.random.default_rng(5).normal(0.0, off, places))
    sums = pass_sums([a_pass(number, [USUAL] * places, of_places=errors) for number in range(passes)])
    assert sums is not None
    inverse = np.full(places, 1.0 / USUAL)
    return common_std(sums, inverse, np.zeros(len(sums.vehicles)), np.zeros(passes), 1.0 / USUAL, FrictionParameters())


def test_errors_that_all_passes_have_are_seen_where_places_show_less_creep_than_linear() -> None:
    sums = pass_sums([a_pass(0, [USUAL])])
    assert sums is not None
    per_creep = float((1.0 / USUAL) * sums.squares[0, 2] / sums.at(np.array([1.0 / USUAL]))[2][0])
    for off in (0.1, 0.2):
        assert np.median(stds(off)) == pytest.approx(off * per_creep, rel=0.35)


def test_more_passes_do_not_make_them_smaller() -> None:
    assert np.median(stds(0.15, passes=12)) == pytest.approx(np.median(stds(0.15, passes=4)), rel=0.15)


def test_few_places_are_taken_for_wrong_by_all_that_is_left() -> None:
    few, many = np.median(stds(0.0, places=4)), np.median(stds(0.0, places=400))
    least = np.sqrt(
        (400 * FrictionParameters().least_common_std ** 2 + FrictionParameters().prior_places)
        / (400 + FrictionParameters().prior_places)
    )
    expected = np.sqrt(
        (4 * FrictionParameters().least_common_std ** 2 + FrictionParameters().prior_places)
        / (4 + FrictionParameters().prior_places)
    )
    assert few / many == pytest.approx(expected / least, rel=0.1)


def test_what_decides_is_pinned() -> None:
    assert (
        FrictionParameters().best_inverse,
        FrictionParameters().below_best_share,
        NORMAL_90,
        FrictionParameters().least_common_std,
        FrictionParameters().prior_places,
    ) == (2.0, 0.1, 1.2816, 0.4, 20.0)
