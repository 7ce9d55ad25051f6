"""The stepping loop of the motion of a running gear, compiled."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray
from ingest.simulator.motion import STEP
from ingest.simulator.rates import AXLE_STATES, SEEN, STANDSTILL, GearConstants, GearOnTrack, gear_rates, stepped

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
    "frame_yaw",
    *SEEN,
)
STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))  # of Runge-Kutta of 4th order: share of the step, weight


@stepped
def integrate(
    gear: GearOnTrack,
    speed: FloatArray,
    distance: FloatArray,
    path: FloatArray,
    parts: IntArray,
    state: FloatArray,
    out: FloatArray,
) -> None:
    """Integrate the motion of a running gear over a course by the classical Runge-Kutta method of 4th order.

    Args:
        distance: (k,) of the frame's middle.
        path: (k, 2 + 7 a); (1, 2 + 7 a) zeros on straight track.
        parts: (k,) sub-steps behind each sample.
        state: At the first sample; changed to that one step behind the last.
        out: (a, 18, k) written, in the order of ``OUTPUTS``.
    """
    trial, rates, total = np.zeros_like(state), np.zeros_like(state), np.zeros_like(state)
    forced, seen = path[0].copy(), np.zeros((gear.g.n_axles, len(SEEN)))
    for i in range(len(speed)):
        following, h = min(i + 1, len(speed) - 1), STEP / parts[i]
        slope = (speed[following] - speed[i]) / STEP
        if speed[i] < STANDSTILL:
            stick(gear.g, state)
        for part in range(parts[i]):
            for stage in range(len(STAGES)):
                share, weight = STAGES[stage]
                t = (part + share) * h
                if len(path) > 1:
                    for k in range(len(forced)):
                        forced[k] = path[i, k] + t / STEP * (path[following, k] - path[i, k])
                add(state, share * h, rates, trial)
                v, s = speed[i] + slope * t, distance[i] + (speed[i] + 0.5 * slope * t) * t
                gear_rates(gear, v, slope, s, forced, trial, rates, seen)
                if stage == 0:
                    total[:] = 0.0
                    if part == 0:
                        write_sample(gear.g, state, rates, seen, out, i)
                add(total, weight, rates, total)
            add(state, h / 6.0, total, state)


@stepped
def add(values: FloatArray, factor: float, others: FloatArray, out: FloatArray) -> None:
    """Write ``values`` + ``factor`` ``others`` into ``out``."""
    for k in range(len(values)):
        out[k] = values[k] + factor * others[k]


@stepped
def stick(g: GearConstants, state: FloatArray) -> None:
    """Stop the wheelsets, whose wheels stick to the rails."""
    for axle in range(g.n_axles):
        first = AXLE_STATES * axle
        state[first + 1] = state[first + 3] = state[first + 4] = 0.0


@stepped
def write_sample(
    g: GearConstants, state: FloatArray, rates: FloatArray, seen: FloatArray, out: FloatArray, i: int
) -> None:
    """Write sample ``i`` of every output of each axle into ``out``."""
    frame = AXLE_STATES * g.n_axles
    for axle in range(g.n_axles):
        first, x = AXLE_STATES * axle, g.axles[axle].x
        for k in range(4):
            out[axle, k, i] = state[first + k]
        out[axle, 4, i], out[axle, 5, i] = state[frame] + x * state[frame + 2], state[frame + 1] + x * state[frame + 3]
        out[axle, 6, i], out[axle, 7, i] = rates[first + 1], rates[first + 3]
        out[axle, 8, i], out[axle, 9, i] = rates[frame + 1] + x * rates[frame + 3], state[frame + 2]
        for k in range(len(SEEN)):
            out[axle, 10 + k, i] = seen[axle, k]
