"""Blows once a turn of the wheel are found, with their side; those of the track, of waves and of flanges are none."""

from __future__ import annotations

import numpy as np
import pytest
from striking import INTERVAL, Struck, once_a_turn, struck_at
from swaying import rough_track, sway

from estimation.motion.hunting import find_hunting
from estimation.motion.without_blows import BLOWS, blow_times, blows_unless_hunting, find_turn_blows, struck
from estimation.values.arrays import BoolArray
from estimation.values.windows import NO_BLOWS, TurnBlows


def found(signals: Struck) -> TurnBlows:
    return find_turn_blows(signals.lateral, signals.roll, signals.speed, INTERVAL)


@pytest.mark.parametrize("turn", [2.1, 2.83, 3.3])
@pytest.mark.parametrize("speed", [9.0, 20.0, 40.0])
def test_a_flat_is_found_with_its_turn_size_and_wheel(turn: float, speed: float) -> None:
    blows = found(struck_at(once_a_turn(turn), 20.0, speed))
    assert (blows.share, blows.side) == (1.0, 1)
    assert blows.turn_m == pytest.approx(turn, rel=2e-3)
    assert blows.size == pytest.approx(18.0, abs=5.0)


def test_the_other_wheel_is_the_mirror_image_and_an_unknown_one_is_unknown() -> None:
    one = struck_at(once_a_turn(2.83), 20.0, 20.0)
    assert find_turn_blows(-one.lateral, -one.roll, one.speed, INTERVAL).side == -1
    assert find_turn_blows(one.lateral, -one.roll, one.speed, INTERVAL).side == 0


def test_two_flats_on_a_wheelset_are_found() -> None:
    places = np.sort(np.concatenate([once_a_turn(2.83), once_a_turn(2.83) + 1.4]))
    assert found(struck_at(places, 20.0, 20.0)).turn_m == pytest.approx(2.83, rel=2e-3)


@pytest.mark.parametrize("every", [5.0, 5.66, 8.49, 12.0, 14.15, 18.0, 25.0, 36.0])
def test_joints_are_none_though_a_turn_fits_into_their_distance(every: float) -> None:
    assert found(struck_at(np.arange(1.0, 3000.0, every), 30.0, 20.0)) == NO_BLOWS


def test_most_of_the_blows_are_of_the_flat() -> None:
    for by_turn, none in ((2, False), (3, True)):  # as on as many places of the wheel
        blows = found(struck_at(np.arange(1.0, 3000.0, 2.83 / by_turn), 30.0, 15.0))
        assert (blows == NO_BLOWS) == none


def test_sleepers_and_places_at_random_are_none() -> None:
    assert found(struck_at(np.arange(1.0, 3000.0, 0.6), 30.0, 15.0)) == NO_BLOWS
    for seed in range(5):
        places = np.sort(np.random.default_rng(seed).uniform(0.0, 1200.0, 420))
        assert found(struck_at(places, 30.0, 20.0)).share < 0.5


@pytest.mark.parametrize("order", [1, 2, 5])
def test_a_wheel_out_of_round_is_none(order: int) -> None:
    calm = struck_at(np.empty(0), 0.0, 20.0)
    wave = 15.0 * np.sin(2.0 * np.pi * order * 20.0 * INTERVAL * np.arange(len(calm.speed)) / 2.83)
    assert find_turn_blows(calm.lateral + wave, calm.roll + wave, calm.speed, INTERVAL).share < 0.5


def test_vibration_and_calm_running_are_none() -> None:
    for noise in (0.0, 2.0, 5.0):
        assert found(struck_at(np.empty(0), 0.0, 20.0, noise)) == NO_BLOWS


def test_a_wheelset_that_sways_between_its_flanges_has_no_flat() -> None:
    for speed, conicity, stiffness in ((30.0, 0.4, 0.5e6), (40.0, 0.2, 0.2e6), (55.0, 0.15, 0.2e6)):
        motion = sway(speed, conicity, stiffness, rough_track(speed, 20.0, 1e-3))
        hunting = find_hunting(motion.lateral, motion.yaw, motion.speed, motion.interval_s)
        assert blows_unless_hunting(hunting, motion.lateral, 0.3 * motion.lateral, motion.speed, INTERVAL) == NO_BLOWS


def test_blows_from_either_side_in_turn_are_of_flanges() -> None:
    for flipped, none in ((2, True), (3, False)):  # every second blow, every third
        places = once_a_turn(2.83)
        one, other = (struck_at(places[k], 20.0, 20.0, 0.0) for k in _shared(len(places), flipped))
        lateral = one.lateral - (other.lateral - other.calm)
        blows = find_turn_blows(lateral, one.roll + other.roll, one.speed, INTERVAL)
        assert (blows == NO_BLOWS) == none


def _shared(count: int, every: int) -> tuple[BoolArray, BoolArray]:
    flipped = np.arange(count) % every == 0
    return ~flipped, flipped


def test_a_flat_is_of_a_vehicle_that_runs() -> None:
    assert found(struck_at(once_a_turn(2.83), 20.0, 5.5)).share == 1.0
    assert found(struck_at(once_a_turn(2.83), 20.0, 4.5)) == NO_BLOWS


def test_every_turn_has_the_time_of_its_blow() -> None:
    places = once_a_turn(2.83)
    one = struck_at(places, 20.0, 20.0)
    times = blow_times(one.lateral, one.roll, one.speed, INTERVAL, np.zeros(len(one.speed), np.bool_))
    true = places[places < 1200.0] / 20.0 / INTERVAL
    apart = times[5:-5] - true[np.argmin(np.abs(true[:, None] - times[5:-5]), axis=0)]
    assert len(times) == pytest.approx(len(true), abs=8)
    assert apart.std() < 0.15


@pytest.mark.parametrize(
    ("size", "is_blow"), [(BLOWS.least_blow_acceleration - 0.5, False), (BLOWS.least_blow_acceleration + 1.5, True)]
)
def test_a_blow_is_sharper_than_any_motion(size: float, is_blow: bool) -> None:  # noqa: FBT001 - of the table
    one = struck_at(np.array([200.0]), size, 20.0, 0.0)
    spoilt = struck(one.lateral - one.calm, np.zeros(len(one.calm)), INTERVAL)
    assert spoilt.any() == is_blow
    assert spoilt.mean() < 0.002


def test_a_blow_is_six_times_the_vibration() -> None:
    assert (BLOWS.least_blow_acceleration, BLOWS.least_blow_stds) == (8.0, 6.0)
    for size, is_blow in ((22.0, False), (40.0, True)):
        one = struck_at(np.array([200.0]), size, 20.0, 5.0)
        spoilt = struck(one.lateral, np.zeros(len(one.calm)), INTERVAL)
        assert spoilt[2480:2520].any() == is_blow
