"""Blocks of data and the groups they are assigned to; empty tables; what the jobs make of regular traffic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables import bin_table
from estimation.values.geometry import BinStatus
from estimation.values.quantities import Status

DAY = 86_400 // 20  # blocks of 20 s
FIRST = 1_704_691_800 // 20


@given(start=st.integers(0, 10**9), groups=st.integers(4, 64))
def test_blocks_in_a_row_are_dealt_evenly(start: int, groups: int) -> None:
    assigned = bin_table.group_of(np.arange(start, start + 3 * groups), groups)
    assert assigned.min() >= 0
    assert assigned.max() < groups
    count = np.bincount(assigned, minlength=groups)
    assert count.max() <= 4
    whole = start // groups * groups  # a whole round has each group once
    assert sorted(bin_table.group_of(np.arange(whole, whole + groups), groups)) == list(range(groups))


@pytest.mark.parametrize("period", [DAY, DAY // 2, 7 * DAY, 16, 180, 3 * 60 * 60 // 20])
def test_a_minute_at_the_same_time_of_every_day_reaches_every_group(period: int) -> None:
    """A vehicle that keeps its timetable must not fill the same few groups for ever."""
    blocks = (FIRST + np.arange(40)[:, None] * period + np.arange(3)).ravel()
    count = np.bincount(bin_table.group_of(blocks, 16), minlength=16)
    assert count.min() >= 3
    assert count.max() <= 15


def test_an_empty_table_says_that_nothing_is_known() -> None:
    parameters = bin_table.BinParameters(band_limited=True)
    found = estimate_geometry(bin_table.init(parameters), parameters, GeometryParameters())
    assert found.status is Status.UNESTIMATED
    assert found.reason
    assert found.windows == 0
    assert set(found.rolling_radius_difference.status) == {BinStatus.TOO_FEW}
    assert all(value.value is None for value in (found.equivalent_conicity, found.nonlinearity, *found.conicity))
