"""A wheelset on a track that rolls: gravity in its sensors, and the axle beside the middle of the rails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import GOOD

from estimation.motion.cross_level import CONTACT_ROLL, at_rail_level, relative_displacement
from estimation.motion.integration import integrate, mirrored
from estimation.motion.parameters import SignalParameters
from estimation.motion.window_motion import motion
from estimation.values.arrays import FloatArray
from estimation.values.motion import Motion
from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window

DT, SPEED, RADIUS, SECONDS = 4e-3, 20.0, 0.45, 60.0
T = np.arange(0.0, SECONDS, DT)
INNER = slice(2000, -2000)  # away from the ends, where the high-pass sees one side only


def wave(size: float, wavelength: float, *, accelerated: bool = False) -> FloatArray:
    """Return a sine along the track, or its second derivative by time."""
    omega = 2.0 * np.pi * SPEED / wavelength
    return np.asarray(size * np.sin(omega * T) * (-(omega**2) if accelerated else 1.0))


TRUE = wave(2e-3, 13.0)  # x, m, relative to the rails
ALIGNMENT = wave(1.5e-3, 9.0)  # d, m
ROLL_OF_TRACK = wave(1e-3, 17.0)  # rad: 1.5 mm of cross level


def window(*, gravity: bool = True) -> Window:
    """Return what sensors at the height of the axle measure: y'' + g phi, and phi of track and contact."""
    roll = ROLL_OF_TRACK + CONTACT_ROLL * TRUE
    d2_roll = wave(1e-3, 17.0, accelerated=True) + CONTACT_ROLL * wave(2e-3, 13.0, accelerated=True)
    d2_track = wave(1e-3, 17.0, accelerated=True)
    axle = wave(1.5e-3, 9.0, accelerated=True) + wave(2e-3, 13.0, accelerated=True) - RADIUS * d2_track
    zero = np.zeros(len(T))
    return Window(
        wheelset="W1",
        vehicle="V1",
        axle=1,
        start_ns=0,
        length_ns=round(SECONDS * 1e9),
        sample_interval_s=DT,
        lateral_acceleration=axle + (9.81 * roll if gravity else 0.0),
        yaw_acceleration=zero,
        roll_acceleration=d2_roll,
        mass_lateral_acceleration=axle + (9.81 * roll if gravity else 0.0),
        speed=zero + SPEED,
        distance=SPEED * T + 10.0,
        valid=np.ones(len(T), dtype=bool),
        resolution=(1e-4, 1e-4, 1e-4, 1e-4),
        track_section="S1",
        odometer_m=0.0,
        quality=GOOD,
        measures_gravity=gravity,
    )


def track() -> TrackAlignment:
    s = np.arange(0.0, SPEED * SECONDS + 20.0, 0.25)
    zero = np.zeros(len(s))
    d = 1.5e-3 * np.sin(2.0 * np.pi * (s - 10.0) / 9.0)
    passes = zero.astype(np.int64)
    return TrackAlignment("S1", 1, s, d, zero, zero, zero, passes, Status.ESTIMATED)


def moved(one: Window) -> Motion:
    found = motion(one, track(), SignalParameters(), radius=RADIUS)
    assert isinstance(found, Motion)
    return found


def off(found: Motion) -> float:
    """Return the rms error of the displacement over that of the true one."""
    return float(np.std((found.displacement - TRUE)[INNER]) / TRUE.std())


def test_the_displacement_relative_to_the_rails_comes_out() -> None:
    assert off(moved(window())) < 0.03
    blind = replace(window(), measures_gravity=False)
    assert off(moved(blind)) > 0.3, "cross level is in it as gravity and as roll"


def test_a_sensor_without_gravity_in_it_is_left_as_it_is() -> None:
    """Then the roll is not taken off either: y - d stands, at the height of the axle."""
    expected = TRUE - RADIUS * ROLL_OF_TRACK
    error = (moved(window(gravity=False)).displacement - expected)[INNER]
    assert error.std() < 0.02 * TRUE.std()


def test_the_mirror_image_of_a_window_has_its_gravity_mirrored_too() -> None:
    one = window()
    signals = SignalParameters()
    direct = integrate(one, one.valid, signals)
    twice = mirrored(mirrored(direct))
    other = mirrored(direct)
    again = integrate(other.window, one.valid, signals)
    for ours, theirs, same in zip(other.segments, again.segments, twice.segments, strict=True):
        assert ours.level
        assert theirs.level
        np.testing.assert_allclose(ours.displacements, theirs.displacements, atol=1e-12)
        np.testing.assert_array_equal(same.displacements, direct.segments[0].displacements)


@pytest.mark.parametrize("seen", [-4e-3, 1e-3])
def test_the_roll_of_the_contact_is_parted_from_that_of_the_track(seen: float) -> None:
    """A wheelset displaced by x on a track that rolls: 0.105 rad/m of the roll is its own."""
    x, track_roll = np.array([seen]), 2e-3
    y, roll = x - RADIUS * track_roll, track_roll + 0.105 * x
    np.testing.assert_allclose(relative_displacement(y, roll, RADIUS), x, rtol=1e-12)
    np.testing.assert_allclose(at_rail_level(y, roll, RADIUS), x * (1.0 + 0.45 * 0.105), rtol=1e-12)
