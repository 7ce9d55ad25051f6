"""Push-pull trains: every second run of a vehicle is with its rear end first.

Such a vehicle is simulated as what it is to the track: one that runs forward with its wheelsets in the other order and
each turned half round. Its nodes keep their places and axes, which point against the direction of travel.
"""

from __future__ import annotations

from dataclasses import replace

from estimation.values.arrays import FloatArray
from ingest.simulator.scenario import Scenario, VehiclePlan, WheelsetPlan

TURNED = (-1.0, 1.0, -1.0, -1.0)
"""Lateral, yaw, roll, lateral of the mass: what a node turned half round about the vertical axis measures of each."""


def runs_rear_first(scenario: Scenario, campaign: int) -> bool:
    """Return whether vehicles run with their rear end first in a campaign (from 0)."""
    return scenario.sessions.push_pull and campaign % 2 == 1


def length_ahead(vehicle: VehiclePlan) -> float:
    """Return by how much the first axle's reference is ahead of the vehicle's own when its rear end is first, m."""
    return vehicle.axle_offsets[0] + vehicle.axle_offsets[-1]


def seen_from_ahead(scenario: Scenario, vehicle: VehiclePlan) -> tuple[Scenario, VehiclePlan]:
    """Return the scenario and the vehicle as one that runs forward when its rear end is first."""
    ahead = length_ahead(vehicle)
    turned = replace(
        vehicle,
        axle_offsets=tuple(ahead - offset for offset in reversed(vehicle.axle_offsets)),
        wheelsets=tuple(_turned(wheelset) for wheelset in reversed(vehicle.wheelsets)),
    )
    others = tuple(turned if item is vehicle else item for item in scenario.vehicles)
    return replace(scenario, vehicles=others), turned


def as_measured(values: FloatArray) -> FloatArray:
    """Return what the nodes measure (n, 4) of a motion in the axes of travel."""
    return values * TURNED


def _turned(wheelset: WheelsetPlan) -> WheelsetPlan:
    return replace(
        wheelset,
        rate_left=wheelset.rate_right,
        rate_right=wheelset.rate_left,
        initial_left=wheelset.initial_right,
        initial_right=wheelset.initial_left,
        diameter_difference=-wheelset.diameter_difference,
        wheel_files=(wheelset.wheel_files[1], wheelset.wheel_files[0]),
    )
