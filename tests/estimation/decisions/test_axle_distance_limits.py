"""How far the axles of a bogie are apart by what their nodes measure: right, swapped, another wheelbase, silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_windows import plain_window
from scipy.signal import butter, sosfiltfilt

from estimation.motion.axle_distance import AxleDistance, _highest, axle_distance, check_axle_distance
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window

SPEED = 20.0
RATE = 50.0
COUNT = 3000
WHEELBASE = 2.5


def nodes(distance: float = WHEELBASE, noise: float = 0.1, count: int = COUNT, speed: float = SPEED) -> list[Window]:
    """Return front and rear node on a rough track, each with a wear and noise of its own."""
    step = 0.01
    track = np.cumsum(np.random.default_rng(5).standard_normal(round(speed * count / RATE / step) + 2000))
    rough = sosfiltfilt(butter(2, (1 / 40.0, 1 / 2.0), btype="bandpass", fs=1 / step, output="sos"), track)
    rough /= rough.std()
    at = np.arange(count) * speed / RATE + 8.0
    found = []
    for behind, size in ((0.0, 1.0), (distance, 0.6)):
        roll = size * np.interp(at - behind, step * np.arange(len(rough)), rough)
        found.append(window(roll + noise * np.random.default_rng(int(10 * size)).standard_normal(count), speed))
    return found


def window(roll: FloatArray, speed: float = SPEED) -> Window:
    n = len(roll)
    return plain_window(n / RATE, roll_acceleration=roll, speed=np.full(n, speed), distance=np.arange(n) * speed / RATE)


@pytest.mark.parametrize("distance", [1.8, 2.5, 3.1])
def test_the_distance_of_the_axles_is_found_from_either_side(distance: float) -> None:
    front, rear = nodes(distance)
    for first, second, ahead in ((front, rear, distance), (rear, front, -distance)):
        found = axle_distance(first, second, ahead)
        assert found is not None
        assert found.ahead == pytest.approx(ahead, abs=0.051)
        assert found.correlation > 0.9
        assert check_axle_distance(first, second, ahead) is None


def test_swapped_nodes_and_another_wheelbase_are_contradicted() -> None:
    front, rear = nodes()
    for first, second, ahead in ((rear, front, WHEELBASE), (front, rear, -WHEELBASE), (front, rear, 1.8)):
        reason = check_axle_distance(first, second, ahead)
        assert isinstance(reason, Reason)
        assert reason.code is ReasonCode.AXLE_DISTANCE
    assert check_axle_distance(front, rear, 2.2) is None, "within the tolerance"


def test_a_wheelset_that_is_mounted_the_other_way_round_is_on_its_axle() -> None:
    front, rear = nodes()
    assert check_axle_distance(front, replace(rear, roll_acceleration=-rear.roll_acceleration), WHEELBASE) is None


def test_nodes_that_see_no_common_track_are_silent() -> None:
    rng = np.random.default_rng(8)
    one, other = (window(rng.standard_normal(COUNT)) for _ in range(2))
    assert check_axle_distance(one, other, WHEELBASE) is None
    assert axle_distance(window(np.zeros(COUNT)), other, WHEELBASE) is None


def test_nodes_that_measure_little_of_the_track_are_silent() -> None:
    for noise, silent in ((1.1, True), (0.9, False), (0.5, False), (0.35, False)):
        front, rear = nodes(noise=noise)
        found = axle_distance(rear, front, WHEELBASE)
        assert found is not None
        assert found.ahead == pytest.approx(-WHEELBASE, abs=0.15)
        assert (check_axle_distance(rear, front, WHEELBASE) is None) == silent


@pytest.mark.parametrize(("noise", "found"), [(0.95, True), (1.05, False)])
def test_another_wheelbase_is_found_from_what_is_no_chance(noise: float, *, found: bool) -> None:
    """Five times the std by chance is 0.26 over 1.14 km: noise as large as the roll of the track."""
    front, rear = nodes(noise=noise)
    assert check_axle_distance(front, rear, WHEELBASE) is None
    assert isinstance(check_axle_distance(front, rear, 1.8), Reason) is found


def test_noise_of_high_frequencies_does_not_hide_the_track() -> None:
    """A gyroscope, differentiated: its noise grows with frequency, and a slow vehicle is sampled every 5 cm."""
    slow = [
        replace(node, roll_acceleration=node.roll_acceleration + 3.0 * np.diff(noise))
        for node, noise in zip(
            nodes(count=10_000, speed=2.5), np.random.default_rng(4).standard_normal((2, 10_001)), strict=True
        )
    ]
    found = axle_distance(slow[0], slow[1], WHEELBASE)
    assert found is not None
    assert found.expected > 0.75


def narrow(*waves: tuple[float, float]) -> tuple[Window, Window]:
    """Return front and rear node on waves of (wavelength in m, by how much the rear one is late in m)."""
    at, size = np.arange(COUNT) * SPEED / RATE, 1.0 / len(waves)
    front = sum((size * np.sin(2.0 * np.pi / wave * at) for wave, _ in waves), np.zeros(COUNT))
    rear = sum((size * np.sin(2.0 * np.pi / wave * (at - late)) for wave, late in waves), np.zeros(COUNT))
    return window(front), window(rear)


def test_waves_of_their_own_make_distances_half_a_wave_apart_alike() -> None:
    """Wheelsets that sway at 4.2 m look as if the axles were 4.5 m apart, with the other sign; on file are 2.4 m."""
    front, rear = narrow((4.2, 2.4), (4.4, 2.35), (3.9, 2.5))
    assert check_axle_distance(front, rear, 2.4) is None
    assert check_axle_distance(rear, front, -2.4) is None


@pytest.mark.parametrize(("other", "contradicted"), [(1.85, False), (1.95, True)])
def test_another_distance_must_leave_so_much_less_unexplained(other: float, *, contradicted: bool) -> None:
    expected = 0.3
    correlation = np.sqrt(1.0 - (1.0 - expected**2) / other)
    found = AxleDistance(4.5, float(correlation), expected, 0.1)
    assert found.contradicted is contradicted
    assert replace(found, nearest=0.39).contradicted is False
    assert replace(found, nearest=0.41).contradicted is contradicted
    clear = replace(found, stands_out=True)
    assert replace(clear, nearest=0.39).contradicted is False
    assert replace(clear, nearest=0.41).contradicted is True
    assert replace(clear, nearest=0.99).contradicted is True
    assert replace(clear, nearest=1.01).contradicted is contradicted


@pytest.mark.parametrize(("second", "stands_out"), [(0.96, True), (0.98, False)])
def test_waves_alike_say_nothing_of_the_distance(second: float, *, stands_out: bool) -> None:
    """A wheelset that sways on one wave of 4.8 m: its maxima at 0.6 and 3.0 m are alike, and 2.5 m are on file."""
    lags = 0.1 * (np.arange(101) - 50)
    size = np.where(np.abs(lags - 3.0) < 0.05, 0.5, np.where(np.abs(lags - 0.6) < 0.05, 0.5 * second, 0.0))
    found = _highest(size, WHEELBASE, 0.25)
    assert (found.nearest, found.stands_out) == (pytest.approx(0.5), stands_out)
    assert found.contradicted is stands_out
    exchanged = _highest(0.9 * size[::-1], 3.0, 0.25)
    assert exchanged.leads is (False if stands_out else None)


@pytest.mark.parametrize(("other", "leads"), [(1.23, None), (1.27, False)])
def test_exchanged_nodes_must_leave_so_much_less_unexplained(other: float, *, leads: bool | None) -> None:
    expected = 0.4
    exchanged = float(np.sqrt(1.0 - (1.0 - expected**2) / other))
    found = AxleDistance(-WHEELBASE, exchanged, expected, exchanged)
    assert found.leads is leads
    assert found.contradicted is (leads is False)


@pytest.mark.parametrize(("exchanged", "leads"), [(0.49, None), (0.51, False)])
def test_so_little_in_common_says_nothing_of_the_order(exchanged: float, *, leads: bool | None) -> None:
    assert AxleDistance(-WHEELBASE, exchanged, 0.1, exchanged).leads is leads


def test_too_few_samples_and_short_runs_say_nothing() -> None:
    front, rear = nodes()
    invalid = np.arange(COUNT) < 0.6 * COUNT
    assert axle_distance(front, replace(rear, valid=~invalid), WHEELBASE) is None
    assert axle_distance(*nodes(count=600), WHEELBASE) is None


def test_of_two_waves_alike_the_registered_one_is_believed() -> None:
    """A track of one wavelength of 4.5 m looks the same 4.5 m further on."""
    front, rear = (window(np.sin(2.0 * np.pi / 4.5 * (np.arange(COUNT) * SPEED / RATE - x))) for x in (0.0, 2.5))
    assert check_axle_distance(front, rear, WHEELBASE) is None
    assert check_axle_distance(front, rear, WHEELBASE - 4.5) is None
