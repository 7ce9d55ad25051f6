"""The class of simulated vehicles as an entry of their registry: what the scenario assumes of all of them."""

from __future__ import annotations

import math

from estimation.values.json_value import JsonValue
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import BogieParameters
from ingest.simulator.scenario import Scenario
from ingest.simulator.sensors import Channel

MILLI = 1e3


def class_entry(scenario: Scenario, code: str) -> JsonValue:
    """Return the entry of a class of a scenario: with the parameters of its vehicles and the sensors of its nodes."""
    parameters, bogie, sensors = scenario.parameters, scenario.bogie, scenario.sensors
    scale_std = sensors.errors.scale
    entry: dict[str, JsonValue] = {
        "code": code,
        "name": code,
        "source": f"scenario {scenario.name}",
        "arrangement": "single_wheelset" if bogie is None else "bogie",
        "wheelset": {
            "mass_kg": parameters.wheelset_mass,
            "yaw_inertia_kg_m2": parameters.yaw_inertia,
            "pitch_inertia_kg_m2": parameters.pitch_inertia,
            "nominal_radius_mm": round(MILLI * parameters.nominal_radius, 6),
            "half_contact_distance_mm": round(MILLI * parameters.half_contact_distance, 6),
            "suspended_mass_kg": parameters.suspended_mass,
            "axle_load_n": parameters.load,
        },
        "primary_suspension": {
            "lateral_stiffness_n_m": parameters.lateral_stiffness,
            "lateral_damping_n_s_m": parameters.lateral_damping,
            "yaw_stiffness_n_m_rad": parameters.yaw_stiffness,
            "yaw_damping_n_m_s_rad": parameters.yaw_damping,
        },
        "creep": _creep(parameters),
        "sensors": {
            "rate_hz": float(sensors.rate_hz),
            "measures_gravity": sensors.measures_gravity,
            "lateral": _sensor(sensors.lateral, scale_std, "axle_box", "y"),
            "yaw": _sensor(sensors.yaw, scale_std, "axle_box", "z"),
            "roll": _sensor(sensors.roll, scale_std, "axle_box", "x"),
            "mass_lateral": _sensor(sensors.mass_lateral, scale_std, "mass" if bogie is None else "frame", "y"),
        },
    }
    return entry if bogie is None else entry | _bogie(bogie)


def _bogie(bogie: BogieParameters) -> dict[str, JsonValue]:
    return {
        "bogie": {
            "wheelbase_m": bogie.wheelbase,
            "frame_mass_kg": bogie.frame_mass,
            "frame_yaw_inertia_kg_m2": bogie.frame_yaw_inertia,
            "body_mass_kg": bogie.body_mass,
        },
        "secondary_suspension": {
            "lateral_stiffness_n_m": bogie.secondary_lateral_stiffness,
            "lateral_damping_n_s_m": bogie.secondary_lateral_damping,
            "yaw_stiffness_n_m_rad": bogie.secondary_yaw_stiffness,
            "yaw_damping_n_m_s_rad": bogie.secondary_yaw_damping,
        },
    }


def _creep(parameters: VehicleParameters) -> JsonValue:
    return {
        "from": "given",
        "longitudinal_n": parameters.longitudinal_creep_coefficient,
        "lateral_n": parameters.lateral_creep_coefficient,
        "lateral_spin_n_m": parameters.lateral_spin_creep_coefficient,
        "spin_n_m2": parameters.spin_creep_coefficient,
    }


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
