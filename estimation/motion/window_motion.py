"""A window in; its band-limited motion relative to the track out, or the reason why not.

Rates and displacements are running integrals of the accelerations. Offsets and drift make them wander; so from every
signal the part that varies slowly *along the track* is taken out (``filters``). The filter is linear, takes segments of
any length and speed, and is applied once to each side that is compared (y - d as a whole), so that it favours neither.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from estimation.filters import modelled_gaps, remove_wander
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
from estimation.motion.track_lookup import TRACKS, alignment_at, gauge_shift
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import OF_FRAME, Motion, Window
from estimation.vehicle.vehicle_class import displacement_noise

NANOSECONDS = 1_000_000_000


def motion(
    window: Window,
    track: TrackAlignment,
    parameters: SignalParameters,
    layout: TrackLayout | None = None,
    gauge_shift: FloatArray | None = None,
    earlier: IntegratedWindow | None = None,
    radius: float = 0.45,
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
    seconds = window.start_ns / NANOSECONDS + np.arange(len(valid)) * dt
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
    """Return accelerations, rates and displacements (10, m) of one segment in the order of ``_FILTERED``.

    In a bogie yaw, yaw rate and lateral displacement of the frame follow.
    """
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
    """Return the motion of ``window`` relative to ``track``, or why the window is refused.

    Args:
        track: Alignment of its track section; None where none is on file, all NaN where that is of the gauge alone.

    Returns:
        (n,) samples of band-limited motion in the axes of the wheelset, or the refusal.
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
        mounted_reversed: The wheelset's left wheel is on the vehicle's right-hand side.
    """
    if (facing < 0) != mounted_reversed:
        track = _turned(track)
    return mirrored(integrated) if mounted_reversed else integrated, track


@lru_cache(maxsize=TRACKS)
def _turned(track: TrackAlignment) -> TrackAlignment:
    return replace(track, alignment=-track.alignment)
