"""What the noise of sensors makes of the rolling radius difference, against simulated noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from paper_class import PAPER_CLASS

from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import (
    Arrangement,
    BogieParameters,
    SensorChannel,
    VehicleClass,
    difference_noise,
    displacement_noise,
    usable_cutoff,
)

DT, CUTOFF, SAMPLES = 4e-3, 40.0, 2**18
BOGIE = BogieParameters(wheelbase=2.5, frame_mass=2600.0, frame_yaw_inertia=3000.0, body_mass=16e3)
YAW, FRAME = 2e-3, 1e-3  # noise densities


def integrated(density: float, integrals: int, speed: float, seed: int, cutoff: float = CUTOFF) -> FloatArray:
    """Return white noise integrated so many times, without what is slower than the cut-off wavelength."""
    white = density * np.sqrt(0.5 / DT) * np.random.default_rng(seed).standard_normal(SAMPLES)
    frequency = np.fft.rfftfreq(SAMPLES, DT)
    kept = frequency >= speed / cutoff
    spectrum = np.zeros(len(frequency), dtype=complex)
    spectrum[kept] = np.fft.rfft(white)[kept] / (2j * np.pi * frequency[kept]) ** integrals
    return np.fft.irfft(spectrum, SAMPLES)


def of_class(*, gyroscope: bool = False, bogie: BogieParameters | None = None) -> VehicleClass:
    sensors = replace(
        PAPER_CLASS.sensors,
        yaw=SensorChannel(noise_density=YAW),
        mass_lateral=SensorChannel(noise_density=FRAME),
        yaw_is_gyroscope=gyroscope,
    )
    arrangement = Arrangement.SINGLE_WHEELSET if bogie is None else Arrangement.BOGIE
    return replace(PAPER_CLASS, arrangement=arrangement, bogie=bogie, sensors=sensors)


def variance(yaw: FloatArray) -> float:
    """Return the variance of rL - rR that an error of the angle of the yaw spring makes, m2."""
    p = PAPER_CLASS.parameters
    return float(
        (p.yaw_stiffness * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)) ** 2
        * yaw.var()
    )


@pytest.mark.parametrize("speed", [15.0, 30.0])
def test_an_accelerometer_is_integrated_twice(speed: float) -> None:
    simulated = np.mean([variance(integrated(YAW, 2, speed, seed)) for seed in range(4)])
    assert difference_noise(of_class(), CUTOFF) / speed**3 == pytest.approx(simulated, rel=0.15)


def test_a_gyroscope_is_integrated_once_and_right_at_twenty_metres_a_second() -> None:
    simulated = np.mean([variance(integrated(YAW, 1, 20.0, seed)) for seed in range(4)])
    assert difference_noise(of_class(gyroscope=True), CUTOFF) / 20.0**3 == pytest.approx(simulated, rel=0.1)


def test_both_sensors_of_a_frame_add_their_noise() -> None:
    def yaw_of_spring(seed: int) -> FloatArray:
        front, rear = (integrated(FRAME, 2, 20.0, 10 * seed + n) for n in (1, 2))
        return integrated(YAW, 2, 20.0, 10 * seed) - (front - rear) / BOGIE.wheelbase

    simulated = np.mean([variance(yaw_of_spring(seed)) for seed in range(4)])
    ours = difference_noise(of_class(bogie=BOGIE), CUTOFF) / 20.0**3
    assert ours == pytest.approx(simulated, rel=0.15)
    assert ours > 1.05 * difference_noise(of_class(), CUTOFF) / 20.0**3


def test_the_cut_off_is_shorter_where_the_noise_of_the_yaw_sensor_drowns_long_waves() -> None:
    plain = of_class()

    def with_noise(millimetres: float) -> VehicleClass:
        per_density = np.sqrt(difference_noise(plain, CUTOFF) / 20.0**3) / YAW
        yaw = SensorChannel(noise_density=1e-3 * millimetres / per_density)
        return replace(plain, sensors=replace(plain.sensors, yaw=yaw))

    assert [usable_cutoff(with_noise(size), CUTOFF) for size in (0.29, 0.31, 3.0)] == [40.0, 35.0, 30.0]
    assert usable_cutoff(with_noise(3.0), 25.0) == 25.0
    of_wheelset = WindowParameters.of(with_noise(0.31), None, SignalParameters(), Gates())
    assert of_wheelset.signals.cutoff_wavelength == 35.0


@pytest.mark.parametrize(("speed", "cutoff"), [(20.0, CUTOFF), (12.0, CUTOFF), (12.0, 30.0)])
@pytest.mark.parametrize(("gravity", "height"), [(True, 0.45), (False, 0.53)])
def test_the_roll_that_is_taken_off_the_displacement_brings_its_noise(
    height: float, speed: float, cutoff: float, *, gravity: bool
) -> None:
    """Gravity and height add: both are the same error of the roll."""
    sensors = replace(
        PAPER_CLASS.sensors,
        lateral=SensorChannel(noise_density=1e-3),
        roll=SensorChannel(noise_density=3e-3),
        measures_gravity=gravity,
    )
    simulated = []
    for seed in range(4):
        moved = integrated(1e-3, 2, speed, seed, cutoff) + height * integrated(3e-3, 2, speed, seed + 10, cutoff)
        if gravity:
            moved = moved - 9.81 * integrated(3e-3, 4, speed, seed + 10, cutoff)
        simulated.append(moved.var())
    expected = displacement_noise(replace(PAPER_CLASS, sensors=sensors), cutoff, np.array([speed]))
    assert np.sqrt(expected) == pytest.approx(np.sqrt(np.mean(simulated)), rel=0.1)


def test_a_slow_vehicle_integrates_its_noise_for_longer() -> None:
    """By the third power of the time that a wave takes; at a crawl the tilt, g times the roll, is nearly all."""
    noisy, silent = SensorChannel(noise_density=1e-3), SensorChannel()
    plain = replace(PAPER_CLASS.sensors, lateral=silent, roll=silent, measures_gravity=True)
    for sensors, power in (
        (replace(plain, lateral=noisy), 3),
        (replace(plain, roll=noisy), 7),
        (replace(plain, roll=noisy, roll_is_gyroscope=True), 5),
    ):
        slow, fast = displacement_noise(replace(PAPER_CLASS, sensors=sensors), CUTOFF, np.array([1.0, 2.0]))
        assert slow / fast == pytest.approx(2.0**power, rel=0.05)
