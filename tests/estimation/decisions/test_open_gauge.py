"""From when on an unknown gauge is taken to hide in the scale of an alignment."""

from __future__ import annotations

import pytest

from estimation.track.settings import SectionParameters
from estimation.values.track import OPEN_SCALE, open_gauge_std


@pytest.mark.parametrize(
    ("scale", "share"), [(0.0, 0.0), (0.05, 0.0), (0.056, 0.2), (0.065, 0.5), (0.08, 1.0), (0.3, 1.0)]
)
def test_a_gauge_hides_where_the_scale_is_open(scale: float, share: float) -> None:
    assert (OPEN_SCALE.low, OPEN_SCALE.high) == (0.05, 0.08)
    assert open_gauge_std(scale, 1e-3) == pytest.approx(share * 1e-3)


def test_an_alignment_is_off_by_an_eighth_of_the_gauge_that_hides_in_it() -> None:
    assert SectionParameters().systematic_per_open_gauge == 0.13
