"""Odometer against speed within a window, and speeds and odometers that no vehicle has."""

from __future__ import annotations

import numpy as np
import pytest

from ingest.plausibility import (
    MOST_ODOMETER,
    MOST_SPEED,
    SPARE_M,
    SPARE_SHARE,
    STEPS,
    odometer_excess,
    possible_motion,
)

TICK = np.arange(0, 600, 10)  # of 0.1 s: a minute
RUN = 0.1 * TICK * 20.0  # m at 20 m/s


def excess(odometer: np.ndarray, speed: float = 20.0) -> float:
    return odometer_excess(TICK, np.column_stack([np.full(len(TICK), speed), odometer]), 0.1, 10)


def test_speed_and_odometer_that_go_together_leave_nothing() -> None:
    assert excess(5e6 + RUN) == excess(5e6 - RUN) == 0.0  # one that counts back is none that was reset


@pytest.mark.parametrize("resolution", [1.0, 10.0, 100.0])
def test_a_coarse_odometer_is_believed(resolution: float) -> None:
    assert excess(np.floor((5e6 + RUN) / resolution) * resolution) == 0.0


def test_what_is_allowed_is_a_part_of_the_distance_and_the_steps() -> None:
    run = RUN[-1]
    jump = SPARE_M + SPARE_SHARE * run + STEPS * 20.0
    for more in (0.0, 0.5):
        odometer = 5e6 + RUN + (jump + more) * (TICK > 300)
        assert excess(odometer) == pytest.approx(more, abs=1e-6)
    assert (SPARE_M, SPARE_SHARE, STEPS) == (30.0, 0.2, 2.0)


@pytest.mark.parametrize("odometer", [np.where(TICK < 300, 5e6 + RUN, RUN), np.full(60, 5e6)])
def test_a_reset_or_a_standing_odometer_is_not_believed(odometer: np.ndarray) -> None:
    assert excess(odometer) > 100.0


def test_gaps_are_not_compared() -> None:
    tick = np.array([0, 10, 500, 510])
    values = np.column_stack([np.full(4, 20.0), [0.0, 20.0, 9e6, 9e6 + 20.0]])
    assert odometer_excess(tick, values, 0.1, 10) == 0.0
    assert odometer_excess(tick[:1], values[:1], 0.1, 10) == 0.0


@pytest.mark.parametrize(
    ("speed", "odometer", "kept"),
    [
        (MOST_SPEED, MOST_ODOMETER, (True, True)),
        (-MOST_SPEED, 0.0, (True, True)),
        (MOST_SPEED + 0.1, -0.1, (False, False)),
        (np.inf, 1e300, (False, False)),
        (np.nan, MOST_ODOMETER * 1.001, (False, False)),
    ],
)
def test_a_speed_or_an_odometer_of_no_vehicle_is_not_known(
    speed: float, odometer: float, kept: tuple[bool, bool]
) -> None:
    found = possible_motion(np.array([[speed, odometer]]))
    assert tuple(np.isfinite(found[0]).tolist()) == kept
    assert (MOST_SPEED, MOST_ODOMETER) == (200.0, 1e11)
