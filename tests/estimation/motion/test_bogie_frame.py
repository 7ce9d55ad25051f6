"""The yaw of a bogie frame from the two sensors on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import GOOD

from estimation.motion.axle_distance import with_frame_yaw
from estimation.values.arrays import FloatArray
from estimation.values.windows import Window

WHEELBASE = 2.5  # m
YAWING = np.array([0.2, -0.4, 0.1, 0.3])  # rad/s2
MIDDLE = np.array([1.0, 2.0, -3.0, 0.5])  # m/s2
GRAVITY_OF_ROLL = np.array([0.3, 0.2, 0.1, -0.2])  # m/s2, of a frame that rolls as one piece


def window(axle: int, frame: FloatArray) -> Window:
    zero, n = np.zeros(len(frame)), len(frame)
    return Window(
        wheelset=f"W{axle}",
        vehicle="V1",
        axle=axle,
        start_ns=60_000_000_000,
        length_ns=4_000_000,
        sample_interval_s=1e-3,
        lateral_acceleration=zero + axle,
        yaw_acceleration=zero,
        roll_acceleration=zero,
        mass_lateral_acceleration=frame,
        speed=zero + 20.0,
        distance=zero,
        valid=np.ones(n, dtype=bool),
        resolution=(1e-4, 1e-4, 1e-4, 1e-4),
        track_section="S1",
        odometer_m=0.0,
        quality=GOOD,
    )


def both() -> tuple[Window, Window]:
    """Return the windows of the front and the rear node of a frame that turns to the left by ``YAWING``."""
    half = 0.5 * WHEELBASE
    front, rear = (MIDDLE + GRAVITY_OF_ROLL + side * half * YAWING for side in (1.0, -1.0))
    return window(1, front), window(2, rear)


def test_both_nodes_find_the_same_yaw_and_gravity_drops_out() -> None:
    front, rear = both()
    for found in (with_frame_yaw(front, rear, WHEELBASE), with_frame_yaw(rear, front, -WHEELBASE)):
        assert found.frame_yaw_acceleration is not None
        np.testing.assert_allclose(found.frame_yaw_acceleration, YAWING, atol=1e-15)
    assert with_frame_yaw(rear, front, -WHEELBASE).wheelset == "W2"


def test_a_sample_is_valid_where_both_are() -> None:
    front, rear = both()
    front = replace(front, valid=np.array([True, False, True, True]))
    rear = replace(rear, valid=np.array([True, True, False, True]))
    found = with_frame_yaw(front, rear, WHEELBASE)
    np.testing.assert_array_equal(found.valid, [True, False, False, True])
    np.testing.assert_array_equal(np.isnan(found.frame_yaw_acceleration), [False, True, True, False])


def test_windows_of_other_times_are_refused() -> None:
    front, rear = both()
    with pytest.raises(ValueError, match="are not of one time"):
        with_frame_yaw(front, replace(rear, start_ns=rear.start_ns + 1), WHEELBASE)
    with pytest.raises(ValueError, match="are not of one time"):
        with_frame_yaw(front, window(2, np.zeros(5)), WHEELBASE)
