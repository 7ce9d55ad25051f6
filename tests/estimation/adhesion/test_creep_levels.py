"""b of vehicles from the level of their creep: usual rails count, slippery ones do not, and no shape does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_friction import a_pass

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.pass_sums import creep_levels, pass_sums
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.opinions import WindowAdhesion
from estimation.values.units import MEDIAN_ERROR, STD_PER_MAD

USUAL = 0.3
BEFORE = FrictionParameters(usual=1.0 / USUAL, level_std=0.1, creep_error_std=0.1)


def levels(
    passes: list[WindowAdhesion], slippery: BoolArray, before: FrictionParameters = BEFORE
) -> tuple[FloatArray, float]:
    sums = pass_sums(passes)
    assert sums is not None
    return creep_levels(sums, np.zeros(len(sums.wheelsets)), slippery, before)


def test_the_b_of_each_vehicle_is_found() -> None:
    passes = [a_pass(number, [USUAL] * 20, creep_error=0.1 if number < 4 else -0.05) for number in range(8)]
    assert levels(passes, np.zeros(20, np.bool_))[0] == pytest.approx([0.1, -0.05], abs=0.01)


@pytest.mark.parametrize(("low", "counts"), [(10, False), (11, True)])
def test_slippery_places_count_for_a_vehicle_that_has_met_little_else(low: int, counts: bool) -> None:  # noqa: FBT001 - a table of cases
    frictions = [0.1] * low + [USUAL] * (20 - low)
    found = levels([a_pass(number, frictions) for number in range(4)], np.array(frictions) < 0.2)
    assert bool(abs(found[0][0]) > 0.04) is counts


def test_a_b_is_believed_as_far_as_it_is_likely() -> None:
    passes, none = [a_pass(number, [USUAL] * 20, creep_error=0.2) for number in range(4)], np.zeros(20, np.bool_)
    (free,), (held,) = (levels(passes, none, replace(BEFORE, creep_error_std=std))[0] for std in (10.0, 1e-4))
    assert free == pytest.approx(0.2, abs=0.01)
    assert abs(held) < 0.02


def test_what_all_vehicles_share_is_what_rails_and_class_leave_open() -> None:
    passes, none = [a_pass(number, [USUAL] * 20) for number in range(4)], np.zeros(20, np.bool_)
    sharp, blunt = (levels(passes, none, replace(BEFORE, level_std=std))[1] for std in (0.5, 100.0))
    assert sharp < 0.5 * blunt
    assert blunt == pytest.approx(0.1, rel=0.01)
    assert (MEDIAN_ERROR, STD_PER_MAD) == (1.2533, 1.4826)
