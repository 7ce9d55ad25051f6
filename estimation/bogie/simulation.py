"""A bogie run over a known alignment: the linear model of its class with any two curves, and creep that saturates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.linalg import expm

from estimation.bogie.curves import Curves, look_up, nodes
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun
from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.vehicle.linear_model import COORDINATES, LinearContact, bogie_model
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters, VehicleParameters

INPUTS = len(("R", "R'", "yaw acceleration by saturation", "lateral acceleration by saturation")) * AXLES_OF_A_BOGIE
RATES = len(COORDINATES)  # place of the first rate in a state
STATES = RATES + len(COORDINATES)
FRONT_Y, FRONT_YAW, REAR_Y, REAR_YAW, FRAME_Y, FRAME_YAW = 0, 1, 2, 3, 4, 5


@dataclass(frozen=True, slots=True)
class Gear:
    """What a bogie is simulated and equated with."""

    vehicle: VehicleParameters  # on file: what the unknown parameters are relative to
    bogie: BogieParameters
    inverse_friction: float = BOGIE.inverse_friction
    moving: VehicleParameters | None = None  # what it is simulated with; None: with those on file

    @property
    def per_newton_metre(self) -> float:
        """R, m, that a moment of 1 N m stands for in the yaw equation of a wheelset: r0/(l f11)."""
        p = self.vehicle
        return p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)


@dataclass(frozen=True, slots=True)
class Simulated(FrozenArrays):
    """The simulated motion during a run; rows as in :class:`BogieRun`."""

    lateral: Annotated[FloatArray, 3, 2, "n"]
    yaw: Annotated[FloatArray, 3, 2, "n"]
    roll: Annotated[FloatArray, 2, 2, "n"]
    frame_lateral: Annotated[FloatArray, 2, "n"]
    frame_yaw: Annotated[FloatArray, 3, "n"]
    relative: Annotated[FloatArray, 2, "n"]  # y - d as EN 15302 means it, m


@lru_cache(maxsize=4096)
def _stepping(vehicle: VehicleParameters, bogie: BogieParameters, speed: float, dt: float) -> tuple[FloatArray, ...]:
    """Return transition (14, 14) and input (14, 8) of a step; inputs are R, R', yaw and lateral acceleration of both.

    Contact angles and roll are in proportion to R.
    """
    span = BOGIE.start_conicity
    without = bogie_model(vehicle, bogie, speed, LinearContact(conicity=BOGIE.flat_conicity)).matrix
    with_curve = bogie_model(vehicle, bogie, speed, LinearContact(conicity=BOGIE.flat_conicity + span)).matrix
    per_conicity = (with_curve - without) / span
    drive = np.zeros((STATES, INPUTS))
    for axle in range(2):
        drive[:, axle] = per_conicity[:, 2 * axle] / 2.0
        drive[:, 2 + axle] = per_conicity[:, RATES + 2 * axle] / 2.0
        drive[RATES + 2 * axle + 1, 4 + axle] = 1.0
        drive[RATES + 2 * axle, 6 + axle] = 1.0
    whole = np.zeros((STATES + INPUTS, STATES + INPUTS))
    whole[:STATES, :STATES], whole[:STATES, STATES:] = without - BOGIE.flat_conicity * per_conicity, drive
    step = expm(dt * whole)
    return step[:STATES, :STATES], step[:STATES, STATES:]


def spin_force(p: VehicleParameters) -> float:
    """Return the lateral creep force of a wheel by its contact angle, N: one against that of the other wheel."""
    return p.lateral_spin_creep_coefficient * 0.5 * VEHICLE.angle_sum / p.nominal_radius


@compiled(nogil=True)
def share_of_linear(linear: float) -> float:
    """Return the share of linear creep that is left, of a linear force over the bound (Vermeulen and Johnson)."""
    if linear < 3.0:  # noqa: PLR2004 - full slip
        return 1.0 - linear / 3.0 + linear * linear / 27.0
    return 1.0 / linear


@compiled(nogil=True)
def saturate(
    creep: FloatArray, v: float, value: float, rate: float, psi: float, dy: float, dpsi: float, drive: FloatArray,
    axle: int,
) -> None:  # fmt: skip
    """Write what saturation takes from the yaw and lateral acceleration of an axle."""
    f11, f22, f23, half, r0, inertia, mass, bound, _, spin = creep
    slip = dy + r0 * rate / (2.0 * half) - v * psi
    lateral = -2.0 * f22 * slip / v - 2.0 * f23 * dpsi / v
    moment = -half * f11 * value / r0 - 2.0 * half * half * f11 * dpsi / v + 2.0 * f23 * slip / v
    less = share_of_linear(math.hypot(math.hypot(moment / (2.0 * half), 0.5 * lateral), spin) / bound) - 1.0
    drive[4 + axle], drive[6 + axle] = less * moment / inertia, less * lateral / mass


@compiled(nogil=True)
def advance(transition: FloatArray, entry: FloatArray, drive: FloatArray, state: FloatArray, new: FloatArray) -> None:
    """Replace the state (14,) by the next one; ``new`` (14,) is written over."""
    for k in range(STATES):
        total = 0.0
        for j in range(STATES):
            total += transition[k, j] * state[j]
        for j in range(INPUTS):
            total += entry[k, j] * drive[j]
        new[k] = total
    for k in range(STATES):
        state[k] = new[k]


@compiled(nogil=True, error_model="numpy")
def step_through(
    track: FloatArray, slope: FloatArray, speed: FloatArray, table: IntArray, transitions: FloatArray,
    inputs: FloatArray, curves: FloatArray, x0: float, per_x: float, farthest: float, most_rolled: float,
    creep: FloatArray, out: FloatArray,
) -> int:  # fmt: skip
    """Write the states (14, n), then R (2, n) and x as EN 15302 means it (2, n), over the alignment (2, n).

    Returns how many samples it came through before a wheelset left the track.
    """
    half, bound, height = creep[3], creep[7], creep[8]
    state, new = np.zeros(STATES), np.zeros(STATES)
    drive, before, ahead = np.zeros(INPUTS), np.zeros(INPUTS), np.zeros(INPUTS)
    state[0], state[2], state[4] = track[0, 0], track[1, 0], 0.5 * (track[0, 0] + track[1, 0])
    difference = np.zeros(2)
    for i in range(len(speed)):
        v = speed[i]
        for axle in range(2):
            y, psi = state[2 * axle], state[2 * axle + 1]
            dy, dpsi = state[RATES + 2 * axle], state[RATES + 2 * axle + 1]
            x = y - track[axle, i] + height * difference[axle] / (2.0 * half)
            if not abs(x) < farthest:
                return i
            value, rise = look_up(curves[axle], x0, per_x, x)
            difference[axle] = value
            rolled = min(height * rise / (2.0 * half), most_rolled)  # at a jump the contact crosses at once
            rate = rise * (dy - slope[axle, i]) / (1.0 - rolled)
            drive[axle], drive[2 + axle] = value, rate
            out[STATES + axle, i], out[STATES + 2 + axle, i] = value, x
            if bound > 0.0:
                saturate(creep, v, value, rate, psi, dy, dpsi, drive, axle)
        for k in range(STATES):
            out[k, i] = state[k]
        for k in range(INPUTS):
            ahead[k] = 1.5 * drive[k] - 0.5 * before[k] if i > 0 else drive[k]
            before[k] = drive[k]
        advance(transitions[table[i]], inputs[table[i]], ahead, state, new)
    return len(speed)


def simulate(gear: Gear, curves: Curves, run: BogieRun) -> Simulated | None:
    """Return the motion of the bogie over the alignment of a run; None where it derails."""
    p, n, dt = gear.moving or gear.vehicle, len(run), run.interval_s
    before = run.ahead.shape[1] - n
    speed = np.concatenate([np.full(before, run.speed[0]), run.speed])
    slope = np.gradient(run.ahead, dt, axis=1)
    number = np.rint(speed / BOGIE.speed_step).astype(np.int64)
    kinds, table = np.unique(number, return_inverse=True)
    steps = [_stepping(p, gear.bogie, float(kind) * BOGIE.speed_step, dt) for kind in kinds]
    transitions, inputs = (np.ascontiguousarray(np.stack(part)) for part in zip(*steps, strict=True))
    bound = 0.5 * p.axle_load / gear.inverse_friction if gear.inverse_friction > 0.0 else 0.0
    creep = np.array(
        [p.longitudinal_creep_coefficient, p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient,
         p.half_contact_distance, p.nominal_radius, p.yaw_inertia, p.wheelset_mass, bound,
         p.nominal_radius + VEHICLE.rail_head_radius, spin_force(p)]
    )  # fmt: skip
    out, x = np.empty((STATES + 4, len(speed))), nodes()
    per_x = 1.0 / BOGIE.node_step
    ahead = np.ascontiguousarray(run.ahead)
    through = step_through(ahead, slope, speed, table.astype(np.int64), transitions, inputs,
                 np.ascontiguousarray(curves.values), float(x[0]), per_x, BOGIE.farthest,
                 BOGIE.most_rolled, creep, out)  # fmt: skip
    return _simulated(out[:, before:], p, dt) if through == len(speed) else None


def _simulated(out: FloatArray, p: VehicleParameters, dt: float) -> Simulated:
    axles = slice(0, 4, 2), slice(1, 4, 2)
    rates = out[RATES:STATES]
    lateral, yaw = (np.stack([out[rows], rates[rows], np.gradient(rates[rows], dt, axis=1)]) for rows in axles)
    roll = out[STATES : STATES + 2] / (2.0 * p.half_contact_distance)
    frame_rate = rates[FRAME_YAW]
    return Simulated(
        lateral=lateral,
        yaw=yaw,
        roll=np.stack([roll, np.gradient(roll, dt, axis=1)]),
        frame_lateral=np.stack([out[FRAME_Y], rates[FRAME_Y]]),
        frame_yaw=np.stack([out[FRAME_YAW], frame_rate, np.gradient(frame_rate, dt)]),
        relative=out[STATES + 2 :],
    )
