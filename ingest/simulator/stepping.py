"""The stepping loop: Eq. 1-5 integrated by Runge-Kutta of 4th order, compiled.

One call runs one wheelset with its suspended mass over a given course of speed and distance. The contact geometry is
looked up bilinearly in (y - d, gauge deviation); the slopes of the roll angle are tabulated at the same nodes, so
that roll rate is the chain rule phi' = phi_x (y' - d') + phi_e e', and roll acceleration is its time derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from estimation.arrays import FloatArray

STATES = 6  # y, y', psi, psi', ym, ym'
LOOKED_UP = 7  # rL, rR, dL, dR, phi, phi_x, phi_e
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

_compiled = numba.njit(cache=True, nogil=True, error_model="numpy")


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


@_compiled
def look_up(table: FloatArray, grid: Grid, x: float, e: float, out: FloatArray) -> bool:
    """Interpolate ``table`` (n, g, 7) at (x, e) into ``out`` (7,); return whether x lies inside the grid.

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


@_compiled
def track_at(coefficients: FloatArray, grid: Grid, s: float, out: FloatArray) -> None:
    """Write alignment, its slope, gauge deviation, its slope at distance ``s`` into ``out`` (4,)."""
    i = min(max(int((s - grid.s0) / grid.interval), 0), len(coefficients) - 1)
    h = s - grid.s0 - i * grid.interval
    c = coefficients[i]
    out[0] = ((c[0] * h + c[1]) * h + c[2]) * h + c[3]
    out[1] = (3.0 * c[0] * h + 2.0 * c[1]) * h + c[2]
    out[2] = ((c[4] * h + c[5]) * h + c[6]) * h + c[7]
    out[3] = (3.0 * c[4] * h + 2.0 * c[5]) * h + c[6]


@_compiled
def derivatives(
    c: Constants,
    table: FloatArray,
    coefficients: FloatArray,
    grid: Grid,
    speed: float,
    s: float,
    state: FloatArray,
    rates: FloatArray,
    contact: FloatArray,
    track: FloatArray,
) -> bool:
    """Write the time derivative of ``state`` (6,) into ``rates`` (6,); ``contact`` (8,) and ``track`` (4,) are filled.

    ``contact[7]`` is the roll rate. Return whether y - d lies inside the contact table.
    """
    y, v, psi, psi_rate, ym, vm = state[0], state[1], state[2], state[3], state[4], state[5]
    track_at(coefficients, grid, s, track)
    inside = look_up(table, grid, y - track[0], track[2], contact)
    roll_rate = contact[5] * (v - speed * track[1]) + contact[6] * speed * track[3]
    contact[7] = roll_rate
    per_speed = 1.0 / speed
    S, R = contact[0] + contact[1], contact[0] - contact[1]
    A, D = contact[2] + contact[3], contact[2] - contact[3]
    slip = v + 0.5 * S * roll_rate - speed * psi
    suspension = c.ky * (ym - y) + c.fy * (vm - v)
    force = (
        -(2.0 * c.f22 * per_speed) * slip
        - 2.0 * c.f11 * (1.0 - S / (2.0 * c.r0)) * psi
        - (2.0 * c.f23 * per_speed) * (psi_rate - speed * D / (2.0 * c.r0))
        - c.load * (0.5 * D + contact[4])
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
    return inside


@_compiled
def advance(state: FloatArray, h: float, rates: FloatArray, out: FloatArray) -> None:
    """Write ``state`` + ``h`` ``rates`` into ``out``, all (6,)."""
    for k in range(STATES):
        out[k] = state[k] + h * rates[k]


@_compiled
def integrate(
    c: Constants,
    table: FloatArray,
    coefficients: FloatArray,
    grid: Grid,
    speed: FloatArray,
    distance: FloatArray,
    step: float,
    rate_limit: float,
    creep_rate_at_1: float,
    state: FloatArray,
    out: FloatArray,
) -> int:
    """Integrate over ``speed`` (n,) and ``distance`` (n,) every ``step`` s; fill ``out`` (17, n); change ``state``.

    A step is divided until (creep rate x sub-step) <= ``rate_limit``. Return how many samples left the contact table.
    """
    n = len(speed)
    k1, k2, k3, k4 = np.empty(STATES), np.empty(STATES), np.empty(STATES), np.empty(STATES)
    trial = np.empty(STATES)
    contact, track = np.empty(LOOKED_UP + 1), np.empty(4)
    outside = 0
    for i in range(n):
        if not derivatives(c, table, coefficients, grid, speed[i], distance[i], state, k1, contact, track):
            outside += 1
        for k in range(STATES):
            out[k, i] = state[k]
        out[6, i], out[7, i], out[8, i] = k1[1], k1[3], k1[5]
        out[9, i], out[10, i], out[11, i], out[12, i] = contact[4], contact[7], track[0], track[2]
        for k in range(4):
            out[13 + k, i] = contact[k]
        if i == n - 1:
            break
        slope = (speed[i + 1] - speed[i]) / step
        slowest = min(speed[i], speed[i + 1])
        parts = max(1, int(np.ceil(creep_rate_at_1 / slowest * step / rate_limit)))
        h = step / parts
        for part in range(parts):
            t = part * h
            v0, vm, v1 = speed[i] + slope * t, speed[i] + slope * (t + 0.5 * h), speed[i] + slope * (t + h)
            s0 = distance[i] + (speed[i] + 0.5 * slope * t) * t
            sm, s1 = s0 + 0.25 * h * (v0 + vm), s0 + 0.5 * h * (v0 + v1)
            if part > 0:
                derivatives(c, table, coefficients, grid, v0, s0, state, k1, contact, track)
            advance(state, 0.5 * h, k1, trial)
            derivatives(c, table, coefficients, grid, vm, sm, trial, k2, contact, track)
            advance(state, 0.5 * h, k2, trial)
            derivatives(c, table, coefficients, grid, vm, sm, trial, k3, contact, track)
            advance(state, h, k3, trial)
            derivatives(c, table, coefficients, grid, v1, s1, trial, k4, contact, track)
            for k in range(STATES):
                state[k] += h / 6.0 * (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k])
    return outside


def time_derivative(values: FloatArray, step: float) -> FloatArray:
    """Return d/dt of ``values`` (n,) sampled every ``step`` s: central, 4th order; lower at the ends."""
    slope = np.gradient(values, step)
    slope[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step)
    return np.asarray(slope)


def uniform_spacing(nodes: Sequence[float] | FloatArray) -> float | None:
    """Return the spacing of increasing, uniform ``nodes``, None where they are not; 1 for a single node."""
    steps = np.diff(np.asarray(nodes, dtype=np.float64))
    if len(steps) == 0:
        return 1.0
    if not (steps[0] > 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)):
        return None
    return float(np.mean(steps))
