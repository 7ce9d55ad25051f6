"""Newton's equations of a running gear as linear equations of states, the forces at the contacts their inputs.

Of each wheelset: what the rails do to it laterally, F (N), and the moment that they do about the vertical, M (N m).
With (x_i) the place of an axle ahead of the middle of its bogie's frame (y_f, psi_f), and y_b the body::

    m y_i''     = F_i + ky (y_f + x_i psi_f - y_i) + fy (their rates)
    I psi_i''   = M_i - k_psi (psi_i - psi_f) - f_psi (their rates)
    m_f y_f''   = -(sum of the suspensions' forces) + ks (y_b - y_f) + cs (y_b' - y_f'),     m_b y_b'' = the opposite
    I_f psi_f'' = -(sum of the suspensions' moments and of x_i times their forces) - k2 psi_f - c2 psi_f'

Without a bogie the mass above a single wheelset hangs on its springs alone and does not yaw (Eq. 3-5 of
``estimation.vehicle.equations_of_motion``). No speed, no creep law and no contact geometry is in these equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray, frozen_array
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import BogieParameters

AXLE = 4  # states of a wheelset: y, y', psi, psi'
SENSORS = 2  # of a wheelset itself: lateral and yaw acceleration


@dataclass(frozen=True, slots=True)
class GearEquations:
    """Rates of n states of a running gear of a axles; SI.

    The first 4 a states are those of the wheelsets, then those of what is above; ``inputs`` are F and M of each axle.
    """

    rates: FloatArray  # (n, n) of the states by the states
    inputs: FloatArray  # (n, 2 a) of the states by F and M of each axle
    measured: FloatArray  # (3 a, n) accelerations that the sensors measure, by the states: 2 a of wheelsets, a above
    measured_inputs: FloatArray  # (3 a, 2 a) the same by the inputs
    anchored: tuple[int, ...]  # displacements and angles that nothing ties to the track
    angles: tuple[int, ...]  # those of them that are angles
    axles: int

    def __post_init__(self) -> None:
        n, k = len(self.rates), 2 * self.axles
        sensors = self.axles * (SENSORS + 1)
        object.__setattr__(self, "rates", frozen_array(self.rates, (n, n), name="rates"))
        object.__setattr__(self, "inputs", frozen_array(self.inputs, (n, k), name="inputs"))
        object.__setattr__(self, "measured", frozen_array(self.measured, (sensors, n), name="measured"))
        by_inputs = frozen_array(self.measured_inputs, (sensors, k), name="measured_inputs")
        object.__setattr__(self, "measured_inputs", by_inputs)


def gear_equations(parameters: VehicleParameters, bogie: BogieParameters | None) -> GearEquations:
    """Return the equations of one running gear of a class.

    Args:
        bogie: What two wheelsets share; None where a mass is above each.
    """
    places = (0.0,) if bogie is None else (0.5 * bogie.wheelbase, -0.5 * bogie.wheelbase)
    axles = len(places)
    above = AXLE * axles  # first state of the mass, or of frame (y, y', psi, psi') and body (y, y')
    n = above + (2 if bogie is None else 6)
    rates, inputs = np.zeros((n, n)), np.zeros((n, 2 * axles))
    for first in range(0, n, 2):
        rates[first, first + 1] = 1.0
    force, moment = np.zeros(n), np.zeros(n)
    for axle, place in enumerate(places):
        first = AXLE * axle
        lateral, yaw = _suspension(parameters, n, axle, None if bogie is None else place)
        per_mass, per_inertia = 1.0 / parameters.wheelset_mass, 1.0 / parameters.yaw_inertia
        rates[first + 1], rates[first + 3] = per_mass * lateral, per_inertia * yaw
        inputs[first + 1, 2 * axle], inputs[first + 3, 2 * axle + 1] = per_mass, per_inertia
        force += lateral
        moment += place * lateral + yaw
    if bogie is None:
        rates[above + 1] = -force / parameters.suspended_mass
    else:
        _carried(bogie, rates, force, moment, above)
    wheelsets = [AXLE * axle + row for axle in range(axles) for row in (1, 3)]
    nodes = [rates[above + 1] + (0.0 if bogie is None else place * rates[above + 3]) for place in places]
    sensors_above = np.zeros((axles, 2 * axles))
    return GearEquations(
        rates,
        inputs,
        np.concatenate([rates[wheelsets], np.stack(nodes)]),
        np.concatenate([inputs[wheelsets], sensors_above]),
        tuple(range(0, n, 2)),
        tuple([AXLE * axle + 2 for axle in range(axles)] + ([] if bogie is None else [above + 2])),
        axles,
    )


def _suspension(p: VehicleParameters, n: int, axle: int, place: float | None) -> tuple[FloatArray, FloatArray]:
    """Return force, N, and moment, N m, of the primary suspension on a wheelset, each (n,) by the states.

    ``place`` is None where what is above does not yaw.
    """
    first, above = AXLE * axle, n - (2 if place is None else 6)
    lateral, yaw = np.zeros(n), np.zeros(n)
    lateral[[above, first]] = p.lateral_stiffness, -p.lateral_stiffness
    lateral[[above + 1, first + 1]] = p.lateral_damping, -p.lateral_damping
    yaw[[first + 2, first + 3]] = -p.yaw_stiffness, -p.yaw_damping
    if place is not None:
        lateral[[above + 2, above + 3]] = place * p.lateral_stiffness, place * p.lateral_damping
        yaw[[above + 2, above + 3]] = p.yaw_stiffness, p.yaw_damping
    return lateral, yaw


def _carried(bogie: BogieParameters, rates: FloatArray, force: FloatArray, moment: FloatArray, above: int) -> None:
    """Write the rates of frame and body into ``rates``."""
    body, stiffness, damping = above + 4, bogie.secondary_lateral_stiffness, bogie.secondary_lateral_damping
    secondary = np.zeros(len(rates))
    secondary[[body, above]] = stiffness, -stiffness
    secondary[[body + 1, above + 1]] = damping, -damping
    rates[above + 1] = (secondary - force) / bogie.frame_mass
    rates[body + 1] = -secondary / bogie.body_mass
    turned = np.zeros(len(rates))
    turned[[above + 2, above + 3]] = bogie.secondary_yaw_stiffness, bogie.secondary_yaw_damping
    rates[above + 3] = -(moment + turned) / bogie.frame_yaw_inertia
