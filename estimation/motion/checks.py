"""Checks of a window on its own: it must move, its position go with its speed, its axes with its direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.motion.hunting import in_place_of_quality
from estimation.motion.integration import IntegratedWindow, bridged, mirrored
from estimation.motion.parameters import Gates, SignalParameters
from estimation.motion.track_lookup import TRACKS
from estimation.motion.usable_samples import fast_enough
from estimation.values.arrays import FloatArray, runs
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window, WindowQuality

LOOK_S = 1.0  # over which positions are compared with the speed
JUMP = 0.5  # m
JUMP_SHARE = 0.05  # of the distance run
BACKWARDS = -0.3  # correlation of the lateral velocity with speed times yaw, 1 of an axle that rolls forward
UNRELATED = 0.25  # of sensors that are not on these axes: a turned one has up to 0.15, stiff bogies have 0.8
SMOOTHED_S = 0.04  # vibration is faster
ONE_WAY = 0.98  # share of the samples that must lead one way


def gate(quality: WindowQuality, track_section: str | None, gates: Gates) -> Reason | None:
    """Return why a window of this quality is not looked at; None where it is."""
    refused = _too_poor(quality, gates)
    if refused is not None:
        return in_place_of_quality(refused, quality)
    if track_section is None:
        return Reason(ReasonCode.SECTION_UNKNOWN, "the track section is not known")
    if quality.position_quality < gates.least_position_quality:
        return Reason(ReasonCode.POSITION_UNKNOWN, "the position is not known well enough")
    return None


def _too_poor(quality: WindowQuality, gates: Gates) -> Reason | None:
    if quality.sensor_fault:
        return Reason(ReasonCode.SENSOR_FAULT, "the sensor reports a fault")
    if quality.coverage < gates.least_coverage:
        return Reason(
            ReasonCode.TOO_FEW_SAMPLES,
            f"{quality.coverage:.0%} of the samples are there, {gates.least_coverage:.0%} are needed",
        )
    if quality.blows.sustained and quality.clipped > gates.most_clipped_in_blows:
        return Reason(
            ReasonCode.WHEEL_FLAT,
            f"a wheel strikes once a turn, with {quality.blows.size:.0f} m/s2 or more: {quality.clipped:.1%} of the"
            f" samples are clipped, at most {gates.most_clipped_in_blows:.1%} may be in blows; inspect its tread",
        )
    if quality.clipped > gates.most_clipped:
        return Reason(
            ReasonCode.CLIPPED,
            f"{quality.clipped:.1%} of the samples are clipped, at most {gates.most_clipped:.0%} may be",
        )
    return None


@dataclass(frozen=True, slots=True)
class Jump:
    """Where the position of a window jumps."""

    start: int  # last sample before
    stop: int  # first sample after
    metres: float


def check_moving(window: Window, signals: SignalParameters) -> Reason | None:
    """Return that the vehicle stands, runs too slowly, or has no position; None where it runs."""
    known = window.valid & np.isfinite(window.distance)
    if not known.any():
        return Reason(ReasonCode.POSITION_UNKNOWN, "no sample has a position on the section")
    running = known & fast_enough(window, signals)
    if not running.any():
        fastest = float(np.nanmax(np.where(known, window.speed, np.nan), initial=0.0))
        return Reason(
            ReasonCode.NOT_MOVING,
            f"the vehicle stands or runs too slowly: at most {fastest:.1f} m/s,"
            f" {signals.least_speed_m_s:g} m/s are needed",
        )
    return None


def position_jumps(integrated: IntegratedWindow) -> tuple[Jump, ...]:
    """Return where the position does not go with the speed.

    Over every second the distance must change by what the speed makes of it, within 0.5 m and 5 %.
    """
    window = integrated.window
    found: list[Jump] = []
    for segment in integrated.segments:
        at = bridged(window.distance[segment.part], segment.known)
        start = segment.part.start
        found += [
            Jump(start + before, start + after, metres)
            for before, after, metres in _jumps(at, segment.run, window.sample_interval_s)
        ]
    return tuple(found)


def _jumps(at: FloatArray, run: FloatArray, dt: float) -> list[tuple[int, int, float]]:
    """Return (sample before, sample after, m) of every jump of a segment."""
    direction = 1.0 if float(np.median(np.diff(at))) >= 0.0 else -1.0
    error = at - direction * run
    look = min(round(LOOK_S / dt), len(at) - 1)
    deviates = np.abs(error[look:] - error[:-look]) > JUMP + JUMP_SHARE * (run[look:] - run[:-look])
    found = []
    for first, behind in runs(deviates):
        # each such second holds the jump, so the jump is in what they share; where they share nothing all is in doubt
        low, high = int(behind) - 1, int(first) + look
        if low > high:
            low, high = int(first), int(behind) - 1 + look
        apart = error[low : high + 1] - error[low]
        found.append((low, high, float(apart[int(np.argmax(np.abs(apart)))])))
    return found


def without_jumps(window: Window, jumps: Sequence[Jump]) -> Window:
    """Return the window with the samples around jumps not valid, so that no segment goes across one."""
    if not jumps:
        return window
    valid = window.valid.copy()
    margin = max(round(0.02 / window.sample_interval_s), 4)  # more than any gap that is bridged
    for jump in jumps:
        valid[max(jump.start - margin, 0) : jump.stop + margin] = False
    return replace(window, valid=valid)


def jumps_reason(jumps: Sequence[Jump]) -> Reason | None:
    """Return how often and how far the position jumps; None without jumps."""
    if not jumps:
        return None
    largest = max(jumps, key=lambda jump: abs(jump.metres))
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return Reason(
        ReasonCode.POSITION_JUMP,
        f"the position jumps {times} against the speed, by {abs(largest.metres):.1f} m at most",
    )


def check_axis_signs(integrated: IntegratedWindow) -> Reason | None:
    """Return that the axes contradict the direction of running, or one another; None where they do not.

    An axle that rolls forward with a yaw to the left moves to the left: y' = V psi up to small creep. Backwards, or
    with one of the two sensors the wrong way round, the sign is the other. Where one of the two is on another axis, or
    measures something else, they have nothing in common.
    """
    correlation = lateral_yaw_correlation(integrated)
    if correlation is None or correlation >= UNRELATED:
        return None
    if correlation >= BACKWARDS:
        return Reason(
            ReasonCode.SENSOR_TURNED,
            f"lateral velocity and yaw of the wheelset have nothing in common (correlation {correlation:.2f}): a sensor"
            " is turned, or channels are exchanged; check the mounting of the node",
        )
    return Reason(
        ReasonCode.AXES_REVERSED,
        f"the axes point against the direction of running: lateral velocity and yaw have opposite signs"
        f" (correlation {correlation:.2f}), unlike at other nodes; check the mounting of the node",
    )


def lateral_yaw_correlation(integrated: IntegratedWindow) -> float | None:
    """Return the correlation of lateral velocity with speed times yaw, vibration apart; None where nothing moves."""
    products, lateral, yaw = 0.0, 0.0, 0.0
    second, fast = (round(length / integrated.window.sample_interval_s) for length in (LOOK_S, SMOOTHED_S))
    for segment in integrated.segments:
        both = np.stack([segment.rates[0], segment.speed * segment.displacements[1]])
        a, b = (high_pass_running_mean(row, second) for row in uniform_filter1d(both, max(fast, 1)))
        products, lateral, yaw = products + float(a @ b), lateral + float(a @ a), yaw + float(b @ b)
    if lateral * yaw <= 0.0:
        return None
    return float(products / np.sqrt(lateral * yaw))


def high_pass_running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return values less their running mean over about ``width`` samples twice, which takes slow wandering out."""
    rest = values
    for _ in range(2):
        rest = rest - uniform_filter1d(rest, width | 1, mode="constant")  # an odd number, so that nothing is displaced
    return np.asarray(rest[width:-width])


def direction(window: Window) -> int:
    """Return 1 where the vehicle runs along the section, -1 where it runs against it, 0 where it does both."""
    known = window.valid & np.isfinite(window.distance)
    steps = np.diff(window.distance[known])
    moving = steps[steps != 0.0]
    if not len(moving):
        return 1
    forward = float((moving > 0.0).mean())
    return 1 if forward >= ONE_WAY else -1 if forward <= 1.0 - ONE_WAY else 0


def to_wheelset_axes(
    integrated: IntegratedWindow, track: TrackAlignment, facing: int, *, mounted_reversed: bool
) -> tuple[IntegratedWindow, TrackAlignment]:
    """Return window and alignment with the left side where the wheelset's own left wheel is.

    A vehicle that faces against the section has its axes turned half round: the section's right is its left. For a
    wheelset mounted the other way round everything lateral is its mirror image, in which the same equations hold.

    Args:
        facing: 1 where the front end of the vehicle is ahead along the section, -1 where its rear end is.
        mounted_reversed: The wheelset's left wheel is on the vehicle's right-hand side.
    """
    if (facing < 0) != mounted_reversed:
        track = _turned(track)
    return mirrored(integrated) if mounted_reversed else integrated, track


@lru_cache(maxsize=TRACKS)
def _turned(track: TrackAlignment) -> TrackAlignment:
    return replace(track, alignment=-track.alignment)
