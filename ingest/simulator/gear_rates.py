"""Motion of a running gear: one or two wheelsets, the frame above them and what that carries, compiled.

The wheelsets obey Eq. 1 and 2 of ``estimation.vehicle.regressors``, written for each wheel; with i = 1 at
x_i = +a and i = 2 at -a (a half the wheelbase), frame (y_f, psi_f), body y_b and the curved path of ``gear_path``

    F_i = ky (y_f + x_i psi_f - y_i - o_i) + fy (their rates)             on wheelset i instead of Fsy
    M_i = -k_psi (psi_i + t_i - psi_f) - f_psi (their rates)              on wheelset i instead of Mpsi
    m_f y_f''   = -sum F_i + G,   G = ks (y_b - y_f) + cs (y_b' - y_f')   m_b y_b'' = -G
    I_f psi_f'' = -sum (x_i F_i + M_i) - k2 psi_f - c2 psi_f'

One wheelset has a mass above it that does not yaw, and no body. Where the wheels roll freely (not with the linear law
alone, whose angular velocity is V/r0), u = r0 omega - V is a state of every wheelset:

    Iwy u'/r0 = -sum r Fx + r0 T - Iwy V'/r0 + (torque that turns the wheelset with the speed) = -sum r Fx + r0 T

with T the traction force of the axle. A track that rolls by p (cross level) carries the wheelset along: the axle,
r0 above the rails, is displaced by -r0 p, its roll is that of the contact plus p, and the rails bear W vertically. What
is above rolls with the mean of p at its axles, and its weight W - m g bears on each axle along its own normal:
(W - m g) p on the wheelset, and as much the other way on the frame. A p that is the same everywhere is a cant of -p.

Arrays as in ``rates``, of both axles where they are of one there; ``coefficients`` (m, 20) has cross level, friction
and load as well where the track has them, ``place`` (6,) their values and slopes; ``state`` (16,): y, y', psi, psi', u
of each wheelset, y, y', psi, psi' of the frame, y, y' of the body; ``path`` (16,) as ``gear_path`` returns it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimation.values.arrays import FloatArray, IntArray
from estimation.values.units import GRAVITY
from ingest.simulator.rates import OUTPUTS, STANDSTILL, Constants, Grid, look_up, runge_kutta, stepped, track_at
from ingest.simulator.running import CreepConstants, share_of_linear

AXLE_STATES = 5  # y, y', psi, psi', u of each wheelset
FRAME, BODY = 10, 14  # first state of the frame (y, y', psi, psi') and of the body (y, y')
GEAR_STATES = 16
AXLE_PATH = 7  # of each wheelset, see ``gear_path``
FRAME_PATH = 2 * AXLE_PATH
PATH = FRAME_PATH + 2
PLACES = 6  # of the irregularities beside alignment and gauge: cross level, friction, load, each with its slope
CONTACT = 8


class GearConstants(NamedTuple):
    """The parameters of a running gear by their symbols, as the compiled code takes them."""

    each: tuple[Constants, Constants]  # of both axles
    axles: int  # 1 or 2
    half_base: float  # a, m
    frame_mass: float
    per_frame_inertia: float  # 1/I_f, 0 where the frame does not yaw
    per_body_mass: float  # 1/m_b, 0 without a body
    ks: float
    cs: float
    k2: float
    c2: float
    traction: tuple[float, float]  # traction force of each axle over the acceleration, kg
    braking: tuple[float, float]


class Wheels(NamedTuple):
    """Out-of-roundness of the wheels of two axles: left and right wheel of the first, then of the second.

    Their radii vary once per revolution.
    """

    amplitude: tuple[float, float, float, float]  # m
    phase: tuple[float, float, float, float]  # rad, where the run begins to count distance


ROUND = Wheels((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))


class GearOnTrack(NamedTuple):
    """What the rates of a running gear follow from, beside its state; tables and grids of both axles."""

    g: GearConstants
    creep: CreepConstants
    wheels: Wheels
    tables: tuple[FloatArray, FloatArray]
    grids: tuple[Grid, Grid]
    coefficients: FloatArray


class GearWorkspace(NamedTuple):
    """What is known of a gear at the state whose rates were written last; ``contact`` with cross level."""

    contact: FloatArray  # (2, 8)
    track: FloatArray  # (2, 4), alignment at the height of the axle
    place: FloatArray  # (6,), of the axle that was last


@stepped
def place_at(coefficients: FloatArray, grid: Grid, s: float, out: FloatArray) -> None:
    """Write cross level (rad), friction and load (both over their mean), each with its slope, into ``out`` (6,)."""
    if coefficients.shape[1] == CONTACT:
        out[0] = out[1] = out[3] = out[5] = 0.0
        out[2] = out[4] = 1.0
        return
    i = min(max(int((s - grid.s0) / grid.interval), 0), len(coefficients) - 1)
    h = s - grid.s0 - i * grid.interval
    c = coefficients[i]
    for k in range(3):
        at = 8 + 4 * k
        out[2 * k] = ((c[at] * h + c[at + 1]) * h + c[at + 2]) * h + c[at + 3]
        out[2 * k + 1] = (3.0 * c[at] * h + 2.0 * c[at + 1]) * h + c[at + 2]


@stepped
def roll_above(gear: GearOnTrack, s: float, place: FloatArray) -> float:
    """Return the mean roll of the track at the axles, rad; ``s`` is the distance of the first one."""
    total, g = 0.0, gear.g
    if gear.coefficients.shape[1] > CONTACT:
        for axle in range(g.axles):
            place_at(gear.coefficients, gear.grids[axle], s - 2.0 * g.half_base * axle, place)
            total += place[0]
    return total / g.axles


@stepped
def out_of_round(c: Constants, wheels: Wheels, axle: int, s: float, speed: float, contact: FloatArray) -> None:
    """Add what wheels that are not round change to rolling radii, roll and roll rate in ``contact`` (8,)."""
    left, right = wheels.amplitude[2 * axle], wheels.amplitude[2 * axle + 1]
    if left == 0.0 and right == 0.0:
        return
    angle = s / c.r0
    at_left, at_right = angle + wheels.phase[2 * axle], angle + wheels.phase[2 * axle + 1]
    more_left, more_right = left * math.sin(at_left), right * math.sin(at_right)
    contact[0] += more_left
    contact[1] += more_right
    contact[4] += (more_left - more_right) / (2.0 * c.half)
    contact[7] += speed / c.r0 * (left * math.cos(at_left) - right * math.cos(at_right)) / (2.0 * c.half)


@stepped
def gear_rates(
    gear: GearOnTrack,
    known: GearWorkspace,
    speed: float,
    slope: float,
    s: float,
    path: FloatArray,
    state: FloatArray,
    rates: FloatArray,
) -> int:
    """Write the time derivative of ``state`` into ``rates``; return a bit for each axle outside its table.

    Speed rises by ``slope``; ``s`` is the distance of the first axle.
    """
    outside, g, place = 0, gear.g, known.place
    leaning = roll_above(gear, s, place)
    force = moment = yaw = 0.0
    for axle in range(g.axles):
        at, c = s - 2.0 * g.half_base * axle, g.each[axle]
        first = AXLE_STATES * axle
        here, under = known.contact[axle], known.track[axle]
        track_at(gear.coefficients, gear.grids[axle], at, under)
        place_at(gear.coefficients, gear.grids[axle], at, place)
        under[0] -= c.r0 * place[0]
        under[1] -= c.r0 * place[1]
        if not look_up(gear.tables[axle], gear.grids[axle], state[first] - under[0], under[2], here):
            outside += 1 << axle
        here[4] += place[0]
        x = g.half_base * (1 - 2 * axle)
        suspension, turned = suspended(c, x, path[AXLE_PATH * axle :], state[first : first + 4], state)
        suspension += (c.load - c.mass * GRAVITY) * leaning
        force += suspension
        moment += x * suspension
        yaw += turned
        if speed < STANDSTILL:
            here[7] = 0.0
            rates[first : first + AXLE_STATES] = 0.0
            continue
        here[7] = here[5] * (state[first + 1] - speed * under[1]) + here[6] * speed * under[3] + speed * place[1]
        out_of_round(c, gear.wheels, axle, at, speed, here)
        mass = g.traction[axle] if slope > 0.0 else g.braking[axle]
        wheelset(
            c, gear.creep, speed, mass * slope, path[AXLE_PATH * axle :], place, here, suspension, turned,
            state[first : first + AXLE_STATES], rates[first : first + AXLE_STATES],
        )  # fmt: skip
    carried(g, path, force, moment + yaw, state, rates)
    return outside


@stepped
def suspended(c: Constants, x: float, path: FloatArray, axle: FloatArray, state: FloatArray) -> tuple[float, float]:
    """Return force (N) and yaw moment (N m) of the suspension on a wheelset ``x`` m ahead of the frame's middle."""
    deflection = state[FRAME] + x * state[FRAME + 2] - axle[0] - path[3]
    rate = state[FRAME + 1] + x * state[FRAME + 3] - axle[1] - path[4]
    turned, turning = axle[2] + path[5] - state[FRAME + 2], axle[3] + path[6] - state[FRAME + 3]
    return c.ky * deflection + c.fy * rate, -c.k_psi * turned - c.f_psi * turning


@stepped
def wheelset(
    c: Constants,
    creep: CreepConstants,
    speed: float,
    traction: float,
    path: FloatArray,
    place: FloatArray,
    contact: FloatArray,
    suspension: float,
    turned: float,
    state: FloatArray,
    rates: FloatArray,
) -> None:
    """Write the time derivative of one wheelset (5,) into ``rates`` (5,).

    Traction is negative in braking; ``suspension`` and ``turned`` are force and moment of the suspension, N and N m.
    """
    per_speed = 1.0 / speed
    v, psi, psi_rate, roll, roll_rate = state[1], state[2], state[3], contact[4], contact[7]
    rolling = (1.0 + state[4] * per_speed) / c.r0
    turn = (psi_rate + speed * path[2]) * per_speed
    load = c.load * place[4]
    creep_share, bound = place[4] ** (2.0 / 3.0), creep.friction * place[2] * 0.5 * load
    f11, f22, f23, f33 = creep_share * c.f11, creep_share * c.f22, place[4] * c.f23, creep_share**2 * c.f33
    longitudinal = lateral = moment = braking = 0.0
    for side in range(2):
        out = 1.0 if side == 0 else -1.0
        radius, angle = contact[side], contact[2 + side]
        along = 1.0 - radius * rolling - out * c.half * turn
        across = (v + radius * roll_rate) * per_speed - psi
        spin = turn - out * angle / c.r0
        fx, fy = -f11 * along, -f22 * across - f23 * spin
        share = 1.0
        if creep.law != 0:
            slip = speed * math.sqrt(along * along + across * across)
            share = share_of_linear(creep, math.sqrt(fx * fx + fy * fy), bound, slip)
        longitudinal += share * fx
        lateral += share * fy
        moment += share * (f23 * across - f33 * spin - out * c.half * fx)
        braking += share * radius * fx
    A, D = contact[2] + contact[3], contact[2] - contact[3]
    force = lateral + longitudinal * psi - load * (0.5 * D + roll) + suspension
    moment += 0.5 * c.half * load * A * psi - (c.pitch_inertia * speed / c.r0) * roll_rate + turned
    rates[0], rates[1] = v, force / c.mass + path[0]
    rates[2], rates[3] = psi_rate, moment / c.inertia + path[1]
    rates[4] = (c.r0 * traction - braking) * c.r0 / c.pitch_inertia if creep.free_rolling else 0.0


@stepped
def carried(
    g: GearConstants, path: FloatArray, force: float, moment: float, state: FloatArray, rates: FloatArray
) -> None:
    """Write the time derivative of frame and body into ``rates`` (16,).

    Force and moment are those of the primary suspensions on the wheelsets, about the frame's middle.
    """
    y, v, psi, psi_rate = state[FRAME], state[FRAME + 1], state[FRAME + 2], state[FRAME + 3]
    above = 0.0
    if g.per_body_mass > 0.0:
        above = g.ks * (state[BODY] - y) + g.cs * (state[BODY + 1] - v)
        rates[BODY], rates[BODY + 1] = state[BODY + 1], path[FRAME_PATH] - above * g.per_body_mass
    rates[FRAME], rates[FRAME + 1] = v, path[FRAME_PATH] + (above - force) / g.frame_mass
    if g.per_frame_inertia > 0.0:
        rates[FRAME + 2] = psi_rate
        rates[FRAME + 3] = path[FRAME_PATH + 1] - (moment + g.k2 * psi + g.c2 * psi_rate) * g.per_frame_inertia


GEAR_OUTPUTS = (*OUTPUTS, "frame_yaw")
TRACK = 4


@stepped
def integrate_gear(
    gear: GearOnTrack,
    speed: FloatArray,
    distance: FloatArray,
    path: FloatArray,
    step: float,
    parts: IntArray,
    state: FloatArray,
    out: FloatArray,
    outside: IntArray,
) -> None:
    """Integrate the motion of a running gear over a course by Runge-Kutta of 4th order.

    Args:
        distance: (k,) of the first axle.
        path: (k, 16) of the curved path; (1, 16) zeros on straight track.
        parts: (k - 1,) sub-steps of each step.
        state: At the first sample; changed to that at the last.
        out: (2, 18, k) written, in the order of ``GEAR_OUTPUTS``, for each axle.
        outside: (2,) written: how many samples left the contact table of each axle.
    """
    known = GearWorkspace(np.zeros((2, CONTACT)), np.zeros((2, TRACK)), np.zeros(PLACES))
    stages, forced, rise = np.zeros((5, GEAR_STATES)), np.zeros(PATH), np.zeros(PATH)
    outside[:] = 0
    for i in range(len(speed)):
        if speed[i] < STANDSTILL:
            for first in (0, AXLE_STATES):  # the wheels stick
                state[first + 1] = state[first + 3] = state[first + 4] = 0.0
        forced[:] = path[min(i, len(path) - 1)]
        last = i == len(speed) - 1
        slope = 0.0 if last else (speed[i + 1] - speed[i]) / step
        left = gear_rates(gear, known, speed[i], slope, distance[i], forced, state, stages[0])
        for axle in range(gear.g.axles):
            outside[axle] += left >> axle & 1
            write_axle(gear.g, axle, state, stages[0], known, out[axle], i)
        if last:
            break
        h = step / parts[i]
        if len(path) > 1:
            rise[:] = 0.5 * h / step * (path[i + 1] - path[i])
        for part in range(parts[i]):
            t = part * h
            v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
            if part > 0:
                gear_rates(gear, known, v, slope, s, forced, state, stages[0])
            runge_kutta(gear_rates, gear, known, v, slope, s, h, forced, rise, state, stages)


@stepped
def write_axle(
    g: GearConstants, axle: int, state: FloatArray, rates: FloatArray, known: GearWorkspace, out: FloatArray, i: int
) -> None:
    """Write sample ``i`` of every output of one axle into ``out`` (18, k), in the order of ``GEAR_OUTPUTS``."""
    contact, track = known.contact, known.track
    first, x = AXLE_STATES * axle, g.half_base if axle == 0 else -g.half_base
    for k in range(4):
        out[k, i] = state[first + k]
    out[4, i], out[5, i] = state[FRAME] + x * state[FRAME + 2], state[FRAME + 1] + x * state[FRAME + 3]
    out[6, i], out[7, i] = rates[first + 1], rates[first + 3]
    out[8, i] = rates[FRAME + 1] + x * rates[FRAME + 3]
    out[9, i], out[10, i], out[11, i], out[12, i] = contact[axle, 4], contact[axle, 7], track[axle, 0], track[axle, 2]
    for k in range(4):
        out[13 + k, i] = contact[axle, k]
    out[17, i] = state[FRAME + 2]
