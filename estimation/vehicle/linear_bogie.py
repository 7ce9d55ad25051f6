"""A bogie of two wheelsets under its share of the body, linearised: lateral and yaw motion, no roll on the springs.

With the frame's centre at yf and its yaw psif, what is above the wheelset at +-a is at yf +- a psif; that takes the
place of ym in Eq. 4, and the yaw spring of Eq. 5 turns against psif. The body moves laterally and does not yaw.
"""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import (
    VehicleParameters,
    WheelsetState,
    lateral_suspension_force,
    yaw_suspension_moment,
)
from estimation.vehicle.linear_wheelset import (
    LinearContact,
    LinearModel,
    assemble,
    klingel_frequency,
    wheelset_accelerations,
)
from estimation.vehicle.vehicle_class import BogieParameters

COORDINATES = (
    "front wheelset lateral",
    "front wheelset yaw",
    "rear wheelset lateral",
    "rear wheelset yaw",
    "frame lateral",
    "frame yaw",
    "body lateral",
)


def bogie_model(
    parameters: VehicleParameters, bogie: BogieParameters, speed: float, contact: LinearContact
) -> LinearModel:
    """Return the model of a bogie whose two wheelsets are alike.

    Args:
        speed: V, m/s, positive.
    """
    arms = bogie.wheelbase / 2, -bogie.wheelbase / 2

    def accelerations(q: FloatArray, v: FloatArray, d: FloatArray) -> FloatArray:
        result = np.empty_like(q)
        force, moment = _secondary(bogie, q, v)
        result[6] = -force / bogie.body_mass
        for number, arm in enumerate(arms):
            at = 2 * number
            state = _state(q, v, at, arm)
            lateral, yaw = wheelset_accelerations(parameters, speed, contact, state, d[number::2])
            on_wheelset = lateral_suspension_force(parameters, state)
            torsion = yaw_suspension_moment(parameters, _relative(state, q[5], v[5]))
            unyawing = yaw_suspension_moment(parameters, state)
            result[at] = lateral
            result[at + 1] = yaw + (torsion - unyawing) / parameters.yaw_inertia
            force = force - on_wheelset
            moment = moment - torsion - arm * on_wheelset
        result[4], result[5] = force / bogie.frame_mass, moment / bogie.frame_yaw_inertia
        return result

    klingel_hz = klingel_frequency(parameters, speed, contact)
    return assemble(accelerations, speed, klingel_hz, COORDINATES, (0.0, bogie.wheelbase))


def _state(q: FloatArray, v: FloatArray, at: int, arm: float) -> WheelsetState:
    """Return the state of the wheelset whose coordinates begin at ``at``, with the frame above it as its mass."""
    return WheelsetState(q[at], v[at], q[at + 1], v[at + 1], q[4] + arm * q[5], v[4] + arm * v[5])


def _relative(state: WheelsetState, yaw: FloatArray, yaw_rate: FloatArray) -> WheelsetState:
    """Return the state with its yaw against the frame's."""
    return WheelsetState(
        state.lateral_displacement,
        state.lateral_velocity,
        np.asarray(state.yaw) - yaw,
        np.asarray(state.yaw_rate) - yaw_rate,
        state.mass_lateral_displacement,
        state.mass_lateral_velocity,
    )


def _secondary(bogie: BogieParameters, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return force and moment of the secondary suspension on the frame."""
    force = bogie.secondary_lateral_stiffness * (q[6] - q[4]) + bogie.secondary_lateral_damping * (v[6] - v[4])
    moment = -bogie.secondary_yaw_stiffness * q[5] - bogie.secondary_yaw_damping * v[5]
    return force, moment
