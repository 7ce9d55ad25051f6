"""What the library of signatures tries and refuses: just inside of every limit, and just outside."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimation.signatures.calibration import conicity_grid, outside
from estimation.signatures.library import Library
from estimation.signatures.mixed_model import Likelihood
from estimation.values.signatures import Place

MARGIN = 0.01


def levels(*of_sections: float) -> tuple[float, float]:
    """Return between which levels a place is like a library of sections with one place each."""
    places = {Place(f"S{number}", 0): number for number in range(len(of_sections))}
    sections = {place.section: number for place, number in places.items()}
    stub = SimpleNamespace(places=places, sections=sections, model=SimpleNamespace(levels=np.array(of_sections)))
    return Library.levels(cast("Any", stub), 1)


def likely(conicities: tuple[float, ...], probabilities: tuple[float, ...]) -> Likelihood:
    return Likelihood(np.array(conicities), -2.0 * np.log(probabilities), whole=0.0, roll=0.0)


def test_a_track_may_be_rougher_or_smoother_by_a_fifth_of_a_logarithm_at_least() -> None:
    assert levels(0.0, 0.05, 0.1) == (pytest.approx(-0.2), pytest.approx(0.3))
    assert levels(0.0, 0.19, 0.38) == (pytest.approx(-0.2), pytest.approx(0.58))
    assert levels(0.0, 0.21, 0.3) == (pytest.approx(-0.21), pytest.approx(0.51))


@pytest.mark.parametrize(("probability", "refused"), [(0.0199, False), (0.0201, True)])
@pytest.mark.parametrize("beyond", [0.189, 0.311])
def test_two_per_cent_beyond_the_library_are_too_much(beyond: float, probability: float, *, refused: bool) -> None:
    found = likely((0.2, 0.3, beyond), (0.5, 0.5 - probability, probability))
    assert outside(found, (0.2, 0.3), MARGIN) is refused
    near = likely((0.2, 0.3, float(np.clip(beyond, 0.1901, 0.3099))), (0.4, 0.3, 0.3))
    assert not outside(near, (0.2, 0.3), MARGIN)


def test_conicities_are_tried_every_two_thousandths() -> None:
    grid = conicity_grid(np.array([0.2, 0.3]), MARGIN)
    np.testing.assert_allclose(np.diff(grid), 0.002)
    assert grid[0] == pytest.approx(0.18)
    assert 0.32 - 1e-9 <= grid[-1] < 0.3221
    assert conicity_grid(np.array([0.02, 0.3]), MARGIN)[0] == pytest.approx(0.01)
