"""The stepping loop: the equations of motion integrated by Runge-Kutta of 4th order, compiled.

One call runs one wheelset with its suspended mass over a given course of speed and distance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimation.values.arrays import FloatArray, IntArray
from ingest.simulator.rates import FORCED, LOOKED_UP, STANDSTILL, STATES, Constants, Grid, derivatives, stepped

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


@stepped
def runge_kutta(
    c: Constants,
    table: FloatArray,
    coefficients: FloatArray,
    grid: Grid,
    speed: float,
    slope: float,
    s: float,
    h: float,
    state: FloatArray,
    forced: FloatArray,
    forced_slope: FloatArray,
    stages: FloatArray,
    contact: FloatArray,
    track: FloatArray,
) -> None:
    """Advance the state by one step of the classical Runge-Kutta method of 4th order.

    Speed rises by ``slope``, what is ``forced`` (3,) by ``forced_slope`` (3,); ``forced`` is left as it is at the end.
    """
    k1, k2, k3, k4, trial = stages[0], stages[1], stages[2], stages[3], stages[4]
    middle, after = speed + 0.5 * slope * h, speed + slope * h
    s_middle, s_after = s + 0.25 * h * (speed + middle), s + 0.5 * h * (speed + after)
    forced += 0.5 * h * forced_slope
    advance(state, 0.5 * h, k1, trial)
    derivatives(c, table, coefficients, grid, middle, s_middle, trial, forced, k2, contact, track)
    advance(state, 0.5 * h, k2, trial)
    derivatives(c, table, coefficients, grid, middle, s_middle, trial, forced, k3, contact, track)
    forced += 0.5 * h * forced_slope
    advance(state, h, k3, trial)
    derivatives(c, table, coefficients, grid, after, s_after, trial, forced, k4, contact, track)
    for k in range(STATES):
        state[k] += h / 6.0 * (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k])


@stepped
def integrate(
    c: Constants,
    table: FloatArray,
    coefficients: FloatArray,
    grid: Grid,
    speed: FloatArray,
    distance: FloatArray,
    path: FloatArray,
    step: float,
    parts: IntArray,
    state: FloatArray,
    out: FloatArray,
) -> int:
    """Integrate the equations of motion over a course; return how many samples left the contact table.

    ``path`` (n, 3) are the accelerations that the path forces. Step i is divided into ``parts[i]`` sub-steps. Return
    how many samples left the contact table.

    Args:
        path: (k, 3) accelerations of y, psi and ym that the path forces, m/s^2 and rad/s^2.
        parts: (k - 1,) sub-steps of each step.
        out: (17, k) written, in the order of ``OUTPUTS``.
    """
    stages, contact, track, forced = np.empty((5, STATES)), np.empty(LOOKED_UP + 1), np.empty(4), np.empty(FORCED)
    outside = 0
    for i in range(len(speed)):
        if speed[i] < STANDSTILL:
            state[1] = state[3] = 0.0
        forced[:] = path[i]
        if not derivatives(
            c, table, coefficients, grid, speed[i], distance[i], state, forced, stages[0], contact, track
        ):
            outside += 1
        write_sample(state, stages[0], contact, track, out, i)
        if i == len(speed) - 1:
            break
        slope, h = (speed[i + 1] - speed[i]) / step, step / parts[i]
        rise = (path[i + 1] - path[i]) / step
        for part in range(parts[i]):
            t = part * h
            v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
            if part > 0:
                derivatives(c, table, coefficients, grid, v, s, state, forced, stages[0], contact, track)
            runge_kutta(c, table, coefficients, grid, v, slope, s, h, state, forced, rise, stages, contact, track)
    return outside


@stepped
def write_sample(
    state: FloatArray, rates: FloatArray, contact: FloatArray, track: FloatArray, out: FloatArray, i: int
) -> None:
    """Write sample ``i`` of every output into ``out`` (17, n), in the order of ``OUTPUTS``."""
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


def uniform_spacing(nodes: Sequence[float] | FloatArray) -> float | None:
    """Return the spacing of increasing, uniform ``nodes``, None where they are not; 1 for a single node."""
    steps = np.diff(np.asarray(nodes, dtype=np.float64))
    if len(steps) == 0:
        return 1.0
    if not (steps[0] > 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)):
        return None
    return float(np.mean(steps))
