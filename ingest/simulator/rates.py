"""Motion of a running gear on its track: one or two wheelsets, the frame above them and what that carries, compiled.

The wheelsets obey Eq. 1 and 2 of ``estimation.vehicle.regressors``, written for each wheel; with i = 1 at
x_i = +a and i = 2 at -a (a half the wheelbase), frame (y_f, psi_f), body y_b and the curved path of ``gear_path``

    F_i = ky (y_f + x_i psi_f - y_i - o_i) + fy (their rates)             on wheelset i instead of Fsy
    M_i = -k_psi (psi_i + t_i - psi_f) - f_psi (their rates)              on wheelset i instead of Mpsi
    m_f y_f''   = -sum F_i + G,   G = ks (y_b - y_f) + cs (y_b' - y_f')   m_b y_b'' = -G
    I_f psi_f'' = -sum (x_i F_i + M_i) - k2 psi_f - c2 psi_f'

One wheelset has a mass above it that does not yaw, and no body: y_f is ym of Eq. 5. Where the wheels roll freely (not
with the linear law alone, whose angular velocity is V/r0), u = r0 omega - V is a state of every wheelset:

    Iwy u'/r0 = -sum r Fx + r0 T - Iwy V'/r0 + (torque that turns the wheelset with the speed) = -sum r Fx + r0 T

with T the traction force of the axle. A track that rolls by p (cross level) carries the wheelset along: the axle,
r0 above the rails, is displaced by -r0 p, its roll is that of the contact plus p, and the rails bear W vertically. What
is above rolls with the mean of p at its axles, and its weight W - m g bears on each axle along its own normal:
(W - m g) p on the wheelset, and as much the other way on the frame. A p that is the same everywhere is a cant of -p.

The contact geometry is looked up bilinearly in (y - d, gauge deviation); the slopes of the roll angle are tabulated
at the same nodes, so that roll rate is the chain rule phi' = phi_x (y' - d') + phi_e e', and roll acceleration is its
time derivative.

Arrays, in SI: ``table`` (n, g, 7), at its nodes rL, rR, dL, dR, phi, phi_x, phi_e; ``coefficients`` (m, 8), cubic
splines of alignment and gauge deviation, (m, 20) with those of cross level, friction and load where the track has them;
``state`` and ``rates``: y, y', psi, psi', u of each wheelset, then y, y' of what is above and, in a bogie, psi, psi' of
the frame and y, y' of the body; ``path`` as ``gear_path`` returns it; ``seen`` (a, 8) of each axle what is known beside
its state: ``SEEN``. ``s`` is the distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, IntArray
from ingest.simulator.running import CreepConstants, share_of_linear

STANDSTILL = 0.05  # m/s: below it the wheels stick, and only what is above moves
AXLE_STATES = 5  # y, y', psi, psi', u of each wheelset
FRAME_PATH = 2
AXLE_PATH = 7  # of each wheelset, see ``gear_path``
WITHOUT_SURFACE = 8  # columns of the coefficients of a track that is level, and alike everywhere
SEEN = (
    "rolling_radius_left",
    "rolling_radius_right",
    "contact_angle_left",
    "contact_angle_right",
    "roll",
    "roll_rate",
    "alignment",
    "gauge_deviation",
)

stepped = compiled(nogil=True, error_model="numpy")


class Grid(NamedTuple):
    """Uniform grids: first node and reciprocal spacing of y - d, of gauge deviation, and of distance."""

    x0: float
    per_x: float
    e0: float
    per_e: float
    s0: float
    interval: float


class AxleConstants(NamedTuple):
    """The parameters of a wheelset by their symbols, as the compiled code takes them."""

    f11: float
    f22: float
    f23: float
    f33: float
    ky: float
    fy: float
    k_psi: float
    f_psi: float
    mass: float
    inertia: float
    pitch_inertia: float
    half: float
    load: float
    weight_above: float  # W - m g
    r0: float
    x: float  # m, ahead of the frame's middle
    traction: float  # traction force over the acceleration, kg
    braking: float
    out_of_round: tuple[float, float]  # m, of the left and the right wheel, whose radii vary once per revolution
    phase: tuple[float, float]  # rad, where the run begins to count distance


class GearConstants(NamedTuple):
    """The parameters of a running gear by their symbols, as the compiled code takes them."""

    axles: tuple[AxleConstants, AxleConstants]  # the second is not used where there is one
    count: int  # of axles, 1 or 2
    frame_mass: float
    frame_inertia: float
    body_mass: float
    ks: float
    cs: float
    k2: float
    c2: float


class GearOnTrack(NamedTuple):
    """What the rates of a running gear follow from, beside its state; tables and grids of both axles."""

    g: GearConstants
    creep: CreepConstants
    tables: tuple[FloatArray, FloatArray]
    grids: tuple[Grid, Grid]
    coefficients: FloatArray


class Contact(NamedTuple):
    """The contact geometry of a wheelset on the track."""

    radius_left: float
    radius_right: float
    angle_left: float
    angle_right: float
    roll: float
    roll_rate: float


class Place(NamedTuple):
    """The track at one place, and slopes over distance; friction and load of a wheel are over their mean."""

    alignment: float
    alignment_slope: float
    gauge: float
    gauge_slope: float
    roll: float
    roll_slope: float
    friction: float
    load: float


LookedUp = tuple[float, float, float, float, float, float, float]


@stepped
def look_up(table: FloatArray, grid: Grid, x: float, e: float) -> tuple[bool, LookedUp]:
    """Interpolate ``table`` at (x, e); return whether x is inside the grid, and what is there.

    Outside, the edge cell is continued linearly in x; e is held at the edge.
    """
    n, g, _ = table.shape
    fx, fe = (x - grid.x0) * grid.per_x, min(max((e - grid.e0) * grid.per_e, 0.0), g - 1.0)
    i, j = min(max(int(fx), 0), n - 2), max(min(int(fe), g - 2), 0)
    right = min(j + 1, g - 1)
    wx, we = fx - i, fe - j
    w = ((1.0 - wx) * (1.0 - we), (1.0 - wx) * we, wx * (1.0 - we), wx * we)
    return bool(0.0 <= fx <= n - 1), (
        blend(table, i, j, right, w, 0),
        blend(table, i, j, right, w, 1),
        blend(table, i, j, right, w, 2),
        blend(table, i, j, right, w, 3),
        blend(table, i, j, right, w, 4),
        blend(table, i, j, right, w, 5),
        blend(table, i, j, right, w, 6),
    )


@stepped
def blend(table: FloatArray, i: int, j: int, right: int, w: tuple[float, float, float, float], k: int) -> float:
    """Return value ``k`` of four nodes of ``table``, weighted."""
    return w[0] * table[i, j, k] + w[1] * table[i, right, k] + w[2] * table[i + 1, j, k] + w[3] * table[i + 1, right, k]


@stepped
def place_at(coefficients: FloatArray, grid: Grid, s: float, height: float) -> Place:
    """Return the track at distance ``s``, its alignment at ``height`` above the rails."""
    i = min(max(int((s - grid.s0) / grid.interval), 0), len(coefficients) - 1)
    h = s - grid.s0 - i * grid.interval
    d, d_slope = cubic(coefficients, i, 0, h)
    e, e_slope = cubic(coefficients, i, 4, h)
    if coefficients.shape[1] == WITHOUT_SURFACE:
        return Place(d, d_slope, e, e_slope, 0.0, 0.0, 1.0, 1.0)
    roll, roll_slope = cubic(coefficients, i, 8, h)
    friction, _ = cubic(coefficients, i, 12, h)
    load, _ = cubic(coefficients, i, 16, h)
    return Place(d - height * roll, d_slope - height * roll_slope, e, e_slope, roll, roll_slope, friction, load)


@stepped
def cubic(coefficients: FloatArray, i: int, first: int, h: float) -> tuple[float, float]:
    """Return the cubic whose coefficients begin at ``first`` of row ``i``, and its slope, ``h`` m into the cell."""
    a, b, c, d = (
        coefficients[i, first],
        coefficients[i, first + 1],
        coefficients[i, first + 2],
        coefficients[i, first + 3],
    )
    return ((a * h + b) * h + c) * h + d, (3.0 * a * h + 2.0 * b) * h + c


@stepped
def mean_roll(gear: GearOnTrack, s: float) -> float:
    """Return the mean roll of the track at the axles, rad; ``s`` is the distance of the first one."""
    if gear.coefficients.shape[1] == WITHOUT_SURFACE:
        return 0.0
    g, total = gear.g, 0.0
    for axle in range(g.count):
        total += place_at(gear.coefficients, gear.grids[axle], s - g.axles[0].x + g.axles[axle].x, 0.0).roll
    return total / g.count


@stepped
def contact_at(
    c: AxleConstants, table: FloatArray, grid: Grid, place: Place, s: float, speed: float, y: float, v: float
) -> tuple[bool, Contact]:
    """Return whether a wheelset is inside its contact table, and its contact with the track at distance ``s``."""
    inside, (left, right, angle_left, angle_right, roll, roll_x, roll_e) = look_up(
        table, grid, y - place.alignment, place.gauge
    )
    roll += place.roll
    if speed < STANDSTILL:
        return inside, Contact(left, right, angle_left, angle_right, roll, 0.0)
    rate = roll_x * (v - speed * place.alignment_slope) + speed * (roll_e * place.gauge_slope + place.roll_slope)
    if c.out_of_round[0] != 0.0 or c.out_of_round[1] != 0.0:
        angle = s / c.r0
        at_left, at_right = angle + c.phase[0], angle + c.phase[1]
        more_left, more_right = c.out_of_round[0] * math.sin(at_left), c.out_of_round[1] * math.sin(at_right)
        left, right, roll = left + more_left, right + more_right, roll + (more_left - more_right) / (2.0 * c.half)
        swing = c.out_of_round[0] * math.cos(at_left) - c.out_of_round[1] * math.cos(at_right)
        rate += speed / c.r0 * swing / (2.0 * c.half)
    return inside, Contact(left, right, angle_left, angle_right, roll, rate)


@stepped
def gear_rates(
    gear: GearOnTrack,
    speed: float,
    slope: float,
    s: float,
    path: FloatArray,
    state: FloatArray,
    rates: FloatArray,
    seen: FloatArray,
) -> int:
    """Write the time derivative of ``state`` into ``rates``; return a bit for each axle outside its table.

    Speed rises by ``slope``; ``s`` is the distance of the first axle.
    """
    outside, g = 0, gear.g
    frame = AXLE_STATES * g.count
    y_f, v_f, psi_f, turn_f = state[frame], state[frame + 1], 0.0, 0.0
    if g.count > 1:
        psi_f, turn_f = state[frame + 2], state[frame + 3]
    leaning = mean_roll(gear, s)
    force = moment = 0.0
    for axle in range(g.count):
        c, first, bend = g.axles[axle], AXLE_STATES * axle, FRAME_PATH + AXLE_PATH * axle
        at = s - g.axles[0].x + c.x
        y, v, psi, turn = state[first], state[first + 1], state[first + 2], state[first + 3]
        place = place_at(gear.coefficients, gear.grids[axle], at, c.r0)
        inside, contact = contact_at(c, gear.tables[axle], gear.grids[axle], place, at, speed, y, v)
        outside += 0 if inside else 1 << axle
        deflection = y_f + c.x * psi_f - y - path[bend + 3]
        deflection_rate = v_f + c.x * turn_f - v - path[bend + 4]
        suspension = c.ky * deflection + c.fy * deflection_rate + c.weight_above * leaning
        turned = -c.k_psi * (psi + path[bend + 5] - psi_f) - c.f_psi * (turn + path[bend + 6] - turn_f)
        force += suspension
        moment += c.x * suspension + turned
        for k in range(len(contact)):
            seen[axle, k] = contact[k]
        seen[axle, 6], seen[axle, 7] = place.alignment, place.gauge
        for k in range(AXLE_STATES):
            rates[first + k] = 0.0
        if speed < STANDSTILL:
            continue
        lateral, yaw, braking = creep_forces(
            c, gear.creep, place, contact, speed, v, psi, turn, state[first + 4], path[bend + 2]
        )
        rates[first], rates[first + 1] = v, (lateral + suspension) / c.mass + path[bend]
        rates[first + 2], rates[first + 3] = turn, (yaw + turned) / c.inertia + path[bend + 1]
        if gear.creep.free_rolling:
            traction = slope * (c.traction if slope > 0.0 else c.braking)
            rates[first + 4] = (c.r0 * traction - braking) * c.r0 / c.pitch_inertia
    carried(g, path, force, moment, state, rates)
    return outside


@stepped
def creep_forces(
    c: AxleConstants,
    creep: CreepConstants,
    place: Place,
    contact: Contact,
    speed: float,
    v: float,
    psi: float,
    turn: float,
    u: float,
    curvature: float,
) -> tuple[float, float, float]:
    """Return what the rails do to a wheelset: lateral force, yaw moment and the moment that brakes its rolling."""
    per_speed, per_r0 = 1.0 / speed, 1.0 / c.r0
    rolling = (1.0 + u * per_speed) * per_r0
    turning = turn * per_speed + curvature
    load = c.load * place.load
    f11, f22, f23, f33 = c.f11, c.f22, c.f23 * place.load, c.f33
    if place.load != 1.0:
        share = place.load ** (2.0 / 3.0)
        f11, f22, f33 = share * f11, share * f22, share * share * f33
    bound = creep.friction * place.friction * 0.5 * load
    longitudinal = lateral = moment = braking = 0.0
    for side in range(2):
        out = 1.0 - 2.0 * side
        radius = contact.radius_left if side == 0 else contact.radius_right
        angle = contact.angle_left if side == 0 else contact.angle_right
        along = 1.0 - radius * rolling - out * c.half * turning
        across = (v + radius * contact.roll_rate) * per_speed - psi
        spin = turning - out * angle * per_r0
        fx, fy = -f11 * along, -f22 * across - f23 * spin
        share = 1.0
        if creep.law != 0:
            slip = speed * math.sqrt(along * along + across * across)
            share = share_of_linear(creep, math.sqrt(fx * fx + fy * fy), bound, slip)
        longitudinal += share * fx
        lateral += share * fy
        moment += share * (f23 * across - f33 * spin - out * c.half * fx)
        braking += share * radius * fx
    A, D = contact.angle_left + contact.angle_right, contact.angle_left - contact.angle_right
    lateral += longitudinal * psi - load * (0.5 * D + contact.roll)
    moment += 0.5 * c.half * load * A * psi - c.pitch_inertia * speed * per_r0 * contact.roll_rate
    return lateral, moment, braking


@stepped
def carried(
    g: GearConstants, path: FloatArray, force: float, moment: float, state: FloatArray, rates: FloatArray
) -> None:
    """Write the time derivative of what is above the wheelsets into ``rates``.

    Force and moment are those of the primary suspensions on the wheelsets, about the frame's middle.
    """
    frame, above = AXLE_STATES * g.count, 0.0
    if g.count > 1:
        body = frame + 4
        above = g.ks * (state[body] - state[frame]) + g.cs * (state[body + 1] - state[frame + 1])
        rates[body], rates[body + 1] = state[body + 1], path[0] - above / g.body_mass
        rates[frame + 2] = state[frame + 3]
        resisted = moment + g.k2 * state[frame + 2] + g.c2 * state[frame + 3]
        rates[frame + 3] = path[1] - resisted / g.frame_inertia
    rates[frame], rates[frame + 1] = state[frame + 1], path[0] + (above - force) / g.frame_mass


OUTPUTS = (
    "lateral_displacement",
    "lateral_velocity",
    "yaw",
    "yaw_rate",
    "mass_lateral_displacement",
    "mass_lateral_velocity",
    "lateral_acceleration",
    "yaw_acceleration",
    "mass_lateral_acceleration",
    *SEEN,
)
STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))  # of Runge-Kutta: part of the step, weight


@stepped
def integrate(
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
    """Integrate the motion of a running gear over a course by the classical Runge-Kutta method of 4th order.

    Args:
        distance: (k,) of the first axle.
        path: (k, 2 + 7 a) of the curved path; (1, 2 + 7 a) zeros on straight track.
        parts: (k,) sub-steps from each sample on.
        state: At the first sample; changed to that a step behind the last.
        out: (a, 17, k) written, in the order of ``OUTPUTS``, for each axle; of a bogie (2, 18, k), last the frame's yaw.
        outside: (a,) written: how many samples left the contact table of each axle.
    """
    size, width, n = len(state), path.shape[1], len(speed)
    trial, rates, total = np.zeros(size), np.zeros(size), np.zeros(size)
    forced, seen = path[0].copy(), np.zeros((gear.g.count, len(SEEN)))
    for i in range(n):
        following, h = min(i + 1, n - 1), step / parts[i]
        slope = (speed[following] - speed[i]) / step
        if speed[i] < STANDSTILL:
            for axle in range(gear.g.count):  # the wheels stick
                first = AXLE_STATES * axle
                state[first + 1] = state[first + 3] = state[first + 4] = 0.0
        for part in range(parts[i]):
            for stage in range(4):
                share, weight = STAGES[stage]
                t = (part + share) * h
                for k in range(size):
                    trial[k] = state[k] + share * h * rates[k]
                if len(path) > 1:
                    for k in range(width):
                        forced[k] = path[i, k] + t / step * (path[following, k] - path[i, k])
                v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
                left = gear_rates(gear, v, slope, s, forced, trial, rates, seen)
                if stage == 0:
                    total[:] = 0.0
                    if part == 0:
                        write_sample(gear.g, state, rates, seen, left, out, outside, i)
                for k in range(size):
                    total[k] += weight * rates[k]
            for k in range(size):
                state[k] += h / 6.0 * total[k]


@stepped
def write_sample(
    g: GearConstants,
    state: FloatArray,
    rates: FloatArray,
    seen: FloatArray,
    left: int,
    out: FloatArray,
    outside: IntArray,
    i: int,
) -> None:
    """Write sample ``i`` of every output of each axle into ``out``, and count axles that ``left`` their tables."""
    frame = AXLE_STATES * g.count
    for axle in range(g.count):
        first, x = AXLE_STATES * axle, g.axles[axle].x
        outside[axle] += left >> axle & 1
        for k in range(4):
            out[axle, k, i] = state[first + k]
        out[axle, 4, i], out[axle, 5, i], out[axle, 8, i] = state[frame], state[frame + 1], rates[frame + 1]
        if g.count > 1:
            out[axle, 4, i] += x * state[frame + 2]
            out[axle, 5, i] += x * state[frame + 3]
            out[axle, 8, i] += x * rates[frame + 3]
            out[axle, len(OUTPUTS), i] = state[frame + 2]
        out[axle, 6, i], out[axle, 7, i] = rates[first + 1], rates[first + 3]
        for k in range(len(SEEN)):
            out[axle, 9 + k, i] = seen[axle, k]
