"""The compiled sums that tell the rolling radius against those in arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bogie_run import SOFT, of_bogie
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles.rolling_sums import rolling_sums as plain_rolling_sums
from paper_class import PAPER_CLASS
from smooth_wheelset import GOOD

from estimation.motion.integration import SignalParameters
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_sums import TERMS, rolling_sums
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.vehicle_class import SensorChannel, SensorLayout, VehicleClass

SIGNALS = SignalParameters()
INTERVAL_S = 0.02


def window_of(seed: int, n: int, gaps: list[tuple[int, int]], *, in_bogie: bool = False) -> Window:
    rng = np.random.default_rng(seed)
    valid = np.ones(n, dtype=bool)
    for first, length in gaps:
        valid[first : first + length] = False
    speed = rng.uniform(8.5, 30.0) + 0.4 * np.sin(np.arange(n) / 100.0)
    accelerations = {name: np.where(valid, rng.standard_normal(n), np.nan) for name in ACCELERATIONS}
    frame = np.where(valid, rng.standard_normal(n), np.nan) if in_bogie else None
    return Window(
        wheelset="W", vehicle="V", axle=1, start_ns=0, length_ns=20_000_000 * n, sample_interval_s=INTERVAL_S,
        **accelerations, speed=speed, distance=np.arange(n) * 0.4, valid=valid, resolution=(0.01, 0.02, 0.03, 0.04),
        track_section=None, odometer_m=0.0, quality=GOOD, frame_yaw_acceleration=frame,
    )  # fmt: skip


def class_of(*, gravity: bool, yaw_rate: bool, roll_rate: bool, on_file: bool, in_bogie: bool) -> VehicleClass:
    channel = SensorChannel(3e-3) if on_file else SensorChannel()
    sensors = SensorLayout(
        lateral=channel, yaw=channel, roll=channel, mass_lateral=channel, measures_gravity=gravity,
        yaw_is_gyroscope=yaw_rate, roll_is_gyroscope=roll_rate,
    )  # fmt: skip
    return replace(of_bogie(SOFT) if in_bogie else PAPER_CLASS, sensors=sensors)


# A window that runs with its rear end first.
@example(seed=70, n=1000, gaps=[], kind=(False, False, False, False, False))
@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(300, 3000),
    gaps=st.lists(st.tuples(st.integers(0, 2999), st.integers(1, 50)), max_size=3),
    kind=st.tuples(*[st.booleans()] * 5),
)
def test_every_part_has_the_sums_of_plain_arrays(
    seed: int, n: int, gaps: list[tuple[int, int]], kind: tuple[bool, bool, bool, bool, bool]
) -> None:
    gravity, yaw_rate, roll_rate, on_file, in_bogie = kind
    window = window_of(seed, n, gaps, in_bogie=in_bogie)
    assumed = class_of(gravity=gravity, yaw_rate=yaw_rate, roll_rate=roll_rate, on_file=on_file, in_bogie=in_bogie)
    found, expected = (of(window, assumed, SIGNALS) for of in (rolling_sums, plain_rolling_sums))
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for name in ("products", "noise"):
            sums, plain = getattr(one, name), getattr(other, name)
            scale = np.sqrt(np.einsum("bii,bjj->bij", plain, plain))  # of what is multiplied
            np.testing.assert_array_less(np.abs(sums - plain), 1e-11 * scale + 1e-300)
            np.testing.assert_array_equal(sums, sums.transpose(0, 2, 1))


def test_parts_are_some_seconds_long_and_one_without_a_piece_is_left_out() -> None:
    whole = rolling_sums(window_of(1, 3000, []), PAPER_CLASS, SIGNALS)
    assert len(whole) == 4
    assert whole[0].products.shape == (MOTION.wavelength_bands, TERMS, TERMS)
    assert len(rolling_sums(window_of(1, 3000, [(700, 900)]), PAPER_CLASS, SIGNALS)) == 3
    assert rolling_sums(window_of(1, 300, []), PAPER_CLASS, SIGNALS) == ()


def test_a_wheelset_of_a_bogie_says_nothing_without_the_yaw_of_its_frame() -> None:
    assert len(rolling_sums(window_of(1, 3000, [], in_bogie=True), of_bogie(SOFT), SIGNALS)) == 4
    assert rolling_sums(window_of(1, 3000, []), of_bogie(SOFT), SIGNALS) == ()
