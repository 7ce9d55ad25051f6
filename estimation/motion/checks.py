"""Checks of a window on its own: it must move, its position go with its speed, its axes with its direction.

Which samples of a window can be used, and what became of the others; curves, which are left out, among them.

In a curve the lateral accelerometers of wheelset and mass measure V^2 kappa - g theta, the acceleration that the cant
leaves uncompensated. An offset of the sensor looks the same, but does not change within a minute. What cannot be
detected: a window within a single curve, and a curve whose cant is that of the speed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.motion.hunting import in_place_of_quality
from estimation.motion.integration import Gates, IntegratedWindow, SignalParameters, bridged, integrate
from estimation.motion.parameters import MOTION
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, runs
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackLayout
from estimation.values.units import GRAVITY
from estimation.values.windows import Window, WindowQuality, fast_enough


def straight(distance: FloatArray, layout: TrackLayout, limits: SignalParameters) -> BoolArray:
    """Return which places (n,) are on track that is straight within ``limits``; places off the layout do not."""
    grid = np.union1d(np.arange(layout.s[0], layout.s[-1], MOTION.layout_step), layout.s)
    bent = (np.abs(np.interp(grid, layout.s, layout.curvature)) > limits.sharpest_curvature) | (
        np.abs(np.interp(grid, layout.s, layout.cant)) > limits.highest_cant
    )
    near = np.concatenate([[0], np.cumsum(bent)])
    on_layout = (distance >= layout.s[0]) & (distance <= layout.s[-1])
    at = np.where(np.isfinite(distance), distance, layout.s[0])
    first = np.searchsorted(grid, at - limits.curve_margin, side="left")
    last = np.searchsorted(grid, at + limits.curve_margin, side="right")
    return np.asarray(on_layout & (near[last] == near[first]))


def check_upright(window: Window, usable: BoolArray) -> Reason | None:
    """Return that a lateral accelerometer is turned about the longitudinal axis; None where it is not."""
    # It then measures a part of gravity at rest: of 8 degrees 1.4 m/s2. Vertical motion is in its signal too, and
    # cannot be taken out. Only sensors that measure constant accelerations show it.
    if not (window.measures_gravity and usable.any()):
        return None
    places = {"axle box": window.lateral_acceleration, "mass or frame": window.mass_lateral_acceleration}
    means = {name: float(np.mean(values[usable])) for name, values in places.items()}
    name = max(means, key=lambda place: abs(means[place]))
    if abs(means[name]) <= MOTION.most_rest_acceleration:
        return None
    angle = np.degrees(np.arcsin(min(abs(means[name]) / GRAVITY, 1.0)))
    return Reason(
        ReasonCode.SENSOR_TURNED,
        f"the lateral accelerometer of the {name} measures {means[name]:+.1f} m/s2 on average, like one that is turned"
        f" by {angle:.0f} degrees; at most {MOTION.most_rest_acceleration:g} m/s2 may be its offset;"
        " check its mounting, and its offset in the mapping of the bus",
    )


def detect_uncompensated_acceleration(
    window: Window, usable: BoolArray, max_cant_deficiency_change: float
) -> Reason | None:
    """Return that the window shows a curve; None where it does not."""
    spread = cant_deficiency_acceleration_range(window, usable)
    if spread <= max_cant_deficiency_change:
        return None
    return Reason(
        ReasonCode.CURVE_DETECTED,
        f"a curve is detected and no layout is stored: the slow lateral acceleration changes by {spread:.2f} m/s2,"
        f" at most {max_cant_deficiency_change:g} may be drift; register the layout of the section",
    )


def cant_deficiency_acceleration_range(window: Window, usable: BoolArray) -> float:
    """Return by how much the slow lateral acceleration of wheelset and mass together changes in a window, m/s2."""
    size = round(MOTION.mean_span_s / window.sample_interval_s)
    count = len(usable) // size
    known = usable[: count * size].reshape(count, size)
    lateral = 0.5 * (window.lateral_acceleration + window.mass_lateral_acceleration)[: count * size].reshape(
        count, size
    )
    enough = known.mean(axis=1) >= MOTION.least_mean_share
    if not enough.any():
        return 0.0
    means = np.where(known, lateral, 0.0).sum(axis=1)[enough] / known.sum(axis=1)[enough]
    return float(np.ptp(means))


def straight_part(window: Window, layout: TrackLayout | None, parameters: SignalParameters) -> Window | Reason:
    """Return the window with samples in curves not valid, or why none is left; without a layout, if it shows one."""
    if layout is None:
        fast = window.valid & fast_enough(window.speed, parameters.least_speed_m_s)
        return check_lateral(window, fast, layout, parameters) or window
    left = window.valid & straight(window.distance, layout, parameters)
    if not left.any() and window.valid.any():
        return Reason(ReasonCode.IN_CURVES, "all of the window is in curves")
    return check_lateral(window, left, layout, parameters) or replace(window, valid=left)


def check_lateral(
    window: Window, usable: BoolArray, layout: TrackLayout | None, parameters: SignalParameters
) -> Reason | None:
    """Return that a lateral accelerometer is turned, or, where no layout is stored, that the window shows a curve."""
    turned = check_upright(window, usable)
    if turned is not None or layout is not None:
        return turned
    return detect_uncompensated_acceleration(window, usable, parameters.max_cant_deficiency_change)


def moving_samples(window: Window, parameters: SignalParameters) -> BoolArray:
    """Return the valid samples (n,) at known positions at which the vehicle runs fast enough."""
    return window.valid & np.isfinite(window.distance) & fast_enough(window.speed, parameters.least_speed_m_s)


@dataclass(frozen=True, slots=True)
class Usable(FrozenArrays):
    """Samples that can be used (n,), and the share of all samples that was lost by each cause, counted once."""

    samples: Annotated[BoolArray, "n"]
    lost: Mapping[str, float]

    @property
    def causes(self) -> str:
        """What was lost and why, the largest share first."""
        ordered = sorted(self.lost.items(), key=lambda item: -item[1])
        return ", ".join(f"{share:.0%} {cause}" for cause, share in ordered if share > 0)


def usable_samples(
    window: Window, known: BoolArray, layout: TrackLayout | None, parameters: SignalParameters
) -> Usable:
    """Return the samples of ``window`` that can be used, of those (n,) of known place; no layout is straight."""
    tests = {
        "missing, clipped or invalid": window.valid,
        "off the known part of the section": known,
        f"slower than {parameters.least_speed_m_s:g} m/s": fast_enough(window.speed, parameters.least_speed_m_s),
    }
    if layout is not None:
        tests["in curves"] = straight(window.distance, layout, parameters)
    left, lost = np.ones(len(window.valid), dtype=np.bool_), {}
    for cause, passed in tests.items():
        lost[cause] = float((left & ~passed).mean())
        left &= passed
    return Usable(left, lost)


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
    running = known & fast_enough(window.speed, signals.least_speed_m_s)
    if not running.any():
        fastest = float(np.nanmax(np.where(known, window.speed, np.nan), initial=0.0))
        return Reason(
            ReasonCode.NOT_MOVING,
            f"the vehicle stands or runs too slowly: at most {fastest:.1f} m/s,"
            f" {signals.least_speed_m_s:g} m/s are needed",
        )
    return None


def position_jumps(integrated: IntegratedWindow) -> tuple[Jump, ...]:
    """Return where the position does not go with the speed."""
    # over every second the distance must change by what the speed makes of it, within 0.5 m and 5 %
    window, found = integrated.window, list[Jump]()
    for segment in integrated.segments:
        at, run = bridged(window.distance[segment.part], segment.known), segment.run
        error = at - (1.0 if float(np.median(np.diff(at))) >= 0.0 else -1.0) * run
        look = min(round(MOTION.comparison_s / window.sample_interval_s), len(at) - 1)
        deviates = np.abs(error[look:] - error[:-look]) > MOTION.position_jump + MOTION.position_jump_share * (
            run[look:] - run[:-look]
        )
        for first, behind in runs(deviates):
            # each such second holds the jump, so it is in what they share; where they share nothing all is in doubt
            low, high = int(behind) - 1, int(first) + look
            if low > high:
                low, high = int(first), int(behind) - 1 + look
            apart, start = error[low : high + 1] - error[low], segment.part.start
            found.append(Jump(start + low, start + high, float(apart[int(np.argmax(np.abs(apart)))])))
    return tuple(found)


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
    """Return that the axes contradict the direction of running, or one another; None where they do not."""
    # An axle that rolls forward with a yaw to the left moves to the left: y' = V psi up to small creep. Backwards, or
    # with one of the two sensors the wrong way round, the sign is the other. Where one of the two is on another axis,
    # or measures something else, they have nothing in common.
    correlation = lateral_yaw_correlation(integrated)
    if correlation is None or correlation >= MOTION.unrelated_correlation:
        return None
    if correlation >= MOTION.backwards_correlation:
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
    interval_s = integrated.window.sample_interval_s
    second, fast = round(MOTION.comparison_s / interval_s), round(MOTION.smoothing_s / interval_s)
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
    return 1 if forward >= MOTION.one_way_share else -1 if forward <= 1.0 - MOTION.one_way_share else 0


def check_running(window: Window, signals: SignalParameters) -> Reason | None:
    """Return that the vehicle does not run fast enough, and one way; None where it does."""
    reason = check_moving(window, signals)
    if reason is None and direction(window) == 0:
        return Reason(ReasonCode.BOTH_DIRECTIONS, "the vehicle runs both ways along the section")
    return reason


def check_integrated(integrated: IntegratedWindow) -> IntegratedWindow | Reason:
    """Return the window, or what of it contradicts the rest."""
    return jumps_reason(position_jumps(integrated)) or check_axis_signs(integrated) or integrated


def runs_backwards(window: Window) -> bool | None:
    """Return whether the axes of a node point against the direction of travel; None where it does not say."""
    signals = SignalParameters()
    correlation = lateral_yaw_correlation(integrate(window, moving_samples(window, signals), signals))
    if correlation is None or abs(correlation) < abs(MOTION.backwards_correlation):
        return None
    return correlation < 0.0


TOO_LITTLE = frozenset({ReasonCode.NO_USABLE_SAMPLE, ReasonCode.INTERRUPTED, ReasonCode.TOO_FEW_USABLE})


def away_from_low_adhesion(
    window: Window, stretches: Sequence[tuple[float, float]], correction: Correction | None = None
) -> Window | Reason:
    """Return the window with its samples on low friction not valid, or that none is left."""
    if not stretches:
        return window
    distance = window.distance if correction is None else correction.at(window.distance)
    low = np.zeros(len(window.valid), np.bool_)
    for begin, end in stretches:
        low |= (distance >= begin - MOTION.low_friction_margin) & (distance <= end + MOTION.low_friction_margin)
    left = window.valid & ~low
    if not left.any() and window.valid.any():
        return Reason(ReasonCode.LOW_ADHESION, "all of the window is on rails of low friction")
    return replace(window, valid=left)


def refused_for_low_adhesion(reason: Reason, window: Window, kept: Window) -> Reason:
    """Return why a window is refused: low friction, where that took most of its samples and too few are left."""
    share = 1.0 - float(kept.valid.sum()) / max(int(window.valid.sum()), 1)
    if share < MOTION.most_left_out_share or reason.code not in TOO_LITTLE:
        return reason
    text = f"{share:.0%} of its samples are on rails of low friction; of the rest: {reason.text}"
    return Reason(ReasonCode.LOW_ADHESION, text)
