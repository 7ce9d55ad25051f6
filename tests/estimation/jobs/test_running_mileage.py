"""The newest data are those of the last time, whatever the odometer says: it may be reset, exchanged or garbled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from wheelset_life import DAY_NS, START_NS, window_record

from estimation.motion.mileage import running_mileage
from estimation.motion.parameters import MOTION
from estimation.values.windows import WindowRecord


def windows(mileages: Sequence[float], *, every_ns: int = DAY_NS) -> list[WindowRecord]:
    return [
        replace(window_record("W", number), start_ns=START_NS + number * every_ns, mileage_km=mileage)
        for number, mileage in enumerate(mileages)
    ]


def test_a_mileage_that_a_vehicle_can_have_run_is_kept_bit_for_bit() -> None:
    mileages = [0.1 + 299.7 * number for number in range(50)]
    assert running_mileage(windows(mileages)) == mileages
    assert running_mileage(windows([])) == []


@pytest.mark.parametrize("garbled", [1e300, float("nan"), float("inf"), 5e6, -3.0])
def test_a_garbled_mileage_is_no_distance(garbled: float) -> None:
    found = running_mileage(windows([500.0, 600.0, garbled, 800.0, 900.0]))
    assert found == sorted(found)
    assert found[:2] == [500.0, 600.0]
    assert found[4] - found[3] == 100.0
    assert found[3] - found[1] <= MOTION.most_km_day + 1340.0


@pytest.mark.parametrize("garbled", [1e300, float("nan")])
def test_a_garbled_mileage_at_the_begin_moves_nothing(garbled: float) -> None:
    assert running_mileage(windows([garbled, 600.0, 700.0]))[1:] == [600.0, 700.0]


def test_after_a_reset_the_mileage_goes_on() -> None:
    found = running_mileage(windows([90_000.0, 90_500.0, 0.0, 500.0, 1000.0]))
    assert found == [90_000.0, 90_500.0, 90_500.0, 91_000.0, 91_500.0]


def test_a_step_counts_up_to_what_can_be_run_in_the_time() -> None:
    hours, second = 3600 * 10**9, 10**9
    assert running_mileage(windows([0.0, 660.0], every_ns=hours)) == [0.0, 660.0]
    assert running_mileage(windows([0.0, 670.0], every_ns=hours))[1] == pytest.approx(665.0)
    assert running_mileage(windows([0.0, 0.18], every_ns=second)) == [0.0, 0.18]
    assert running_mileage(windows([0.0, 1.0], every_ns=second))[1] == pytest.approx(0.15 + MOTION.most_km_day / 86_400)
