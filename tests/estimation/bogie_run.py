"""A bogie on a known track: its motion by the simulator, and the windows of both nodes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from paper_class import PAPER_CLASS
from smooth_wheelset import SmoothTable, ideal, mems_windows, track

from estimation.motion.axle_distance import with_frame_yaw
from estimation.motion.integration import WindowParameters
from estimation.values.windows import Motion, Window
from estimation.vehicle.vehicle_class import (
    Arrangement,
    BogieParameters,
    SensorChannel,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
)
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear

WHEELBASE, SECONDS = 2.5, 120
SOFT, COACH = 2.5e6, 62.8e6  # N m/rad
BOGIE = BogieParameters(
    wheelbase=WHEELBASE,
    frame_mass=2615.0,
    frame_yaw_inertia=3067.0,
    body_mass=16e3,
    secondary_lateral_stiffness=0.32e6,
    secondary_lateral_damping=64e3,
    secondary_yaw_stiffness=0.32e6,
)
MEMS = SensorLayout(
    lateral=SensorChannel(1e-3), yaw=SensorChannel(2e-3), roll=SensorChannel(2e-3), mass_lateral=SensorChannel(1e-3),
    measures_gravity=False,
)  # fmt: skip


def wheelset(yaw_stiffness: float) -> VehicleParameters:
    return VehicleParameters(yaw_stiffness=yaw_stiffness, lateral_stiffness=4e6, lateral_damping=4e3, load=90e3)


@cache
def motions(yaw_stiffness: float) -> tuple[WheelsetMotion, ...]:
    """Return the motion of the front and the rear wheelset."""
    gear = RunningGear(wheelset(yaw_stiffness), BOGIE)
    tables = [SmoothTable(0.1), SmoothTable(0.14)]
    return simulate_gear(gear, tables, track(1), np.full(SECONDS * 1000, 20.0), 20.0)


@cache
def windows(yaw_stiffness: float, axle: int) -> tuple[Window, ...]:
    """Return what the node at an axle (1 or 2) measures."""
    found = mems_windows(motions(yaw_stiffness)[axle - 1], seed=axle)
    return tuple(replace(window, wheelset=f"W{axle}", axle=axle) for window in found)


def of_bogie(yaw_stiffness: float, wheelbase: float = WHEELBASE) -> VehicleClass:
    """Return the class of the bogie."""
    return replace(
        PAPER_CLASS,
        code="bogie",
        arrangement=Arrangement.BOGIE,
        parameters=wheelset(yaw_stiffness),
        bogie=replace(BOGIE, wheelbase=wheelbase),
        sensors=MEMS,
    )


def single(yaw_stiffness: float) -> VehicleClass:
    """Return the class of a wheelset whose yaw spring is tied to what does not yaw."""
    return replace(PAPER_CLASS, parameters=wheelset(yaw_stiffness), sensors=MEMS)


def joined(yaw_stiffness: float, axle: int, wheelbase: float = WHEELBASE) -> list[Window]:
    """Return the windows of an axle with the yaw of the frame."""
    ahead = wheelbase if axle == 1 else -wheelbase
    pairs = zip(windows(yaw_stiffness, axle), windows(yaw_stiffness, 3 - axle), strict=True)
    return [with_frame_yaw(own, partner, ahead) for own, partner in pairs]


def parameters(vehicle_class: VehicleClass) -> WindowParameters:
    return WindowParameters(vehicle_class)


def ideal_in_bogie(m: WheelsetMotion) -> Motion:
    """Return the motion of a wheelset in a bogie as ideal sensors measure it."""
    assert m.frame_yaw is not None
    return replace(
        ideal(m),
        frame_yaw=m.frame_yaw,
        frame_yaw_rate=np.gradient(m.frame_yaw, 1e-3),
        frame_displacement=m.mass_lateral_displacement,
    )
