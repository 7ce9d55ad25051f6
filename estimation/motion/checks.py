"""What a window says against itself: it stands, its position does not go with its speed, its axes point backwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.motion.integration import running_integrals, segments
from estimation.motion.parameters import SignalParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import TrackAlignment
from estimation.values.windows import ACCELERATIONS, Window

LOOK_S = 1.0  # over which positions are compared with the speed
JUMP = 0.5  # m
JUMP_SHARE = 0.05  # of the distance run
BACKWARDS = -0.3  # correlation of the lateral velocity with speed times yaw, 1 of an axle that rolls forward
ONE_WAY = 0.98  # share of the samples that must lead one way


@dataclass(frozen=True, slots=True)
class Jump:
    """Where the position of a window jumps."""

    start: int  # last sample before
    stop: int  # first sample after
    metres: float


def check_moving(window: Window, signals: SignalParameters) -> str:
    """Return that the vehicle stands, crawls, or that nobody knows where it is; empty where it runs."""
    known = window.valid & np.isfinite(window.distance)
    if not known.any():
        return "no sample with a position on the section"
    with np.errstate(invalid="ignore"):
        running = known & (window.speed >= signals.least_speed_m_s)
    if not running.any():
        fastest = float(np.nanmax(np.where(known, window.speed, np.nan), initial=0.0))
        return f"the vehicle stands or crawls: at most {fastest:.1f} m/s, {signals.least_speed_m_s:g} m/s are needed"
    return ""


def position_jumps(window: Window, signals: SignalParameters) -> tuple[Jump, ...]:
    """Return where the position does not go with the speed.

    Over every second the distance must change by what the speed makes of it, within 0.5 m and 5 %.
    """
    with np.errstate(invalid="ignore"):
        usable = window.valid & np.isfinite(window.distance) & (window.speed >= signals.least_speed_m_s)
    found: list[Jump] = []
    for start, stop in segments(np.asarray(usable), window, signals):
        part = slice(start, stop)
        at = _between(window.distance[part], usable[part])
        found += [
            Jump(start + a, start + b, metres)
            for a, b, metres in _jumps(at, _between(window.speed[part], usable[part]), window.sample_interval_s)
        ]
    return tuple(found)


def _between(values: FloatArray, known: BoolArray) -> FloatArray:
    index = np.flatnonzero(known)
    return np.interp(np.arange(len(values)), index, values[index])


def _jumps(at: FloatArray, speed: FloatArray, dt: float) -> list[tuple[int, int, float]]:
    """Return (sample before, sample after, m) of every jump of a stretch."""
    run = np.concatenate([[0.0], np.cumsum(0.5 * dt * (speed[1:] + speed[:-1]))])
    direction = 1.0 if float(np.median(np.diff(at))) >= 0.0 else -1.0
    error = at - direction * run
    look = min(round(LOOK_S / dt), len(at) - 1)
    strayed = np.abs(error[look:] - error[:-look]) > JUMP + JUMP_SHARE * (run[look:] - run[:-look])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], strayed.astype(np.int8), [0]])))
    found = []
    for first, behind in zip(edges[::2], edges[1::2], strict=True):
        # each strayed second holds the jump, so it lies in what they share; where they share nothing all is in doubt
        low, high = int(behind) - 1, int(first) + look
        if low > high:
            low, high = int(first), int(behind) - 1 + look
        found.append((low, high, float(error[high] - error[low])))
    return found


def without_jumps(window: Window, jumps: Sequence[Jump]) -> Window:
    """Return the window with the samples around jumps not valid, so that no stretch goes across one."""
    if not jumps:
        return window
    valid = window.valid.copy()
    margin = max(round(0.02 / window.sample_interval_s), 4)  # more than any gap that is bridged
    for jump in jumps:
        valid[max(jump.start - margin, 0) : jump.stop + margin] = False
    return replace(window, valid=valid)


def describe_jumps(jumps: Sequence[Jump]) -> list[str]:
    """Return what to say of jumps."""
    if not jumps:
        return []
    largest = max(jumps, key=lambda jump: abs(jump.metres))
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return [f"the position jumps {times} against the speed, by {abs(largest.metres):.1f} m at most"]


def check_axis_signs(window: Window, signals: SignalParameters) -> str:
    """Return that the axes point against the direction of running; empty where they do not.

    An axle that rolls forward with a yaw to the left moves to the left: y' = V psi up to small creep. Backwards, or
    with one of the two sensors the wrong way round, the sign is the other.
    """
    with np.errstate(invalid="ignore"):
        usable = np.asarray(window.valid & np.isfinite(window.distance) & (window.speed >= signals.least_speed_m_s))
    products, lateral, yaw = 0.0, 0.0, 0.0
    for start, stop in segments(usable, window, signals):
        part = slice(start, stop)
        _, rates, displacements = running_integrals(window, usable[part], part)
        seconds = round(LOOK_S / window.sample_interval_s)
        a = _high_pass_running_mean(rates[0], seconds)
        b = _high_pass_running_mean(_between(window.speed[part], usable[part]) * displacements[1], seconds)
        products, lateral, yaw = products + float(a @ b), lateral + float(a @ a), yaw + float(b @ b)
    if lateral * yaw <= 0.0:
        return ""
    correlation = products / np.sqrt(lateral * yaw)
    if correlation >= BACKWARDS:
        return ""
    return (
        f"the axes point against the direction of running: lateral velocity and yaw go against each other"
        f" (correlation {correlation:.2f})"
    )


def _high_pass_running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return values less their running mean over about ``width`` samples twice, which takes slow wandering out."""
    kernel = np.ones(2 * (width // 2) + 1) / (2 * (width // 2) + 1)
    rest = values
    for _ in range(2):
        rest = rest - np.convolve(rest, kernel, mode="same")
    return np.asarray(rest[width:-width])


def direction(window: Window) -> int:
    """Return 1 where the vehicle runs along the section, -1 where it runs against it, 0 where it does both."""
    with np.errstate(invalid="ignore"):
        known = window.valid & np.isfinite(window.distance)
        steps = np.diff(window.distance[known])
    moving = steps[steps != 0.0]
    if not len(moving):
        return 1
    forward = float((moving > 0.0).mean())
    return 1 if forward >= ONE_WAY else -1 if forward <= 1.0 - ONE_WAY else 0


def to_wheelset_axes(
    window: Window, track: TrackAlignment, way: int, *, mounted_reversed: bool
) -> tuple[Window, TrackAlignment]:
    """Return window and alignment with the left side where the wheelset's own left wheel is.

    A vehicle that runs against the section has its axes turned half round: the section's right is its left. For a
    wheelset mounted the other way round everything lateral is its mirror image, in which the same equations hold.

    Parameters
    ----------
    window, track
        As measured, and as on file.
    way
        From :func:`direction`.
    mounted_reversed
        The wheelset's left wheel is on the vehicle's right-hand side.
    """
    mounted = -1 if mounted_reversed else 1
    if way * mounted < 0:
        track = replace(track, alignment=-track.alignment)
    if mounted_reversed:
        window = replace(window, **{name: -getattr(window, name) for name in ACCELERATIONS})
    return window, track
