"""Motion of a running gear on its track: one or two wheelsets, the frame above them and what that carries, compiled.

The wheelsets obey Eq. 1 and 2 of ``estimation.vehicle.regressors``, written for each wheel; with i = 1 at
x_i = +a and i = 2 at -a (a half the wheelbase), frame (y_f, psi_f), body y_b and the curved path of ``gear_path``

    F_i = ky (y_f + x_i psi_f - y_i - o_i) + fy (their rates)             on wheelset i instead of Fsy
    M_i = -k_psi (psi_i + t_i - psi_f) - f_psi (their rates)              on wheelset i instead of Mpsi
    m_f y_f''   = -sum F_i + G,   G = ks (y_b - y_f) + cs (y_b' - y_f')   m_b y_b'' = -G
    I_f psi_f'' = -sum (x_i F_i + M_i) - k2 psi_f - c2 psi_f'

One wheelset has a mass above it that does not yaw, y_f is ym of Eq. 5, and nothing ties it to a body. Where the wheels
roll freely (not with the linear law alone, whose angular velocity is V/r0), u = r0 omega - V is a state of every
wheelset:

    Iwy u'/r0 = -sum r Fx + r0 T - Iwy V'/r0 + (torque that turns the wheelset with the speed) = -sum r Fx + r0 T

with T the traction force of the axle. A track that rolls by p (cross level) carries the wheelset along: the axle,
r0 above the rails, is displaced by -r0 p, its roll is that of the contact plus p, and the rails bear W vertically. What
is above rolls with the mean of p at its axles, and its weight W - m g bears on each axle along its own normal:
(W - m g) p on the wheelset, and as much the other way on the frame. A p that is the same everywhere is a cant of -p.

The contact geometry is looked up bilinearly in (y - d, gauge deviation); the slopes of the roll angle are tabulated
at the same nodes, so that roll rate is the chain rule phi' = phi_x (y' - d') + phi_e e', and roll acceleration is its
time derivative.

Arrays, in SI: ``nodes`` (n, g, 7) hold rL, rR, dL, dR, phi, phi_x, phi_e; ``coefficients`` (m, 8) are cubic splines of
alignment and gauge deviation, (m, 20) with those of cross level, friction and load where the track has them; ``state``
and ``rates`` (5 a + 6,) with a axles: y, y', psi, psi', u of each wheelset, y, y', psi, psi' of the frame, y, y' of the
body; ``path`` (2 + 7 a,) is as ``gear_path`` returns it; ``seen`` (a, 8) is written, in the order of ``SEEN``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray
from ingest.simulator.running import CreepConstants, share_of_linear

STANDSTILL = 0.05  # m/s: below it the wheels stick, and only what is above moves
AXLE_STATES = 5  # y, y', psi, psi', u of each wheelset
FRAME_PATH = 2  # of the frame and the body, see ``gear_path``
AXLE_PATH = 7  # of each wheelset
LEVEL = 8  # columns of the coefficients of a track without cross level, friction and load
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

# inlined by numba: handing over a hundred parameters would take longer than the work, and each is called in one place
stepped = compiled(nogil=True, error_model="numpy", inline="always")


class Wheels(NamedTuple):
    """Out-of-roundness of the left and the right wheel of an axle, whose radii vary once per revolution."""

    amplitude: tuple[float, float]  # m
    phase: tuple[float, float]  # rad, where the run begins to count distance


ROUND = Wheels((0.0, 0.0), (0.0, 0.0))


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
    wheels: Wheels


class GearConstants(NamedTuple):
    """The parameters of a running gear by their symbols, from ``frame_mass`` on in the order of ``BogieParameters``."""

    axles: tuple[AxleConstants, AxleConstants]  # the second is that of the first where there is one
    n_axles: int  # 1 or 2
    free_rolling: bool  # whether the angular velocity of the wheels is a state, or V/r0
    frame_mass: float
    frame_inertia: float  # infinite where it does not yaw
    body_mass: float
    ks: float
    cs: float
    k2: float
    c2: float


class TableGrid(NamedTuple):
    """The even grids of a contact table: first node and reciprocal spacing of y - d and of gauge deviation."""

    x0: float
    per_x: float
    e0: float
    per_e: float


class GearOnTrack(NamedTuple):
    """What the rates of a running gear follow from, beside its state; contact tables of both axles."""

    g: GearConstants
    creep: CreepConstants
    nodes: tuple[FloatArray, FloatArray]
    grids: tuple[TableGrid, TableGrid]
    coefficients: FloatArray
    begin: float  # m, distance of the first point of the track
    interval: float  # m


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
def look_up(nodes: FloatArray, grid: TableGrid, x: float, e: float) -> LookedUp:
    """Interpolate a contact table at (x, e).

    Outside, the edge cell is continued linearly in x; e is held at the edge.
    """
    n, g, _ = nodes.shape
    fx, fe = (x - grid.x0) * grid.per_x, min(max((e - grid.e0) * grid.per_e, 0.0), g - 1.0)
    i, j = min(max(int(fx), 0), n - 2), max(min(int(fe), g - 2), 0)
    right = min(j + 1, g - 1)
    wx, we = fx - i, fe - j
    w = ((1.0 - wx) * (1.0 - we), (1.0 - wx) * we, wx * (1.0 - we), wx * we)
    return (
        blend(nodes, i, j, right, w, 0),
        blend(nodes, i, j, right, w, 1),
        blend(nodes, i, j, right, w, 2),
        blend(nodes, i, j, right, w, 3),
        blend(nodes, i, j, right, w, 4),
        blend(nodes, i, j, right, w, 5),
        blend(nodes, i, j, right, w, 6),
    )


@stepped
def blend(nodes: FloatArray, i: int, j: int, right: int, w: tuple[float, float, float, float], k: int) -> float:
    """Return value ``k`` of four nodes, weighted."""
    left = w[0] * nodes[i, j, k] + w[1] * nodes[i, right, k]
    return float(left + (w[2] * nodes[i + 1, j, k] + w[3] * nodes[i + 1, right, k]))


@stepped
def place_at(gear: GearOnTrack, s: float, height: float) -> Place:
    """Return the track at distance ``s``, its alignment at ``height`` above the rails."""
    coefficients = gear.coefficients
    i = min(max(int((s - gear.begin) / gear.interval), 0), len(coefficients) - 1)
    h = s - gear.begin - i * gear.interval
    d, d_slope = cubic(coefficients, i, 0, h)
    e, e_slope = cubic(coefficients, i, 4, h)
    if coefficients.shape[1] == LEVEL:
        return Place(d, d_slope, e, e_slope, 0.0, 0.0, 1.0, 1.0)
    roll, roll_slope = cubic(coefficients, i, 8, h)
    friction, _ = cubic(coefficients, i, 12, h)
    load, _ = cubic(coefficients, i, 16, h)
    return Place(d - height * roll, d_slope - height * roll_slope, e, e_slope, roll, roll_slope, friction, load)


@stepped
def cubic(coefficients: FloatArray, i: int, first: int, h: float) -> tuple[float, float]:
    """Return the cubic whose coefficients begin at ``first`` of row ``i``, and its slope, ``h`` m into the cell."""
    a, b, c = coefficients[i, first], coefficients[i, first + 1], coefficients[i, first + 2]
    return ((a * h + b) * h + c) * h + coefficients[i, first + 3], (3.0 * a * h + 2.0 * b) * h + c


@stepped
def mean_roll(gear: GearOnTrack, s: float) -> float:
    """Return the mean roll of the track at the axles, rad; ``s`` is the distance of the frame's middle."""
    g, total = gear.g, 0.0
    if gear.coefficients.shape[1] > LEVEL:
        for axle in range(g.n_axles):
            total += place_at(gear, s + g.axles[axle].x, 0.0).roll
    return total / g.n_axles


@stepped
def contact_at(gear: GearOnTrack, axle: int, place: Place, s: float, speed: float, y: float, v: float) -> Contact:
    """Return the contact of an axle with the track at distance ``s``."""
    c = gear.g.axles[axle]
    left, right, angle_left, angle_right, roll, roll_x, roll_e = look_up(
        gear.nodes[axle], gear.grids[axle], y - place.alignment, place.gauge
    )
    roll += place.roll
    if speed < STANDSTILL:
        return Contact(left, right, angle_left, angle_right, roll, 0.0)
    rate = roll_x * (v - speed * place.alignment_slope) + speed * (roll_e * place.gauge_slope + place.roll_slope)
    if c.wheels != ROUND:
        (size_left, size_right), (phase_left, phase_right) = c.wheels
        turn_left, turn_right = s / c.r0 + phase_left, s / c.r0 + phase_right
        more_left, more_right = size_left * math.sin(turn_left), size_right * math.sin(turn_right)
        left, right, roll = left + more_left, right + more_right, roll + (more_left - more_right) / (2.0 * c.half)
        swing = size_left * math.cos(turn_left) - size_right * math.cos(turn_right)
        rate += speed / c.r0 * swing / (2.0 * c.half)
    return Contact(left, right, angle_left, angle_right, roll, rate)


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
) -> None:
    """Write the time derivative of ``state`` into ``rates``, and what was looked up into ``seen``.

    Speed rises by ``slope``; ``s`` is the distance of the frame's middle.
    """
    g, frame = gear.g, AXLE_STATES * gear.g.n_axles
    y_f, v_f, psi_f, psi_rate_f = state[frame], state[frame + 1], state[frame + 2], state[frame + 3]
    leaning, force, moment = mean_roll(gear, s), 0.0, 0.0
    rates[:frame] = 0.0
    for axle in range(g.n_axles):
        c, first, bend = g.axles[axle], AXLE_STATES * axle, FRAME_PATH + AXLE_PATH * axle
        y, v, psi, psi_rate = state[first], state[first + 1], state[first + 2], state[first + 3]
        place = place_at(gear, s + c.x, c.r0)
        contact = contact_at(gear, axle, place, s + c.x, speed, y, v)
        for k in range(len(contact)):
            seen[axle, k] = contact[k]
        seen[axle, 6], seen[axle, 7] = place.alignment, place.gauge
        deflection = y_f + c.x * psi_f - y - path[bend + 3]
        deflection_rate = v_f + c.x * psi_rate_f - v - path[bend + 4]
        suspension = c.ky * deflection + c.fy * deflection_rate + c.weight_above * leaning
        turned = -c.k_psi * (psi + path[bend + 5] - psi_f) - c.f_psi * (psi_rate + path[bend + 6] - psi_rate_f)
        force += suspension
        moment += c.x * suspension + turned
        if speed < STANDSTILL:
            continue
        u, curvature = state[first + 4], path[bend + 2]
        lateral, yaw, braking = creep_forces(c, gear.creep, place, contact, speed, v, psi, psi_rate, u, curvature)
        rates[first], rates[first + 1] = v, (lateral + suspension) / c.mass + path[bend]
        rates[first + 2], rates[first + 3] = psi_rate, (yaw + turned) / c.inertia + path[bend + 1]
        if g.free_rolling:
            traction = slope * (c.traction if slope > 0.0 else c.braking)
            rates[first + 4] = (c.r0 * traction - braking) * c.r0 / c.pitch_inertia
    carried(g, path, force, moment, state, rates)


@stepped
def creep_forces(
    c: AxleConstants,
    creep: CreepConstants,
    place: Place,
    contact: Contact,
    speed: float,
    v: float,
    psi: float,
    psi_rate: float,
    u: float,
    curvature: float,
) -> tuple[float, float, float]:
    """Return what the rails do to a wheelset: lateral force, yaw moment and the moment that brakes its rolling."""
    per_speed, per_r0 = 1.0 / speed, 1.0 / c.r0
    rolling = (1.0 + u * per_speed) * per_r0
    turning = psi_rate * per_speed + curvature
    load = c.load * place.load
    f11, f22, f23, f33 = c.f11, c.f22, c.f23 * place.load, c.f33
    if place.load != 1.0:
        # powers take a tenth of the time of a step
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
    """Write the time derivative of frame and body into ``rates``.

    Force and moment are those of the primary suspensions on the wheelsets, about the frame's middle.
    """
    frame = AXLE_STATES * g.n_axles
    y, v, psi, psi_rate = state[frame], state[frame + 1], state[frame + 2], state[frame + 3]
    above = g.ks * (state[frame + 4] - y) + g.cs * (state[frame + 5] - v)
    rates[frame], rates[frame + 1] = v, path[0] + (above - force) / g.frame_mass
    rates[frame + 2], rates[frame + 3] = psi_rate, path[1] - (moment + g.k2 * psi + g.c2 * psi_rate) / g.frame_inertia
    rates[frame + 4], rates[frame + 5] = state[frame + 5], path[0] - above / g.body_mass
