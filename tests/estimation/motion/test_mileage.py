"""Mileages that cannot be: below the mounting, too far, garbled, of an odometer that was reset."""

from __future__ import annotations

import random

import pytest

from estimation.motion.mileage import implausible_mileages
from estimation.motion.parameters import MOTION
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Mounting
from estimation.values.windows import MileageReading

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS
MINUTE_NS = 60 * 10**9
MOUNTING = Mounting("WS-1", "V-1", 1, 0, None, 20_000.0, 100_000.0)
SPEED = 100 / 3.6  # m/s


def journey(day: float, mileage_km: float, windows: int = 4) -> list[MileageReading]:
    """Return windows of a minute at 60 km/h."""
    return [MileageReading(int(day * DAY_NS) + i * MINUTE_NS, mileage_km + i) for i in range(windows)]


def history(
    days: int, first_day: int = 1, first_km: float = 100_100.0, per_day_km: float = 300.0
) -> list[MileageReading]:
    return [one for day in range(days) for one in journey(first_day + day, first_km + per_day_km * day)]


def refused(readings: list[MileageReading]) -> list[float]:
    """Return the mileages that are not believed, whatever the order of arrival."""
    found = implausible_mileages(readings, MOUNTING, SPEED)
    assert {reason.code for reason in found.values()} <= {ReasonCode.ODOMETER_IMPLAUSIBLE}
    for seed in range(3):
        shuffled = random.Random(seed).sample(readings, len(readings))  # noqa: S311 - a test
        assert implausible_mileages(shuffled, MOUNTING, SPEED) == found
    return [one.mileage_km for one in readings if one.start_ns in found]


def test_what_runs_on_is_believed() -> None:
    assert refused([]) == refused(history(1)) == refused(history(20)) == []


@pytest.mark.parametrize(
    ("mileage_km", "believed"),
    [
        (100_000.0 - MOTION.slack_km, True),
        (100_000.0 - MOTION.slack_km - 0.1, False),
        (100_000.0 + MOTION.slack_km + 24 * 100 * MOTION.speed_slack_factor, True),
        (100_000.0 + MOTION.slack_km + 24 * 100 * MOTION.speed_slack_factor + 0.1, False),
        (1e300, False),
        (float("nan"), False),
        (float("-inf"), False),
    ],
)
def test_a_mileage_is_possible_since_the_mounting(mileage_km: float, *, believed: bool) -> None:
    assert (refused([MileageReading(DAY_NS, mileage_km)]) == []) == believed


def test_limits_of_what_is_believed() -> None:
    assert (MOTION.most_mileage_km, MOTION.slack_km, MOTION.speed_slack_factor, MOTION.journey_pause_ns) == (
        1e8,
        50.0,
        1.25,
        30 * MINUTE_NS,
    )
    long_ago = Mounting("WS-1", "V-1", 1, -(2**62), None, 0.0, 0.0)
    for mileage_km, refusals in ((MOTION.most_mileage_km, 0), (MOTION.most_mileage_km + 1.0, 1)):
        assert len(implausible_mileages([MileageReading(2**62, mileage_km)], long_ago, 1e6)) == refusals


def test_an_odometer_that_contradicts_the_speed_is_not_believed() -> None:
    readings = [*history(2), MileageReading(4 * DAY_NS, 101_100.0, 0.1)]
    assert refused(readings) == [101_100.0]


@pytest.mark.parametrize("mileage_km", [100_000.0, 100_250.0, 102_000.0])
@pytest.mark.parametrize("day", [1.5, 5.5, 9.5])
def test_one_garbled_recording_is_left_out_wherever_it_is(day: float, mileage_km: float) -> None:
    garbled = journey(day, mileage_km)
    good = history(10)
    possible = 100_100.0 + 300.0 * (int(day) - 1) <= mileage_km <= 100_100.0 + 300.0 * int(day)
    assert refused([*good, *garbled]) == ([] if possible else [one.mileage_km for one in garbled])


@pytest.mark.parametrize("after", [1, 2, 5, 40, 150])
@pytest.mark.parametrize("before", [2, 3, 10, 20])
def test_after_a_reset_nothing_is_believed_until_the_registry_knows(before: int, after: int) -> None:
    """The mileage falls to that of the mounting, and in 150 days runs far beyond where it was."""
    reset = history(after, first_day=before + 1, first_km=99_990.0)
    assert refused([*history(before), *reset]) == [one.mileage_km for one in reset]


def test_the_first_recording_alone_can_be_the_garbled_one() -> None:
    garbled = journey(0.5, 100_900.0)
    assert refused([*garbled, *history(5, first_km=100_100.0)]) == [one.mileage_km for one in garbled]


def test_a_vehicle_that_is_faster_than_it_can_be_is_not_believed() -> None:
    good = journey(3, 100_500.0, 9)
    fast = MileageReading(good[4].start_ns + 1, good[4].mileage_km + 2.5)
    assert refused([*good, fast]) == [fast.mileage_km]
