"""What goes beside the recordings: the operator's registry, the track as surveyed, and the truth.

The registry is what an operator would know and write; the truth is for tests, benchmarks and reports alone.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.fields import JsonValue
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting, Reprofiling
from ingest.file_value import entry_of
from ingest.simulator.axle_motion import GeometryTruth, WearState, wear_at, worn_profiles
from ingest.simulator.campaign import failed
from ingest.simulator.scenario import Scenario, VehiclePlan, WheelsetPlan
from ingest.simulator.section import SectionPlan
from ingest.simulator.sensors import Channel
from ingest.simulator.track import TrackTruth, write_track
from ingest.vehicle_class_schema import class_tables


def class_entry(scenario: Scenario, code: str) -> JsonValue:
    """Return the entry of a class of a scenario: with the parameters of its vehicles and the sensors of its nodes."""
    bogie, sensors = scenario.bogie, scenario.sensors
    tables, errors = class_tables(scenario.parameters, bogie), sensors.errors
    scale_std = errors.scale if errors.stated_scale is None else errors.stated_scale
    entry: dict[str, JsonValue] = {
        "code": code,
        "name": code,
        "source": f"scenario {scenario.name}",
        "arrangement": "single_wheelset" if bogie is None else "bogie",
        "wheelset": tables.pop("wheelset"),
        "primary_suspension": tables.pop("primary_suspension"),
        "creep": {"from": "given", **tables.pop("creep")},
        "sensors": {
            "rate_hz": float(sensors.rate_hz),
            "measures_gravity": sensors.measures_gravity,
            "lateral": _sensor(sensors.lateral, scale_std, "axle_box", "y"),
            "yaw": _sensor(sensors.yaw, scale_std, "axle_box", "z"),
            "roll": _sensor(sensors.roll, scale_std, "axle_box", "x"),
            "mass_lateral": _sensor(sensors.mass_lateral, scale_std, "mass" if bogie is None else "frame", "y"),
        },
    }
    return entry | tables


def _sensor(channel: Channel, scale_std: float, place: str, axis: str) -> JsonValue:
    linear = axis == "y"
    kind = "accelerometer" if linear else "gyroscope" if channel.gyroscope else "angular_accelerometer"
    unit = "m_s2" if linear else "rad_s" if channel.gyroscope else "rad_s2"
    entry: dict[str, JsonValue] = {
        "kind": kind,
        "place": place,
        "axis": axis,
        f"noise_density_{unit}_rthz": channel.noise_density,
        "scale_std": scale_std,
    }
    return entry if math.isinf(channel.limit) else entry | {f"range_{unit}": channel.limit}


REGISTRY_FILE = "registry.json"
TRUTH_FILE = "truth.json"
REGISTRY_FORMAT = "treadwatch-registry-1"
TRUTH_FORMAT = "treadwatch-truth-1"
_CURVE_STRIDE = 2


@dataclass(frozen=True, slots=True)
class WheelsetTruth:
    """What is true of one wheelset in one campaign."""

    vehicle: str
    axle: int  # from 1
    campaign: int  # from 1
    wear: WearState
    geometry: GeometryTruth


def write_registry(folder: Path, scenario: Scenario, track: TrackTruth, survey: TrackTruth) -> Path:
    """Write the registry and, if there is one, the surveyed track into ``folder``; return the registry's path."""
    section = scenario.section
    track_file = f"{section.code.lower()}.csv"
    length = track.length if section.recipe is None else section.recipe.length
    if section.surveyed or section.gauge_surveyed:
        on = (survey.s >= 0.0) & (survey.s <= length)
        if not on.all() and survey.curves is None:
            survey = TrackTruth(survey.s[on], survey.alignment[on], survey.gauge_deviation[on])
        write_track(folder / track_file, survey, gauge_only=not section.surveyed)
    content: dict[str, JsonValue] = {
        "format": REGISTRY_FORMAT,
        "fleets": [{"code": scenario.fleet_code, "name": scenario.fleet_name}],
        "vehicle_classes": [
            class_entry(scenario, code) for code in sorted({plan.vehicle_class for plan in scenario.vehicles})
        ],
        "vehicles": [_vehicle(scenario, plan) for plan in scenario.vehicles],
        "wheelsets": [_wheelset(scenario, item) for plan in scenario.vehicles for item in plan.wheelsets],
        "mountings": [
            entry_of(_mounting(scenario, plan, axle))
            for plan in scenario.vehicles
            for axle in range(len(plan.wheelsets))
        ],
        "reprofilings": [
            entry_of(_reprofiling(scenario, item, odometer))
            for plan in scenario.vehicles
            for item in plan.wheelsets
            if item.reprofilings_registered
            for odometer in item.reprofilings
        ],
        "track_sections": [_section(section, length, track_file)],
    }
    if scenario.class_on_file is not None:
        path = scenario.class_on_file.path
        shutil.copyfile(path, folder / path.name)
        content["vehicle_classes"] = [{"file": path.name}]
    if scenario.drawn is not None and scenario.drawn.profiles_measured:
        content["measured_profiles"] = _measured_profiles(folder, scenario, scenario.drawn.profiles_measured)
    return write_json(folder / REGISTRY_FILE, content)


def write_truth(folder: Path, scenario: Scenario, truths: Sequence[WheelsetTruth]) -> Path:
    """Write what is true of every wheelset and campaign into ``folder``; return the file's path."""
    wheelsets: list[JsonValue] = []
    for vehicle in scenario.vehicles:
        for axle, plan in enumerate(vehicle.wheelsets, start=1):
            runs = sorted(
                (item for item in truths if item.vehicle == vehicle.code and item.axle == axle),
                key=lambda item: item.campaign,
            )
            if runs:
                campaigns: list[JsonValue] = [_campaign(scenario, vehicle, plan, item) for item in runs]
                head: dict[str, JsonValue] = {"serial": plan.serial, "vehicle": vehicle.code, "axle": axle}
                wheelsets.append(head | {"campaigns": campaigns})
    content: dict[str, JsonValue] = {
        "format": TRUTH_FORMAT,
        "scenario": scenario.name,
        "seed": scenario.seed,
        "wheelsets": wheelsets,
    }
    return write_json(folder / TRUTH_FILE, content)


def write_json(path: Path, content: JsonValue) -> Path:
    """Write a JSON file so that it is either there whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)  # noqa: PTH105 - Path.replace is the same call
    return path


def _section(section: SectionPlan, length: float, track_file: str) -> JsonValue:
    entry: dict[str, JsonValue] = {
        "code": section.code,
        "number": section.number,
        "name": section.name,
        "rail_profile": section.rail_profile,
        "rail_inclination": section.inclination,
        "nominal_gauge_mm": 1e3 * section.nominal_gauge,
        "length_m": length,
    }
    if section.tonnage is not None:
        entry["tonnage_mgt_per_year"] = section.tonnage
    if section.surveyed or section.gauge_surveyed:
        known: dict[str, JsonValue] = {"file": track_file}
        alignment_std, gauge_std = section.survey.stated_alignment_std, section.survey.stated_gauge_std
        if section.surveyed:
            known["alignment_std_mm"] = 1e3 * (section.survey_alignment_std if alignment_std is None else alignment_std)
        known["gauge_deviation_std_mm"] = 1e3 * (section.survey_gauge_std if gauge_std is None else gauge_std)
        entry["alignment"] = known
    return entry


def _measured_profiles(folder: Path, scenario: Scenario, count: int) -> list[JsonValue]:
    wheelsets = sorted((item for plan in scenario.vehicles for item in plan.wheelsets), key=lambda item: item.serial)
    entries: list[JsonValue] = []
    for plan in wheelsets[:count]:
        wear = wear_at(plan, scenario.odometer(0))
        entry: dict[str, JsonValue] = {
            "wheelset": plan.serial,
            "at": utc_text(scenario.sessions.start_ns),
            "mileage_km": 1e-3 * wear.mileage,
        }
        for side, profile in zip(("left", "right"), worn_profiles(plan, wear), strict=True):
            name = f"{plan.serial.lower()}_{side}.txt"
            np.savetxt(folder / name, 1e3 * np.column_stack([profile.y, profile.z]), fmt="%.6f")
            entry[side] = {"file": name}
        entries.append(entry)
    return entries


def _vehicle(scenario: Scenario, plan: VehiclePlan) -> JsonValue:
    on_file = scenario.class_on_file
    code, offsets = plan.vehicle_class, plan.axle_offsets
    if on_file is not None:
        code, offsets = on_file.vehicle_class.code, on_file.axle_offsets(offsets)
    return {
        "code": plan.code,
        "fleet": scenario.fleet_code,
        "vehicle_class": code,
        "axles": len(plan.wheelsets),
        "max_speed_km_h": round(3.6 * plan.max_speed, 6),
        "axle_offsets_m": list(offsets),
    }


def _wheelset(scenario: Scenario, plan: WheelsetPlan) -> JsonValue:
    on_file = scenario.class_on_file
    radius = None if on_file is None else on_file.nominal_radius
    return {
        "serial": plan.serial,
        "fleet": scenario.fleet_code,
        "wheel_profile": plan.wheel_profile,
        "nominal_radius_mm": round(1e3 * (plan.nominal_radius if radius is None else radius), 6),
    }


def _mounting(scenario: Scenario, vehicle: VehiclePlan, axle: int) -> Mounting:
    plan, odometer = vehicle.wheelsets[axle], scenario.sessions.first_odometer
    km = 1e-3 * odometer, 1e-3 * (plan.initial_mileage + odometer)
    return Mounting(plan.serial, vehicle.code, axle + 1, scenario.sessions.start_ns, None, *km)


def _reprofiling(scenario: Scenario, plan: WheelsetPlan, odometer: float) -> Reprofiling:
    mileage_km = 1e-3 * (plan.initial_mileage + odometer)
    return Reprofiling(plan.serial, scenario.at_odometer_ns(odometer), mileage_km, "turned to the design profile")


def _campaign(scenario: Scenario, vehicle: VehiclePlan, plan: WheelsetPlan, item: WheelsetTruth) -> JsonValue:
    geometry, wear = item.geometry, item.wear
    curves: dict[str, JsonValue] = {
        "lateral_displacement_mm": _millimetres(geometry.lateral_displacement[::_CURVE_STRIDE]),
        "rolling_radius_sum_mm": _millimetres(geometry.rolling_radius_sum[::_CURVE_STRIDE]),
        "rolling_radius_difference_mm": _millimetres(geometry.rolling_radius_difference[::_CURVE_STRIDE]),
        "contact_angle_sum_rad": _numbers(geometry.contact_angle_sum[::_CURVE_STRIDE], 7),
        "contact_angle_difference_rad": _numbers(geometry.contact_angle_difference[::_CURVE_STRIDE], 7),
    }
    facts: dict[str, JsonValue] = {
        "campaign": item.campaign,
        "start": utc_text(scenario.start_ns(vehicle, item.campaign - 1)),
        "odometer_km": 1e-3 * scenario.odometer(item.campaign - 1),
        "mileage_km": 1e-3 * wear.mileage,
        "reprofilings": wear.reprofilings,
        "sensor_failed": failed(plan, item.campaign - 1),
        "wear_left_mm": 1e3 * wear.depth_left,
        "wear_right_mm": 1e3 * wear.depth_right,
        "amplitude_mm": _millimetres(geometry.amplitude),
        "equivalent_conicity": _numbers(geometry.equivalent_conicity, 6),
        "nonlinearity_parameter": _numbers(np.array([geometry.nonlinearity]), 6)[0],
        "zero_crossing_mm": _millimetres(np.array([geometry.zero_crossing]))[0],
    }
    return facts | curves


def _millimetres(values: FloatArray) -> list[JsonValue]:
    return _numbers(1e3 * values, 6)


def _numbers(values: FloatArray, decimals: int) -> list[JsonValue]:
    return [round(float(value), decimals) if np.isfinite(value) else None for value in values]
