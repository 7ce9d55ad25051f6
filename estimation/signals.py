"""From measured accelerations to band-limited motion relative to the track.

Rates and displacements are running integrals of the accelerations. Offsets and drift make them wander; so from every
signal the part that varies slowly *along the track* is taken out (``high_pass``). The filter is linear, takes
stretches of any length and speed, and is applied once to each side that is compared (y - d as a whole), so that it
favours neither.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.arrays import BoolArray, FloatArray
from estimation.errors import ParameterError
from estimation.felt_curves import felt_curve
from estimation.high_pass import HighPass, modelled_gaps, without_slow_part
from estimation.motion import NOT_SIGNALS, Motion
from estimation.restored_alignment import restored
from estimation.types import ACCELERATIONS, TrackAlignment, TrackLayout, Window
from estimation.usable_samples import CurveLimits, Usable, usable_samples

NANOSECONDS = 1_000_000_000
FEWEST_POINTS = 4  # of a spline
WHOLE = 2.0  # times the wavelength that is looked at: an alignment that reaches further holds it unchanged
SPLINE_MARGIN = 20  # points of the stored alignment beyond the window, so that the spline's ends do not matter


@dataclass(frozen=True, slots=True)
class SignalParameters:
    """How windows become motion."""

    longest_wavelength: float = 40.0  # m; of longer ones less than half is left
    design: HighPass = HighPass.SMOOTHER
    bridged_samples: int = 3  # gaps up to this long are bridged for the integrals, never used as samples
    modelled_gap_s: float = 0.25  # gaps up to this long do not end a stretch of motion: their integrals are solved for
    gap_margin_s: float = 0.5  # on both sides of a modelled gap, where that takes some of the motion too
    shortest_stretch_s: float = 10.0
    trimmed_s: float = 1.0  # at each end of a stretch, where the high-pass sees one side only
    least_speed_m_s: float = 8.0
    sharpest_curvature: float = 5e-5  # 1/m: shifts the wheelset by a third of a bin at conicity 0.2
    highest_cant: float = 0.02  # m
    curve_margin: float = 30.0  # m kept from sharper curves; positions and registers are off by some
    most_lean: float = 0.1  # m/s2, change of the slow lateral acceleration that drift makes on straight track too
    least_used: float = 0.1  # of a window's samples
    block_s: float = 20.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not isinstance(value, HighPass) and not value >= 0:
                raise ParameterError(f"{value!r} is negative", field=item.name)
        if not self.longest_wavelength > 0:
            raise ParameterError("must be positive", field="longest_wavelength")

    @property
    def source(self) -> str:
        """What a bin table says of where its motion came from."""
        return "band-limited " + " ".join(f"{item.name}={getattr(self, item.name)}" for item in fields(self))

    @property
    def curve_limits(self) -> CurveLimits:
        """What counts as straight."""
        return CurveLimits(self.sharpest_curvature, self.highest_cant, self.curve_margin)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a window was not turned into motion."""

    reason: str


def motion(
    window: Window,
    track: TrackAlignment,
    parameters: SignalParameters,
    layout: TrackLayout | None = None,
    gauge_shift: FloatArray | None = None,
) -> Motion | Refusal:
    """Return the band-limited motion of ``window`` relative to ``track``, or why it cannot be had.

    Parameters
    ----------
    window
        Measured accelerations, speed and distance, (n,) each.
    track
        Alignment of the window's section; samples outside it are passed over. Wavelengths that it does not hold are
        taken out of the motion too.
    parameters
        Cut-off wavelength and gates.
    layout
        Curves of the section, which are passed over; None where none is on file.
    gauge_shift
        (n,) m, by how much the gauge moves the wheelset, NaN where that cannot be said; None where it is not known.
    """
    longest = min(parameters.longest_wavelength, track.cut_off)
    d = _alignment_at(window.distance, track, longest)
    if gauge_shift is not None:
        d += gauge_shift  # it runs as it would at nominal gauge on a track that is aligned so
    limits = parameters.curve_limits
    usable = usable_samples(window, np.isfinite(d), layout, parameters.least_speed_m_s, limits)
    refusal = _unusable(window, usable, layout, parameters)
    if refusal is not None:
        return refusal
    dt = window.sample_interval_s
    runs = stretches(usable.samples, window, parameters, round(parameters.modelled_gap_s / dt))
    signals, valid = _filtered(window, d, usable.samples, runs, replace(parameters, longest_wavelength=longest))
    refusal = _too_little(valid, runs, usable, parameters)
    if refusal is not None:
        return refusal
    seconds = window.start_ns / NANOSECONDS + np.arange(len(valid)) * dt
    block = np.floor(seconds / parameters.block_s).astype(np.int64)
    signals["speed"] = np.where(window.speed > 0, window.speed, np.nan)
    ratio = 1.0 if track.findings is None else track.findings.stiffness_ratio.get(window.vehicle, 1.0)
    return Motion(**signals, valid=valid, block=block, band_limited=True, stiffness_ratio=ratio)


def _unusable(
    window: Window, usable: Usable, layout: TrackLayout | None, parameters: SignalParameters
) -> Refusal | None:
    if not usable.samples.any():
        return Refusal(f"no sample can be used: {usable.causes}")
    felt = felt_curve(window, usable.samples, parameters.most_lean) if layout is None else ""
    return Refusal(felt) if felt else None


def _filtered(
    window: Window, d: FloatArray, usable: BoolArray, runs: list[tuple[int, int]], parameters: SignalParameters
) -> tuple[dict[str, FloatArray], BoolArray]:
    """Return the signals of a motion by name, NaN outside the stretches, and which samples of them count (n,)."""
    n, dt = len(usable), window.sample_interval_s
    signals = {item.name: np.full(n, np.nan) for item in fields(Motion) if item.name not in NOT_SIGNALS}
    valid = np.zeros(n, dtype=np.bool_)
    trim, margin = round(parameters.trimmed_s / dt), round(parameters.gap_margin_s / dt)
    for start, stop in runs:
        part = slice(start, stop)
        known = np.asarray(usable[part])
        fast = without_slow_part(
            _integrated(window, d, known, part),
            distance_run(window, known, part),
            known,
            parameters.longest_wavelength,
            parameters.design,
            parameters.bridged_samples,
        )
        for name, values in zip(_INTEGRATED, fast, strict=True):
            signals[name][part] = values
        valid[start + trim : stop - trim] = usable[start + trim : stop - trim]
        for first, behind in modelled_gaps(known, parameters.bridged_samples):
            valid[max(start + first - margin, 0) : start + behind + margin] = False
    return signals, valid


_INTEGRATED = (
    "displacement",
    "lateral_velocity",
    "lateral_acceleration",
    "yaw",
    "yaw_rate",
    "yaw_acceleration",
    "roll",
    "roll_rate",
    "stretch",
    "stretch_rate",
)


def _too_little(
    valid: BoolArray, runs: list[tuple[int, int]], usable: Usable, parameters: SignalParameters
) -> Refusal | None:
    lost = f"; lost: {usable.causes}" if usable.causes else ""
    if not runs:
        return Refusal(f"no uninterrupted stretch of {parameters.shortest_stretch_s:g} s{lost}")
    if valid.mean() < parameters.least_used:
        return Refusal(f"{valid.mean():.0%} of the samples can be used, {parameters.least_used:.0%} are needed{lost}")
    return None


def _alignment_at(distance: FloatArray, track: TrackAlignment, longest: float) -> FloatArray:
    """Return d (n,) by a cubic spline through the stored alignment; NaN off the section and where it is not known."""
    d = np.full(len(distance), np.nan)
    with np.errstate(invalid="ignore"):
        on_track = np.flatnonzero((distance >= track.s[0]) & (distance <= track.s[-1]))
    if not len(on_track):
        return d
    at = distance[on_track]
    first = max(int(np.searchsorted(track.s, at.min())) - SPLINE_MARGIN, 0)
    last = int(np.searchsorted(track.s, at.max())) + SPLINE_MARGIN
    whole = track.alignment if track.cut_off >= WHOLE * longest else restored(track)
    s, alignment = track.s[first:last], whole[first:last]
    known = np.isfinite(alignment)
    if known.sum() < FEWEST_POINTS:
        return d
    after = np.searchsorted(s, at).clip(1, len(s) - 1)
    between = known[after - 1] & known[after]
    spline = CubicSpline(s[known], alignment[known], extrapolate=False)
    d[on_track[between]] = spline(at[between])
    return d


def stretches(
    usable: BoolArray, window: Window, parameters: SignalParameters, longest_gap: int | None = None
) -> list[tuple[int, int]]:
    """Return the runs of usable samples with only short gaps in them, long enough to be worth it.

    Parameters
    ----------
    usable
        (n,).
    window
        Its sampling interval is used.
    parameters
        Gates.
    longest_gap
        Samples that may be missing in a row; by default as many as may be bridged.
    """
    gap = parameters.bridged_samples if longest_gap is None else longest_gap
    index = np.flatnonzero(usable)
    breaks = np.flatnonzero(np.diff(index) > gap + 1)
    starts = np.concatenate([index[:1], index[breaks + 1]])
    stops = np.concatenate([index[breaks], index[-1:]]) + 1
    least = parameters.shortest_stretch_s / window.sample_interval_s
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if b - a >= least]


def _integrated(window: Window, d: FloatArray, known: BoolArray, part: slice) -> FloatArray:
    """Return accelerations, rates and displacements (10, n) of one stretch in the order of ``_INTEGRATED``."""
    accelerations, rates, displacements = running_integrals(window, known, part)
    y, ψ, φ, ym = displacements
    dy, dψ, dφ, dym = rates
    ddy, ddψ = accelerations[:2]
    along = _bridged(d[part], np.isfinite(d[part]))
    return np.stack([y - along, dy, ddy, ψ, dψ, ddψ, φ, dφ, ym - y, dym - dy])


def running_integrals(window: Window, known: BoolArray, part: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return accelerations, rates and displacements (4, n) each, in the order of ``ACCELERATIONS``, of one stretch.

    Means, and straight lines of the rates, are taken out on the way, so that what still wanders is small; the slow
    part of the result carries no meaning.

    Parameters
    ----------
    window
        Measured accelerations.
    known
        (n,) where samples of the stretch are usable; others are bridged by straight lines.
    part
        The stretch.
    """
    dt = window.sample_interval_s
    t = np.arange(part.stop - part.start)
    accelerations = np.stack([_bridged(getattr(window, name)[part], known) for name in ACCELERATIONS])
    accelerations -= accelerations.mean(axis=1, keepdims=True)
    rates = _running_integral(accelerations, dt)
    centred = t - t.mean()
    rates -= rates.mean(axis=1, keepdims=True) + np.outer(rates @ centred / (centred @ centred), centred)
    return accelerations, rates, _running_integral(rates, dt)


def _bridged(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return ``values`` with straight lines across the samples that are not known."""
    if known.all():
        return values
    t = np.arange(len(values))
    return np.interp(t, t[known], values[known])


def _running_integral(values: FloatArray, dt: float) -> FloatArray:
    """Trapezoidal running integral along the last axis, starting at zero."""
    result = np.zeros_like(values)
    np.cumsum(0.5 * dt * (values[:, 1:] + values[:, :-1]), axis=1, out=result[:, 1:])
    return result


def distance_run(window: Window, known: BoolArray, part: slice) -> FloatArray:
    """Distance run in the stretch, (n,) m, ascending from zero; where a sample is missing, interpolated."""
    speed = _bridged(window.speed[part], known)
    return np.asarray(_running_integral(speed[None, :], window.sample_interval_s)[0])
