"""The chain along the places: against the sum over all courses, with jumps, behind gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.pass_sums import GRID, along_track
from estimation.values.arrays import FloatArray
from estimation.values.sums import INVERSE

PLACE_STD = 0.45
KNOWN = FrictionParameters(usual=3.3, usual_std=3.0, change_std=0.2, fresh=0.05)


def misfits_of(inverse: FloatArray, std: float) -> FloatArray:
    """Return the misfits (c, k) of Gaussian measurements (c,) of 1/mu."""
    return np.asarray(((INVERSE - inverse[:, None]) / std) ** 2)


def chained(cells: FloatArray, misfits: FloatArray, known: FrictionParameters = KNOWN) -> tuple[FloatArray, FloatArray]:
    return along_track(cells.astype(np.int64), misfits, np.full(len(cells), PLACE_STD), known)


def density(values: FloatArray, mean: FloatArray | float, std: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((values - mean) / std) ** 2))


def test_three_places_are_the_sum_over_all_courses() -> None:
    inverse, width = np.array([3.0, 6.0, 7.5]), np.gradient(GRID)
    prior = density(GRID, 3.3, 3.0) * width
    prior /= prior.sum()
    step = density(np.log(GRID)[:, None], np.log(GRID), 0.2)
    step = 0.95 * step / step.sum(axis=1, keepdims=True) + 0.05 * prior
    first, second, third = (
        sum(
            share / std * density(GRID, one, std)
            for share, std in ((0.95, np.hypot(0.3, 0.45)), (0.05, np.hypot(0.3, 1.35)))
        )
        for one in inverse
    )
    assert (FrictionParameters().wrong_place_share, FrictionParameters().wrong_factor) == (0.05, 3.0)
    courses = np.einsum("a,ab,bc,a,b,c->abc", prior, step, step, first, second, third)
    courses /= courses.sum()
    found = chained(np.arange(3), misfits_of(inverse, 0.3), KNOWN)
    for place, axes in enumerate(((1, 2), (0, 2), (0, 1))):
        marginal = courses.sum(axis=axes)
        mean = float(marginal @ GRID)
        assert found[0][place] == pytest.approx(mean, abs=0.02)
        assert found[1][place] == pytest.approx(np.sqrt(marginal @ GRID**2 - mean**2), rel=0.05)


def test_places_behind_a_gap_and_places_with_nothing_in_common_stand_alone() -> None:
    inverse = np.array([3.0, 9.0])
    alone = [chained(np.array([0]), misfits_of(inverse[[place]], 0.5), KNOWN) for place in (0, 1)]
    gap = chained(np.array([0, 2]), misfits_of(inverse, 0.5), KNOWN)
    assert gap[0] == pytest.approx([one[0][0] for one in alone], rel=1e-12)
    alike = chained(np.array([0, 1]), misfits_of(inverse, 0.5), replace(KNOWN, fresh=1.0))
    assert alike[0] == pytest.approx(gap[0], rel=1e-9)


def test_a_sharp_end_stays_where_it_is_and_noise_gets_less() -> None:
    rng = np.random.default_rng(4)
    true = np.repeat([3.0, 12.0, 3.0], 12)
    alone, along = [], []
    for _ in range(40):
        measured = true + 0.6 * rng.standard_normal(len(true))
        found = chained(np.arange(len(true)), misfits_of(measured, 0.4), KNOWN)[0]
        assert (found[:12] < 6.67).all()
        assert (found[12:24] > 6.67).all()
        assert (found[24:] < 6.67).all()
        alone.append(measured - true)
        along.append(found - true)
    assert np.std(along) < 0.75 * np.std(alone)


def test_each_place_has_an_error_of_its_own() -> None:
    misfits = misfits_of(np.array([6.0, 6.0]), 0.3)
    apart = along_track(np.array([0, 2]), misfits, np.array([0.45, 1.0]), KNOWN)
    wide, narrow = (along_track(np.array([0]), misfits[:1], np.array([std]), KNOWN) for std in (1.0, 0.45))
    assert apart[1] == pytest.approx([narrow[1][0], wide[1][0]])
    assert wide[1][0] > 1.5 * narrow[1][0]


def test_what_is_known_of_the_chain_is_pinned() -> None:
    assert (len(GRID), GRID[0], GRID[-1]) == (160, 1.0, pytest.approx(1.0 / 0.035))
