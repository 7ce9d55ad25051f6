"""The class of simulated vehicles as an entry of their registry: what the scenario assumes of all of them."""

from __future__ import annotations

from estimation.values.json_value import JsonValue
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.scenario import Scenario

MILLI = 1e3


def class_entry(scenario: Scenario, code: str) -> JsonValue:
    """Return the entry of a class of a scenario, whose sensors give accelerations without gravity.

    Parameters
    ----------
    scenario
        Its parameters and sensors.
    code
        Of the class.
    """
    parameters = scenario.parameters
    return {
        "code": code,
        "name": code,
        "source": f"scenario {scenario.name}",
        "arrangement": "single_wheelset",
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
            "rate_hz": 250.0,
            "measures_gravity": False,
            "lateral": _sensor("accelerometer", "axle_box", "y", "m_s2"),
            "yaw": _sensor("angular_accelerometer", "axle_box", "z", "rad_s2"),
            "roll": _sensor("angular_accelerometer", "axle_box", "x", "rad_s2"),
            "mass_lateral": _sensor("accelerometer", "mass", "y", "m_s2"),
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


def _sensor(kind: str, place: str, axis: str, unit: str) -> JsonValue:
    return {"kind": kind, "place": place, "axis": axis, f"noise_density_{unit}_rthz": 0.0}
