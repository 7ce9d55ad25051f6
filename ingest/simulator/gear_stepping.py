"""The stepping loop of a running gear: Runge-Kutta of 4th order over a given course, compiled.

The compiler keeps this loop, with all that it calls, until this file changes: after a change of ``gear_rates`` or
``creep_laws`` alone its cache must be deleted.
"""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray
from ingest.simulator.creep_laws import CreepConstants
from ingest.simulator.gear_rates import (
    AXLE_STATES,
    CONTACT,
    FRAME,
    GEAR_STATES,
    PATH,
    PLACES,
    GearConstants,
    Wheels,
    gear_rates,
)
from ingest.simulator.rates import OUTPUTS, STANDSTILL, Grid, advance, stepped

GEAR_OUTPUTS = (*OUTPUTS, "frame_yaw")
TRACK = 4


@stepped
def integrate_gear(
    g: GearConstants,
    creep: CreepConstants,
    wheels: Wheels,
    tables: tuple[FloatArray, FloatArray],
    grids: tuple[Grid, Grid],
    coefficients: FloatArray,
    speed: FloatArray,
    distance: FloatArray,
    path: FloatArray,
    step: float,
    parts: IntArray,
    state: FloatArray,
    out: FloatArray,
    outside: IntArray,
) -> None:
    """Integrate the motion of a running gear over a course.

    Step i is divided into ``parts[i]`` sub-steps.

    Args:
        path: (k, 16) of the curved path; (1, 16) zeros on straight track.
        parts: (k - 1,) sub-steps of each step.
        out: (2, 18, k) written, in the order of ``GEAR_OUTPUTS``, for each axle.
        outside: (2,) written: how many samples left the contact table of each axle.
    """
    stages, forced, rise = np.zeros((5, GEAR_STATES)), np.zeros(PATH), np.zeros(PATH)
    contact, track, place = np.zeros((2, CONTACT)), np.zeros((2, TRACK)), np.zeros(PLACES)
    outside[:] = 0
    for i in range(len(speed)):
        if speed[i] < STANDSTILL:
            stand_still(state)
        forced[:] = path[min(i, len(path) - 1)]
        last = i == len(speed) - 1
        slope = 0.0 if last else (speed[i + 1] - speed[i]) / step
        left = gear_rates(
            g, creep, wheels, tables, grids, coefficients, speed[i], slope, distance[i], forced, state, stages[0],
            contact, track, place,
        )  # fmt: skip
        for axle in range(g.axles):
            outside[axle] += left >> axle & 1
            write_axle(g, axle, state, stages[0], contact, track, out[axle], i)
        if last:
            break
        h = step / parts[i]
        if len(path) > 1:
            rise[:] = 0.5 * h / step * (path[i + 1] - path[i])
        for part in range(parts[i]):
            t = part * h
            v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
            if part > 0:
                gear_rates(
                    g, creep, wheels, tables, grids, coefficients, v, slope, s, forced, state, stages[0],
                    contact, track, place,
                )  # fmt: skip
            gear_step(
                g, creep, wheels, tables, grids, coefficients, v, slope, s, h, forced, rise, state, stages,
                contact, track, place,
            )  # fmt: skip


@stepped
def gear_step(
    g: GearConstants,
    creep: CreepConstants,
    wheels: Wheels,
    tables: tuple[FloatArray, FloatArray],
    grids: tuple[Grid, Grid],
    coefficients: FloatArray,
    speed: float,
    slope: float,
    s: float,
    h: float,
    path: FloatArray,
    rise: FloatArray,
    state: FloatArray,
    stages: FloatArray,
    contact: FloatArray,
    track: FloatArray,
    place: FloatArray,
) -> None:
    """Advance the state by one step of the classical Runge-Kutta method of 4th order."""
    k1, k2, k3, k4, trial = stages[0], stages[1], stages[2], stages[3], stages[4]
    middle, after = speed + 0.5 * slope * h, speed + slope * h
    s_middle, s_after = s + 0.25 * h * (speed + middle), s + 0.5 * h * (speed + after)
    path += rise
    advance(state, 0.5 * h, k1, trial)
    gear_rates(
        g, creep, wheels, tables, grids, coefficients, middle, slope, s_middle, path, trial, k2, contact, track, place
    )
    advance(state, 0.5 * h, k2, trial)
    gear_rates(
        g, creep, wheels, tables, grids, coefficients, middle, slope, s_middle, path, trial, k3, contact, track, place
    )
    path += rise
    advance(state, h, k3, trial)
    gear_rates(
        g, creep, wheels, tables, grids, coefficients, after, slope, s_after, path, trial, k4, contact, track, place
    )
    for k in range(GEAR_STATES):
        state[k] += h / 6.0 * (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k])


@stepped
def stand_still(state: FloatArray) -> None:
    """Take the velocities of both wheelsets from ``state`` (16,): below ``STANDSTILL`` the wheels stick."""
    for axle in range(2):
        first = AXLE_STATES * axle
        state[first + 1] = state[first + 3] = state[first + 4] = 0.0


@stepped
def write_axle(
    g: GearConstants,
    axle: int,
    state: FloatArray,
    rates: FloatArray,
    contact: FloatArray,
    track: FloatArray,
    out: FloatArray,
    i: int,
) -> None:
    """Write sample ``i`` of every output of one axle into ``out`` (18, k), in the order of ``GEAR_OUTPUTS``."""
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
