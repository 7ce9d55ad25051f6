"""The bias of a moving wheelset against EN 15302: small by the displacement of the standard, large by the axle's."""

from __future__ import annotations

import numpy as np

from bench.en15302 import FORMS, REACH, REACH_SHARE, biases, pairs


def test_a_new_pair_is_within_what_is_to_be_reached() -> None:
    pair = next(one for one in pairs() if (one.rail, one.inclination) == ("60E1", 40))
    true, errors = biases(pair)
    assert tuple(errors) == FORMS
    for form in ("level", "rolling"):
        bias, half_width = errors[form]
        assert (np.abs(bias) <= REACH + REACH_SHARE * true).all(), form
        assert (np.abs(bias) < half_width).all(), form
    assert (errors["axle"][0] > 0.05 * true).all()
