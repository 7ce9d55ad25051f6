"""A position that is repeated while the vehicle runs is that of the speed, where it ends as the speed says."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.values.arrays import FloatArray
from ingest.align.samples import Track, VehicleMotion
from ingest.plausibility import LEAST_RUN, REPEATED_SPARE_M, REPEATED_SPARE_SHARE, without_repeats

TICK = np.arange(0, 2000)
RUN = np.asarray(0.4 * TICK, np.float64)  # 20 m/s, a frame each 0.02 s


def positions(distance: FloatArray) -> FloatArray:
    return np.asarray(np.column_stack([np.full(len(TICK), 12.0), distance, np.ones(len(TICK))]), np.float64)


def frozen(first: int, last: int, way: float = 1.0) -> FloatArray:
    distance = 5000.0 + way * RUN
    return np.asarray(np.where((first <= TICK) & (last > TICK), distance[first], distance), np.float64)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_tunnel_is_passed_by_the_speed(way: float) -> None:
    found = without_repeats(TICK, positions(frozen(500, 1200, way)), RUN)
    assert found[:, 1] == pytest.approx(5000.0 + way * RUN)


def test_a_tunnel_whose_ends_do_not_fit_is_unknown_inside() -> None:
    distance = frozen(500, 1200)
    for jump, known in (
        (REPEATED_SPARE_M + REPEATED_SPARE_SHARE * 280.0 - 0.1, True),
        (REPEATED_SPARE_M + REPEATED_SPARE_SHARE * 280.0 + 0.1, False),
    ):
        found = without_repeats(TICK, positions(distance + jump * (TICK >= 1200)), RUN)[:, 1]
        assert np.isfinite(found[501:1200]).all() == known
        assert np.isfinite(found[:501]).all()
        assert np.isfinite(found[1200:]).all()
    assert (REPEATED_SPARE_M, REPEATED_SPARE_SHARE, LEAST_RUN) == (1.0, 0.02, 2.0)


def test_a_tunnel_without_an_end_or_into_another_section_is_unknown() -> None:
    found = without_repeats(TICK, positions(frozen(500, 2000)), RUN)[:, 1]
    assert np.isnan(found[501:]).all()
    values = positions(frozen(500, 1200))
    values[1200:, 0] = 13.0
    assert np.isnan(without_repeats(TICK, values, RUN)[501:1200, 1]).all()


def test_a_vehicle_that_stands_and_a_coarse_position_are_right() -> None:
    values = positions(np.full(len(TICK), 5000.0))
    assert without_repeats(TICK, values, np.zeros(len(TICK))) is values
    at_begin = without_repeats(TICK, positions(frozen(0, 700)), RUN)[:, 1]
    assert np.isnan(at_begin[:700]).all()  # it may have been repeated before
    coarse = positions(np.floor(5000.0 + RUN))
    assert without_repeats(TICK, coarse, RUN) is coarse
    assert without_repeats(TICK, values, np.full(len(TICK), np.nan)) is values


def test_the_motion_of_a_vehicle_is_placed_in_the_tunnel() -> None:
    speed = np.column_stack([np.full(len(TICK), 20.0), RUN])
    motion = VehicleMotion(20_000_000, Track(TICK, speed), Track(TICK, positions(frozen(500, 1200))))
    on_grid = motion.on_grid(0, 1900)
    assert on_grid.distance == pytest.approx(5000.0 + RUN[:1900])
