"""Slippery rails against creep that all vehicles have more of than their class: the shape decides, beyond two stds."""

from __future__ import annotations

import numpy as np
import pytest
from test_friction import a_pass

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.friction import slippery_throughout
from estimation.adhesion.pass_sums import pass_sums


def slippery(friction: float, error: float, common: float) -> bool:
    sums = pass_sums([a_pass(number, [friction] * 12, creep_error=error) for number in range(8)])
    assert sums is not None
    return slippery_throughout(sums, np.array([common, common]), np.zeros(8), 0.1, FrictionParameters())


@pytest.mark.parametrize(("common", "found"), [(0.199, False), (0.201, True)])
def test_the_shape_is_asked_from_two_stds_on(common: float, found: bool) -> None:  # noqa: FBT001 - a table of cases
    assert slippery(0.08, 0.0, common) is found
    assert (FrictionParameters().most_creep_stds, FrictionParameters().least_creep_support) == (2.0, 0.8)


def test_an_error_of_creep_is_no_slippery_section() -> None:
    assert not slippery(0.4, 0.25, 0.25)
