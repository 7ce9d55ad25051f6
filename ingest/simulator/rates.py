"""Time derivative of a wheelset on its track: Eq. 1-5, with the contact geometry looked up, compiled.

The contact geometry is looked up bilinearly in (y - d, gauge deviation); the slopes of the roll angle are tabulated
at the same nodes, so that roll rate is the chain rule phi' = phi_x (y' - d') + phi_e e', and roll acceleration is its
time derivative.

Arrays of all compiled code, in SI: ``table`` (n, g, 7), at its nodes rL, rR, dL, dR, phi, phi_x, phi_e;
``coefficients`` (m, 8), cubic splines of alignment and gauge deviation; ``state`` and ``rates`` (6,), y, y', psi, psi',
ym, ym' and their time derivative; ``forced`` (3,), accelerations of y, psi and ym that the path forces; ``contact``
(8,), what was looked up, then the roll rate; ``track`` (4,), alignment and gauge deviation, each with its slope. ``s``
is the distance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, IntArray

STANDSTILL = 0.05  # m/s: below it the wheels stick, and only the suspended mass moves
FORCED = 3  # accelerations that the path forces: y, psi, ym
STATES = 6  # y, y', psi, psi', ym, ym'
LOOKED_UP = 7  # rL, rR, dL, dR, phi, phi_x, phi_e

stepped = compiled(nogil=True, error_model="numpy")


class Constants(NamedTuple):
    """The parameters of Eq. 1-5 by their symbols, as the compiled code takes them."""

    f11: float
    f22: float
    f23: float
    f33: float
    fy: float
    f_psi: float
    inertia: float
    pitch_inertia: float
    half: float
    mass: float
    suspended: float
    ky: float
    k_psi: float
    load: float
    r0: float


class Grid(NamedTuple):
    """Uniform grids: first node and reciprocal spacing of y - d, of gauge deviation, and of distance."""

    x0: float
    per_x: float
    e0: float
    per_e: float
    s0: float
    interval: float


class WheelsetOnTrack(NamedTuple):
    """What the rates of a wheelset follow from, beside its state."""

    c: Constants
    table: FloatArray
    coefficients: FloatArray
    grid: Grid


class Workspace(NamedTuple):
    """What is known of a wheelset at the state whose rates were written last."""

    contact: FloatArray
    track: FloatArray


@stepped
def look_up(table: FloatArray, grid: Grid, x: float, e: float, out: FloatArray) -> bool:
    """Interpolate ``table`` (n, g, 7) at (x, e) into ``out`` (7,); return whether x is inside the grid.

    Outside, the edge cell is continued linearly in x; e is held at the edge.
    """
    n, g, width = table.shape
    fx = (x - grid.x0) * grid.per_x
    inside = bool(0.0 <= fx <= n - 1)
    i = min(max(int(fx), 0), n - 2)
    wx = fx - i
    if g == 1:
        for k in range(width):
            out[k] = (1.0 - wx) * table[i, 0, k] + wx * table[i + 1, 0, k]
        return inside
    fe = min(max((e - grid.e0) * grid.per_e, 0.0), g - 1.0)
    j = min(int(fe), g - 2)
    we = fe - j
    w00, w01, w10, w11 = (1.0 - wx) * (1.0 - we), (1.0 - wx) * we, wx * (1.0 - we), wx * we
    for k in range(width):
        out[k] = (
            w00 * table[i, j, k] + w01 * table[i, j + 1, k] + w10 * table[i + 1, j, k] + w11 * table[i + 1, j + 1, k]
        )
    return inside


@stepped
def track_at(coefficients: FloatArray, grid: Grid, s: float, out: FloatArray) -> None:
    """Write alignment, its slope, gauge deviation, its slope at distance ``s`` into ``out`` (4,)."""
    i = min(max(int((s - grid.s0) / grid.interval), 0), len(coefficients) - 1)
    h = s - grid.s0 - i * grid.interval
    c = coefficients[i]
    out[0] = ((c[0] * h + c[1]) * h + c[2]) * h + c[3]
    out[1] = (3.0 * c[0] * h + 2.0 * c[1]) * h + c[2]
    out[2] = ((c[4] * h + c[5]) * h + c[6]) * h + c[7]
    out[3] = (3.0 * c[4] * h + 2.0 * c[5]) * h + c[6]


@stepped
def derivatives(
    w: WheelsetOnTrack,
    known: Workspace,
    speed: float,
    _slope: float,
    s: float,
    forced: FloatArray,
    state: FloatArray,
    rates: FloatArray,
) -> int:
    """Write the time derivative of ``state`` into ``rates``; return 1 where y - d is outside the table, else 0.

    ``forced`` is added to the accelerations.
    """
    contact, track = known.contact, known.track
    track_at(w.coefficients, w.grid, s, track)
    inside = look_up(w.table, w.grid, state[0] - track[0], track[2], contact)
    if speed < STANDSTILL:
        contact[7] = 0.0
        at_rest(w.c, state, rates)
    else:
        contact[7] = contact[5] * (state[1] - speed * track[1]) + contact[6] * speed * track[3]
        equations(w.c, speed, state, contact, rates)
        rates[1] += forced[0]
        rates[3] += forced[1]
    rates[5] += forced[2]
    return int(not inside)


@stepped
def at_rest(c: Constants, state: FloatArray, rates: FloatArray) -> None:
    """Write the time derivative of ``state`` (6,) of a wheelset that stands, with the mass swinging on its spring."""
    rates[:] = 0.0
    rates[4], rates[5] = state[5], -(c.ky * (state[4] - state[0]) + c.fy * state[5]) / c.suspended


@stepped
def equations(c: Constants, speed: float, state: FloatArray, contact: FloatArray, rates: FloatArray) -> None:
    """Write the time derivative of ``state`` (6,) by Eq. 1-5 into ``rates`` (6,), with ``contact`` (8,) known."""
    y, v, psi, psi_rate, ym, vm = state[0], state[1], state[2], state[3], state[4], state[5]
    roll, roll_rate, per_speed = contact[4], contact[7], 1.0 / speed
    S, R = contact[0] + contact[1], contact[0] - contact[1]
    A, D = contact[2] + contact[3], contact[2] - contact[3]
    slip = v + 0.5 * S * roll_rate - speed * psi
    suspension = c.ky * (ym - y) + c.fy * (vm - v)
    force = (
        -(2.0 * c.f22 * per_speed) * slip
        - 2.0 * c.f11 * (1.0 - S / (2.0 * c.r0)) * psi
        - (2.0 * c.f23 * per_speed) * (psi_rate - speed * D / (2.0 * c.r0))
        - c.load * (0.5 * D + roll)
        + suspension
    )
    moment = (
        -(c.pitch_inertia * speed / c.r0) * roll_rate
        - (c.half * c.f11 / c.r0) * R
        + (2.0 * c.f23 * per_speed) * slip
        - 2.0 * c.half * c.half * c.f11 * psi_rate * per_speed
        + c.f33 * D / c.r0
        + 0.5 * c.half * c.load * A * psi
        - 2.0 * c.f33 * psi_rate * per_speed
        - c.k_psi * psi
        - c.f_psi * psi_rate
    )
    rates[0], rates[1], rates[2] = v, force / c.mass, psi_rate
    rates[3], rates[4], rates[5] = moment / c.inertia, vm, -suspension / c.suspended


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
    "roll",
    "roll_rate",
    "alignment",
    "gauge_deviation",
    "rolling_radius_left",
    "rolling_radius_right",
    "contact_angle_left",
    "contact_angle_right",
)


@stepped
def advance(state: FloatArray, h: float, rates: FloatArray, out: FloatArray) -> None:
    """Write ``state`` + ``h`` ``rates`` into ``out``."""
    for k in range(len(state)):
        out[k] = state[k] + h * rates[k]


System = TypeVar("System", bound=tuple[Any, ...])
Known = TypeVar("Known", bound=tuple[Any, ...])
Rates = Callable[[System, Known, float, float, float, FloatArray, FloatArray, FloatArray], int]
"""Writes the time derivative of a state, given last but one, into the last array; says what left its table."""


@stepped
def runge_kutta(
    rates_of: Rates[System, Known],
    system: System,
    known: Known,
    speed: float,
    slope: float,
    s: float,
    h: float,
    forced: FloatArray,
    rise: FloatArray,
    state: FloatArray,
    stages: FloatArray,
) -> None:
    """Advance the state by one step of the classical Runge-Kutta method of 4th order.

    Speed rises by ``slope``, what is ``forced`` by ``rise`` in half a step; ``forced`` is left as it is at the end. The
    first row of ``stages`` (5, of the state) holds the rates at the beginning.
    """
    k1, k2, k3, k4, trial = stages[0], stages[1], stages[2], stages[3], stages[4]
    middle, after = speed + 0.5 * slope * h, speed + slope * h
    s_middle, s_after = s + 0.25 * h * (speed + middle), s + 0.5 * h * (speed + after)
    forced += rise
    advance(state, 0.5 * h, k1, trial)
    rates_of(system, known, middle, slope, s_middle, forced, trial, k2)
    advance(state, 0.5 * h, k2, trial)
    rates_of(system, known, middle, slope, s_middle, forced, trial, k3)
    forced += rise
    advance(state, h, k3, trial)
    rates_of(system, known, after, slope, s_after, forced, trial, k4)
    for k in range(len(state)):
        state[k] += h / 6.0 * (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k])


@stepped
def integrate(
    w: WheelsetOnTrack,
    speed: FloatArray,
    distance: FloatArray,
    path: FloatArray,
    step: float,
    parts: IntArray,
    state: FloatArray,
    out: FloatArray,
) -> int:
    """Integrate the equations of motion over a course; return how many samples left the contact table.

    Args:
        path: (k, 3) accelerations that the path forces.
        parts: (k - 1,) sub-steps of each step.
        state: At the first sample; changed to that at the last.
        out: (17, k) written, in the order of ``OUTPUTS``.
    """
    known = Workspace(np.empty(LOOKED_UP + 1), np.empty(4))
    stages, forced, outside = np.empty((5, STATES)), np.empty(FORCED), 0
    for i in range(len(speed)):
        if speed[i] < STANDSTILL:
            state[1] = state[3] = 0.0
        forced[:] = path[i]
        outside += derivatives(w, known, speed[i], 0.0, distance[i], forced, state, stages[0])
        write_sample(state, stages[0], known, out, i)
        if i == len(speed) - 1:
            break
        slope, h = (speed[i + 1] - speed[i]) / step, step / parts[i]
        rise = 0.5 * h * ((path[i + 1] - path[i]) / step)
        for part in range(parts[i]):
            t = part * h
            v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
            if part > 0:
                derivatives(w, known, v, slope, s, forced, state, stages[0])
            runge_kutta(derivatives, w, known, v, slope, s, h, forced, rise, state, stages)
    return outside


@stepped
def write_sample(state: FloatArray, rates: FloatArray, known: Workspace, out: FloatArray, i: int) -> None:
    """Write sample ``i`` of every output into ``out`` (17, n), in the order of ``OUTPUTS``."""
    contact, track = known.contact, known.track
    for k in range(STATES):
        out[k, i] = state[k]
    out[6, i], out[7, i], out[8, i] = rates[1], rates[3], rates[5]
    out[9, i], out[10, i], out[11, i], out[12, i] = contact[4], contact[7], track[0], track[2]
    for k in range(4):
        out[13 + k, i] = contact[k]


def sub_steps(speed: FloatArray, step: float, rate_at_1: float, limit: float) -> IntArray:
    """Return into how many parts (n - 1,) each step is divided, so that (creep rate x sub-step) <= ``limit``.

    ``rate_at_1`` is the creep rate at 1 m/s; it falls with speed.
    """
    slowest = np.maximum(np.minimum(speed[1:], speed[:-1]), STANDSTILL)
    return np.maximum(1, np.ceil(rate_at_1 * step / (limit * slowest))).astype(np.int64)


def time_derivative(values: FloatArray, step: float) -> FloatArray:
    """Return d/dt of ``values`` (n,) sampled every ``step`` s: central, 4th order; lower at the ends."""
    slope = np.gradient(values, step)
    slope[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step)
    return np.asarray(slope)
