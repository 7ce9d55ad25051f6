"""A window in; its band-limited motion relative to the track out, or the reason why not.

Rates and displacements are running integrals of the accelerations. Offsets and drift make them wander; so from every
signal the part that varies slowly *along the track* is taken out (``filters``). The filter is linear, takes segments of
any length and speed, and is applied once to each side that is compared (y - d as a whole), so that it favours neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline

from estimation.compiled import compiled
from estimation.filters import local_cubic_kernel, modelled_gaps, remove_wander
from estimation.motion.checks import (
    Usable,
    check_integrated,
    check_lateral,
    check_running,
    direction,
    gate,
    moving_samples,
    usable_samples,
)
from estimation.motion.integration import (
    IntegratedSegment,
    IntegratedWindow,
    SignalParameters,
    WindowParameters,
    bridged,
    integrate,
    mirrored,
    standard_displacement,
)
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_radius_difference import FUSED, fuse, motion_signals
from estimation.values.arrays import BoolArray, FloatArray, frozen_array, runs
from estimation.values.memory import MEMORY
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.units import SECOND_NS
from estimation.values.windows import OF_FRAME, Motion, Window, fast_enough
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleParameters, displacement_noise


@dataclass(frozen=True, slots=True, eq=False)
class SampledCurve:
    """A curve on a uniform grid; two of them are equal if they are the same object, which makes them keys of caches."""

    s: FloatArray  # (n,) m, increasing
    values: FloatArray  # (n,) NaN where not known


def at_places(curve: SampledCurve, places: FloatArray) -> FloatArray:
    """Return the values (n,) at places (n,); NaN off the curve, and beside a point of it that is not known."""
    found = np.full(len(places), np.nan)
    inside = places[(places >= curve.s[0]) & (places <= curve.s[-1])]
    if not len(inside):
        return found
    low, high = inside.min(), inside.max()
    last_point = len(curve.s) - 1
    first = min(max(int(np.searchsorted(curve.s, low)) - 1, 0), last_point - 1) // MEMORY.spline_points
    last = max(min(int(np.searchsorted(curve.s, high)), last_point) - 1, 0) // MEMORY.spline_points
    pieces = [_piece(curve, number) for number in range(first, last + 1)]
    coefficients = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
    s = curve.s[first * MEMORY.spline_points : first * MEMORY.spline_points + len(coefficients) + 1]
    if len(coefficients):
        places, coefficients = (frozen_array(one, one.shape, name="places") for one in (places, coefficients))
        evaluate(places, s, coefficients, found)
    return found


@lru_cache(maxsize=MEMORY.alignment_splines)
def _piece(curve: SampledCurve, number: int) -> FloatArray:
    """Return the coefficients (m, 4) of the spline in a piece, highest power first; NaN beside unknown points."""
    begin, end = number * MEMORY.spline_points, min((number + 1) * MEMORY.spline_points, len(curve.s) - 1)
    first = max(begin - MOTION.spline_margin, 0)
    values = curve.values[first : end + 1 + MOTION.spline_margin]
    known = first + np.flatnonzero(np.isfinite(values))
    coefficients = np.full((max(end - begin, 0), 4), np.nan)
    if len(known) >= MOTION.fewest_spline_points:
        spline = CubicSpline(curve.s[known], curve.values[known])
        beside = np.flatnonzero((np.diff(known) == 1) & (known[:-1] >= begin) & (known[:-1] < end))
        coefficients[known[beside] - begin] = spline.c[:, beside].T
    return frozen_array(coefficients, (None, 4), name="coefficients")


@compiled(nogil=True)
def evaluate(places: FloatArray, s: FloatArray, coefficients: FloatArray, found: FloatArray) -> None:
    """Write the spline at places on the grid (m,), m; a place on a point of it belongs to the interval before.

    Off the grid ``found`` (n,) stays as it is; ``coefficients`` are (m - 1, 4) between the points.
    """
    last, per_step = len(coefficients) - 1, (len(s) - 1) / (s[-1] - s[0])
    for i in range(len(places)):
        at = places[i]
        if s[0] <= at <= s[-1]:
            j = min(int((at - s[0]) * per_step), last)
            while j > 0 and at <= s[j]:
                j -= 1
            while j < last and at > s[j + 1]:
                j += 1
            t = at - s[j]
            a, b, c, d = coefficients[j]
            found[i] = ((a * t + b) * t + c) * t + d


def alignment_at(distance: FloatArray, track: TrackAlignment, cutoff_wavelength: float) -> FloatArray:
    """Return d (n,), m, by a cubic spline through the stored alignment; NaN off the section and where not known."""
    as_it_is = track.cutoff_wavelength >= MOTION.full_band_factor * cutoff_wavelength
    return at_places(_curve(track, as_it_is=as_it_is), distance)


@lru_cache(maxsize=2 * MEMORY.deconvolved_tracks)
def _curve(track: TrackAlignment, *, as_it_is: bool) -> SampledCurve:
    return SampledCurve(track.s, _certain(track) if as_it_is else deconvolved(track))


def _certain(track: TrackAlignment) -> FloatArray:
    # places of a survey that no pass has made better would blur what the rest shows
    if not (track.passes > 0).any():
        return track.alignment
    most = max(MOTION.uncertain_std, MOTION.uncertain_factor * float(np.nanmedian(track.alignment_std)))
    certain = np.where(track.alignment_std <= most, track.alignment, np.nan)
    return frozen_array(certain, (len(certain),), name="alignment")


@lru_cache(maxsize=MEMORY.deconvolved_tracks)
def deconvolved(track: TrackAlignment) -> FloatArray:
    """Return the alignment (n,), m, with F undone; as it is where the track has no cut-off.

    A fleet finds F d, the alignment behind the filter F of ``estimation.filters``; the motion needs G (y - d), G its
    own filter, and G (1 - F) d would be left: F is undone as far as G bears it. NaN within a cut-off of unknown places.
    """
    if not track.band_limited:
        return track.alignment
    step = float(track.s[1] - track.s[0])
    weights = local_cubic_kernel(track.cutoff_wavelength, step)
    lost = round(track.cutoff_wavelength / step)
    result = np.full(len(track.s), np.nan)
    for start, stop in runs(np.isfinite(track.alignment)):
        inner = slice(start + lost, max(stop - lost, start + lost))
        inverse = _regularised_inverse(track.alignment[start:stop], weights)
        result[inner] = inverse[lost : lost + inner.stop - inner.start]
    return frozen_array(result, (len(result),), name="alignment")


def _regularised_inverse(filtered: FloatArray, weights: FloatArray) -> FloatArray:
    n, reach = len(filtered), len(weights)
    size = fft.next_fast_len(n + reach, real=True)
    kernel = np.zeros(size)
    kernel[: len(weights)] = weights
    left = 1 - fft.rfft(np.roll(kernel, -(len(weights) // 2))).real  # F by wavenumber: the weights are symmetric
    inverse = left / (left**2 + MOTION.inverse_floor**2)
    return np.asarray(fft.irfft(fft.rfft(filtered, size) * inverse, size)[:n])


def gauge_shift(
    window: Window,
    track: TrackAlignment,
    vehicle: VehicleParameters,
    parameters: SignalParameters,
    earlier: IntegratedWindow | None = None,
) -> FloatArray | None:
    """Return by how much the gauge moves the wheelset (n,), m, in its own axes, NaN where that is not known.

    None where nothing is known of it: on constant gauge, or of a wheelset of which the section has no findings.
    """
    table = None if track.findings is None else track.findings.gauge_shifts.get(window.wheelset)
    if track.findings is None or table is None:
        return None
    ends = FUSED.grid_step * (len(local_cubic_kernel(FUSED.crossover_wavelength, FUSED.grid_step)) // 2)
    more = track.findings.stiffness_ratio.get(window.vehicle, 1.0) - 1.0
    e = np.interp(window.distance, track.s, track.gauge_deviation, left=np.nan, right=np.nan)
    shift = np.full(len(window.valid), np.nan)
    usable = window.valid & np.isfinite(e) & fast_enough(window.speed, parameters.least_speed_m_s)
    for segment in integrate(window, usable, parameters, earlier=earlier).segments:
        part, run = segment.part, segment.run
        grid = fuse(motion_signals(segment, vehicle), vehicle)
        certain = (grid.run >= grid.run[0] + ends) & (grid.run <= grid.run[-1] - ends)
        if not certain.any():
            continue
        whole = (grid.difference + more * grid.stiffness_term)[None, :]
        longest = MOTION.longest_radius_wave
        (fast,) = remove_wander(np.where(certain, whole, 0.0), grid.run - grid.run[0], certain, longest)
        known = segment.known & (run >= grid.run[0] + ends) & (run <= grid.run[-1] - ends)
        shift[part][known] = table.at(np.interp(run[known], grid.run, fast), e[part][known])
    return shift


def motion(
    window: Window,
    track: TrackAlignment,
    parameters: SignalParameters,
    layout: TrackLayout | None = None,
    gauge_shift: FloatArray | None = None,
    earlier: IntegratedWindow | None = None,
    radius: float = VEHICLE.usual_radius,
) -> Motion | Reason:
    """Return the band-limited motion of ``window`` relative to ``track``, or why it cannot be had.

    Args:
        track: Alignment of the window's section; samples outside it are left out. Wavelengths that it does not hold are
            taken out of the motion too.
        gauge_shift: (n,) m, by how much the gauge moves the wheelset, NaN where the table does not reach; None without
            a table.
        radius: Nominal rolling radius, m: the height of the axle.
    """
    cutoff_wavelength = min(parameters.cutoff_wavelength, track.cutoff_wavelength)
    d = alignment_at(window.distance, track, cutoff_wavelength)
    if gauge_shift is not None:
        d += gauge_shift  # it runs as it would at nominal gauge on a track that is aligned so
    usable = usable_samples(window, np.isfinite(d), layout, parameters)
    if not usable.samples.any():
        return Reason(ReasonCode.NO_USABLE_SAMPLE, f"no sample can be used: {usable.causes}")
    refusal = check_lateral(window, usable.samples, layout, parameters)
    if refusal is not None:
        return refusal
    dt = window.sample_interval_s
    integrated = integrate(window, usable.samples, parameters, round(parameters.modelled_gap_s / dt), earlier)
    signals, valid = _filtered(integrated, d, replace(parameters, cutoff_wavelength=cutoff_wavelength), radius)
    refusal = _too_little(valid, integrated, usable, parameters)
    if refusal is not None:
        return refusal
    seconds = window.start_ns / SECOND_NS + np.arange(len(valid)) * dt
    block = np.floor(seconds / parameters.block_s).astype(np.int64)
    signals["speed"] = np.where(window.speed > 0, window.speed, np.nan)
    ratio = 1.0 if track.findings is None else track.findings.stiffness_ratio.get(window.vehicle, 1.0)
    return Motion(
        **signals,
        valid=valid,
        block=block,
        band_limited=True,
        stiffness_ratio=ratio,
        sample_interval_s=dt,
        displacement_noise=0.0,  # ``window_motion`` knows the sensors
    )


def _filtered(
    integrated: IntegratedWindow, d: FloatArray, parameters: SignalParameters, radius: float
) -> tuple[dict[str, FloatArray], BoolArray]:
    """Return the named signals of a motion, NaN outside the segments, and which samples of them count (n,)."""
    n, dt = len(d), integrated.window.sample_interval_s
    named = _FILTERED if integrated.window.frame_yaw_acceleration is None else (*_FILTERED, *OF_FRAME)
    rows: FloatArray | None = None
    valid = np.zeros(n, dtype=np.bool_)
    trim, margin = round(parameters.trimmed_s / dt), round(parameters.gap_margin_s / dt)
    for segment in integrated.segments:
        part, known = segment.part, segment.known
        fast = remove_wander(
            _relative_to(d[part], segment, radius),
            segment.run,
            known,
            parameters.cutoff_wavelength,
            parameters.bridged_samples,
            in_place=True,
        )
        if fast.shape[1] == n:
            rows = fast
        else:
            rows = np.full((len(named), n), np.nan) if rows is None else rows
            rows[:, part] = fast
        valid[part.start + trim : part.stop - trim] = known[trim : len(known) - trim]
        for first, behind in modelled_gaps(known, parameters.bridged_samples):
            valid[max(part.start + first - margin, 0) : part.start + behind + margin] = False
    if integrated.window.bridged is not None:
        valid &= ~integrated.window.bridged
    rows = np.full((len(named), n), np.nan) if rows is None else rows
    rows.flags.writeable = False  # so that nothing copies them
    return dict(zip(named, rows, strict=True)), valid


_FILTERED = (
    "displacement",
    "lateral_velocity",
    "lateral_acceleration",
    "yaw",
    "yaw_rate",
    "yaw_acceleration",
    "roll",
    "roll_rate",
    "suspension_deflection",
    "suspension_deflection_rate",
)


def _too_little(
    valid: BoolArray, integrated: IntegratedWindow, usable: Usable, parameters: SignalParameters
) -> Reason | None:
    lost = f"; lost: {usable.causes}" if usable.causes else ""
    if not integrated.segments:
        return Reason(ReasonCode.INTERRUPTED, f"no uninterrupted run of {parameters.shortest_segment_s:g} s{lost}")
    if valid.mean() < parameters.least_used:
        return Reason(
            ReasonCode.TOO_FEW_USABLE,
            f"{valid.mean():.0%} of the samples can be used, {parameters.least_used:.0%} are needed{lost}",
        )
    return None


def _relative_to(d: FloatArray, segment: IntegratedSegment, radius: float) -> FloatArray:
    """Return the signals (10, m) of a segment as ``_FILTERED`` names them; in a bogie those of ``OF_FRAME`` follow."""
    y, ψ, φ, ym = segment.displacements
    dy, dψ, dφ, dym = segment.rates
    ddy, ddψ = segment.accelerations[:2]
    along = bridged(d, np.isfinite(d))
    of_frame = [] if segment.frame_yaw is None else [segment.frame_yaw[2], segment.frame_yaw[1], ym]
    relative = standard_displacement(y - along, φ, radius, level=segment.level)
    return np.stack([relative, dy, ddy, ψ, dψ, ddψ, φ, dφ, ym - y, dym - dy, *of_frame])


NO_ALIGNMENT = Reason(ReasonCode.ALIGNMENT_UNKNOWN, "the alignment of the track section is not known yet")


def window_motion(
    window: Window,
    track: TrackAlignment | None,
    parameters: WindowParameters,
    correction: Correction | None = None,
    misplaced: Reason | None = None,
    *,
    mounted_reversed: bool = False,
    layout: TrackLayout | None = None,
) -> Motion | Reason:
    """Return the motion of ``window`` (n,) in the axes of its wheelset, or why the window is refused.

    Args:
        track: Alignment of its track section; None where none is on file, all NaN where that is of the gauge alone.
    """
    refused = gate(window.quality, window.track_section, parameters.gates)
    if refused is None and (track is None or not np.isfinite(track.alignment).any()):
        refused = NO_ALIGNMENT
    refused = refused or misplaced or check_running(window, parameters.signals)
    if refused is not None or track is None:
        return refused or NO_ALIGNMENT
    integrated = check_integrated(integrate(window, moving_samples(window, parameters.signals), parameters.signals))
    if isinstance(integrated, Reason):
        return integrated
    facing = -direction(window) if window.backwards else direction(window)
    integrated, track = to_wheelset_axes(integrated, track, facing, mounted_reversed=mounted_reversed)
    window = integrated.window
    if correction is not None:
        window = replace(window, distance=correction.at(window.distance))
    shift = gauge_shift(window, track, parameters.vehicle, parameters.signals, integrated)
    moved = motion(window, track, parameters.signals, layout, shift, integrated, parameters.vehicle.nominal_radius)
    if isinstance(moved, Reason):
        return moved
    cutoff_wavelength = min(parameters.signals.cutoff_wavelength, track.cutoff_wavelength)
    noise = displacement_noise(parameters.vehicle_class, cutoff_wavelength, moved.speed[moved.valid])
    return replace(moved, displacement_noise=float(np.mean(noise)))


def to_wheelset_axes(
    integrated: IntegratedWindow, track: TrackAlignment, facing: int, *, mounted_reversed: bool
) -> tuple[IntegratedWindow, TrackAlignment]:
    """Return window and alignment with the left side where the wheelset's own left wheel is.

    A vehicle that faces against the section has its axes turned half round: the section's right is its left. For a
    wheelset mounted the other way round everything lateral is its mirror image, in which the same equations hold.

    Args:
        facing: 1 where the front end of the vehicle is ahead along the section, -1 where its rear end is.
    """
    if (facing < 0) != mounted_reversed:
        track = _turned(track)
    return mirrored(integrated) if mounted_reversed else integrated, track


@lru_cache(maxsize=MEMORY.deconvolved_tracks)
def _turned(track: TrackAlignment) -> TrackAlignment:
    return replace(track, alignment=-track.alignment)
