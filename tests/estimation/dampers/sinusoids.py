"""Running gears on sums of sinusoids: what is above follows by the complex stiffnesses of its suspension, exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.adhesion_fleet import GOOD
from estimation.adhesion.creep_forces import gear_segments
from estimation.dampers.damper import window_damper
from estimation.motion.integration import SignalParameters
from estimation.values.arrays import FloatArray
from estimation.values.opinions import WindowDamper
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import (
    Arrangement,
    BogieParameters,
    ClassOnFile,
    SensorChannel,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
)

DT, WINDOW_S, DENSITY = 0.004, 60.0, 1e-3
SENSORS = SensorLayout(lateral=SensorChannel(DENSITY), yaw=SensorChannel(DENSITY), mass_lateral=SensorChannel(DENSITY))
P = VehicleParameters(wheelset_mass=1813.0, lateral_stiffness=5e6, lateral_damping=4e3, suspended_mass=9300.0)
BOGIE = BogieParameters(2.5, 2600.0, 2000.0, 16_000.0, 0.32e6, 64e3)
SOFT = VehicleClass("soft", "soft", "test", Arrangement.BOGIE, P, BOGIE, SENSORS)
SINGLE = VehicleClass("single", "single", "test", Arrangement.SINGLE_WHEELSET, VehicleParameters(), None, SENSORS)


def following(vehicle_class: VehicleClass, share: float, omega: FloatArray) -> FloatArray:
    """Return what is above over what wheelsets do, (k,) complex, at angular frequencies."""
    s, p, bogie = 1j * omega, vehicle_class.parameters, vehicle_class.bogie
    if bogie is None:
        spring = p.lateral_stiffness + share * p.lateral_damping * s
        return np.asarray(spring / (p.suspended_mass * s**2 + spring))
    primary = 2.0 * (p.lateral_stiffness + p.lateral_damping * s)
    secondary = bogie.secondary_lateral_stiffness + share * bogie.secondary_lateral_damping * s
    carried = secondary * bogie.body_mass * s**2 / (bogie.body_mass * s**2 + secondary)
    return np.asarray(primary / (bogie.frame_mass * s**2 + primary + carried))


def windows_of(
    vehicle_class: VehicleClass, share: float, number: int = 0, *, size: float = 0.03, noise: float = DENSITY
) -> list[Window]:
    """Return the windows of a running gear; ``size`` is the amplitude of each sinusoid, m/s2."""
    rng = np.random.default_rng((5, number))
    t = DT * np.arange(round(WINDOW_S / DT))
    omega = 2.0 * np.pi * rng.uniform(0.3, 12.0, 100)
    common = size * np.exp(2j * np.pi * rng.uniform(size=100))
    waves = np.exp(1j * np.outer(omega, t))
    lateral, above = (common @ waves).real, ((common * following(vehicle_class, share, omega)) @ waves).real
    turned = size * (np.exp(2j * np.pi * rng.uniform(size=100)) @ waves).real
    std = noise / np.sqrt(2.0 * DT)
    places = (0.0,) if vehicle_class.bogie is None else (1.25, -1.25)
    return [
        Window(
            wheelset=f"W{axle}",
            vehicle="V",
            axle=axle,
            start_ns=number * 60_000_000_000,
            length_ns=60_000_000_000,
            sample_interval_s=DT,
            lateral_acceleration=lateral + 0.7 * np.sign(place) * turned + std * rng.standard_normal(len(t)),
            yaw_acceleration=turned,
            roll_acceleration=np.zeros(len(t)),
            mass_lateral_acceleration=above + place * turned + std * rng.standard_normal(len(t)),
            speed=np.full(len(t), 20.0),
            distance=20.0 * t,
            valid=np.ones(len(t), np.bool_),
            resolution=(1e-4, 1e-4, 1e-4, 1e-4),
            track_section="S",
            odometer_m=1e6 + 1200.0 * number,
            quality=GOOD,
        )
        for axle, place in enumerate(places, start=1)
    ]


def judged(windows: list[Window], vehicle_class: VehicleClass) -> WindowDamper:
    """Return what windows of one time say."""
    gear = gear_segments(windows, vehicle_class, SignalParameters())
    return window_damper(windows[0], "d", gear, ClassOnFile(vehicle_class))


def several(
    vehicle_class: VehicleClass, share: float, count: int = 6, first: int = 0, *, on_file: VehicleClass | None = None
) -> list[WindowDamper]:
    """Return what ``count`` windows of a running gear say."""
    numbers = range(first, first + count)
    return [judged(windows_of(vehicle_class, share, number), on_file or vehicle_class) for number in numbers]


def stiffer(vehicle_class: VehicleClass, **factors: float) -> VehicleClass:
    """Return a class whose bogie has parameters by factors of its own."""
    bogie = vehicle_class.bogie
    assert bogie is not None
    changed = {name: factor * getattr(bogie, name) for name, factor in factors.items()}
    return replace(vehicle_class, bogie=replace(bogie, **changed))
