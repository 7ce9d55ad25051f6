"""A run of the simulator as an exchange: its true motion, in any axes, units, rate and format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import firwin

from bench.wheelset_motion import wheelset_motion
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.vehicle_class import SensorLayout
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.motion import STEP
from ingest.simulator.scenario_file import read_scenario
from ingest.vehicle_class_schema import shipped_class

VEHICLE, SECTION, LENGTH_M = "X-1", "LINE", 3000.0
START_NS = 1_767_592_800_000_000_000  # 2026-01-05T06:00:00Z
OFFSET_M = 2.0
SCENARIO = f"""\
name = "exchange"
description = "one vehicle with two wheelsets"
seed = 5

[fleet]
code = "X"
name = "Exchange"

[section]
code = "{SECTION}"
number = 7
name = "Line"
length_m = {LENGTH_M}
alignment_std_mm = 1.5

[speed]
lowest_m_s = 20.0
highest_m_s = 24.0

[sessions]
start = 2026-01-05T06:00:00Z
campaigns = 1
minutes_each = 0.5
km_between = 100.0

[[vehicles]]
code = "{VEHICLE}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [{OFFSET_M}, 4.5]

[[vehicles.wheelsets]]
serial = "X-A"

[[vehicles.wheelsets]]
serial = "X-B"
initial_wear_mm = 1.0
"""

EXAMPLE = f"""\
data = "run.csv"

[run]
vehicle = "{VEHICLE}"
section = "{SECTION}"
start = 2026-01-05T06:00:00Z
odometer_km = 1000.0
lateral_includes_gravity = false

[axes]
x = "forward"
y = "left"
z = "up"

[sampling]
rate_hz = 500

[time]
column = "t"
unit = "s"

[position]
column = "s"
unit = "m"

[speed]
column = "v"
unit = "m/s"

[[axles]]
axle = 1
lateral = {{ column = "ay_1", unit = "m/s2" }}
yaw = {{ column = "yaw_1", unit = "rad/s2" }}
roll = {{ column = "roll_1", unit = "rad/s2" }}
mass_lateral = {{ column = "aym_1", unit = "m/s2" }}

[[axles]]
axle = 2
lateral = {{ column = "ay_2", unit = "m/s2" }}
yaw = {{ column = "yaw_2", unit = "rad/s2" }}
roll = {{ column = "roll_2", unit = "rad/s2" }}
mass_lateral = {{ column = "aym_2", unit = "m/s2" }}
"""


@cache
def true_run(folder: Path) -> Mapping[str, FloatArray]:
    """Return the true motion below 30 Hz every 2 ms: columns as in ``EXAMPLE``, and angles and rates beside them."""
    path = folder / "exchange-scenario.toml"
    path.write_text(SCENARIO)
    scenario = read_scenario(path)
    track = scenario_track(scenario)
    run = vehicle_run(scenario, track, scenario.vehicles[0], 0)
    columns: dict[str, FloatArray] = {"t": STEP * np.arange(len(run.speed)), "s": run.distance, "v": run.speed}
    for axle in (1, 2):
        motion = wheelset_motion(scenario, track, run, axle - 1)
        columns |= {
            f"ay_{axle}": np.gradient(motion.lateral_velocity, STEP),  # jumps of the contact alias in accelerations
            f"yaw_{axle}": np.gradient(motion.yaw_rate, STEP),
            f"roll_{axle}": np.gradient(motion.roll_rate, STEP),
            f"aym_{axle}": motion.mass_lateral_acceleration,
            f"yaw_rate_{axle}": motion.yaw_rate,
            f"yaw_angle_{axle}": motion.yaw,
            f"roll_rate_{axle}": motion.roll_rate,
            f"roll_angle_{axle}": motion.roll,
        }
    return {name: (values if name in "tsv" else _smooth(values))[::2] for name, values in columns.items()}


def _smooth(values: FloatArray) -> FloatArray:
    taps = firwin(301, 30.0, fs=1.0 / STEP)
    return np.convolve(np.pad(values, 150, mode="edge"), taps, mode="valid")


def write_csv(path: Path, columns: Mapping[str, FloatArray], *, delimiter: str = ",", decimal: str = ".") -> None:
    table = "\n".join(
        delimiter.join(f"{value:.9g}" for value in row).replace(".", decimal)
        for row in zip(*(column.tolist() for column in columns.values()), strict=True)
    )
    path.write_text(f"{delimiter.join(columns)}\n{table}\n")


def register(unit: UnitOfWork) -> None:
    """Store what the registry must know of the vehicle."""
    registry = unit.registry
    registry.add_fleet(FleetRecord("X", "Exchange"))
    registry.add_vehicle_class(replace(shipped_class("paper"), code="railcar", sensors=SensorLayout()), 1)
    registry.add_vehicle(VehicleRecord(VEHICLE, "X", "railcar", 2, 40.0, (OFFSET_M, 4.5)))
    unit.tracks.add_section(TrackSectionRecord(SECTION, 7, "Line", "56E1", 0.05, 1.435, LENGTH_M))
    for axle in (1, 2):
        registry.add_wheelset(WheelsetRecord(f"X-{axle}", "X", "P8", 0.45, None))
        registry.add_mounting(Mounting(f"X-{axle}", VEHICLE, axle, 0, None, 1000.0, 100.0))
