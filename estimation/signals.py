"""From measured accelerations to band-limited motion relative to the track.

Rates and displacements are running integrals of the accelerations. Offsets and drift make them wander; so from every
signal the part that varies slowly *along the track* is projected out: the least-squares fit of cosines in distance
down to the cut-off wavelength, and of a straight line and a parabola in time. The projection is linear, idempotent,
takes stretches of any length and speed, and is applied once to each side that is compared (y - d as a whole), so that
it favours neither.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve

from estimation.arrays import BoolArray, FloatArray
from estimation.errors import ParameterError
from estimation.motion import Motion
from estimation.types import ACCELERATIONS, TrackAlignment, Window

NANOSECONDS = 1_000_000_000
SPLINE_MARGIN = 20  # points of the stored alignment beyond the window, so that the spline's ends do not matter


@dataclass(frozen=True, slots=True)
class SignalParameters:
    """How windows become motion."""

    longest_wavelength: float = 60.0  # m; longer is projected out
    bridged_samples: int = 3  # gaps up to this long are bridged for the integrals, never used as samples
    shortest_stretch_s: float = 10.0
    trimmed_s: float = 1.0  # at each end of a stretch, where the projection sees one side only
    least_speed_m_s: float = 5.0
    block_s: float = 20.0

    def __post_init__(self) -> None:
        for item in fields(self):
            if not getattr(self, item.name) >= 0:
                raise ParameterError(f"{getattr(self, item.name)!r} is negative", field=item.name)

    @property
    def source(self) -> str:
        """What a bin table says of where its motion came from."""
        return "band-limited " + " ".join(f"{item.name}={getattr(self, item.name)}" for item in fields(self))


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a window was not turned into motion."""

    reason: str


def motion(window: Window, track: TrackAlignment, parameters: SignalParameters) -> Motion | Refusal:
    """Return the band-limited motion of ``window`` relative to ``track``, or why it cannot be had.

    Parameters
    ----------
    window
        Measured accelerations, speed and distance, (n,) each.
    track
        Alignment of the window's section; samples outside it are passed over.
    parameters
        Cut-off wavelength and gates.
    """
    usable = _usable(window, track, parameters)
    if usable is None:
        return Refusal("no sample on the known part of the section above the least speed")
    runs = stretches(usable, window, parameters)
    if not runs:
        return Refusal(f"no uninterrupted stretch of {parameters.shortest_stretch_s:g} s")
    d = _alignment_at(window.distance, track, usable)
    n = len(window.valid)
    signals = {item.name: np.full(n, np.nan) for item in fields(Motion) if item.name not in _NOT_SIGNALS}
    valid = np.zeros(n, dtype=np.bool_)
    for start, stop in runs:
        for name, values in _integrate(window, d, usable, slice(start, stop), parameters).items():
            signals[name][start:stop] = values
        trim = round(parameters.trimmed_s / window.sample_interval_s)
        valid[start + trim : stop - trim] = usable[start + trim : stop - trim]
    seconds = window.start_ns / NANOSECONDS + np.arange(n) * window.sample_interval_s
    block = np.floor(seconds / parameters.block_s).astype(np.int64)
    signals["speed"] = np.where(window.speed > 0, window.speed, np.nan)
    return Motion(**signals, valid=valid, block=block, band_limited=True)


_NOT_SIGNALS = frozenset({"valid", "block", "band_limited"})


def _usable(window: Window, track: TrackAlignment, parameters: SignalParameters) -> BoolArray | None:
    with np.errstate(invalid="ignore"):
        on_track = (window.distance >= track.s[0]) & (window.distance <= track.s[-1])
        moving = window.speed >= parameters.least_speed_m_s
    usable = window.valid & on_track & moving
    return np.asarray(usable) if usable.any() else None


def _alignment_at(distance: FloatArray, track: TrackAlignment, usable: BoolArray) -> FloatArray:
    """Return d (n,) by a cubic spline through the stored alignment where the window runs; NaN off the section."""
    seen = distance[usable]
    first = max(int(np.searchsorted(track.s, seen.min())) - SPLINE_MARGIN, 0)
    last = int(np.searchsorted(track.s, seen.max())) + SPLINE_MARGIN
    part = slice(first, last)
    return np.asarray(CubicSpline(track.s[part], track.alignment[part], extrapolate=False)(distance))


def stretches(usable: BoolArray, window: Window, parameters: SignalParameters) -> list[tuple[int, int]]:
    """Return the runs of usable samples with only short gaps in them, long enough to be worth it."""
    index = np.flatnonzero(usable)
    breaks = np.flatnonzero(np.diff(index) > parameters.bridged_samples + 1)
    starts = np.concatenate([index[:1], index[breaks + 1]])
    stops = np.concatenate([index[breaks], index[-1:]]) + 1
    least = parameters.shortest_stretch_s / window.sample_interval_s
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if b - a >= least]


def _integrate(
    window: Window, d: FloatArray, usable: BoolArray, part: slice, parameters: SignalParameters
) -> dict[str, FloatArray]:
    """Rates and displacements of one stretch, slow parts projected out."""
    known = usable[part]
    accelerations, rates, displacements = running_integrals(window, known, part)
    y, ψ, φ, ym = displacements
    dy, dψ, dφ, dym = rates
    ddy, ddψ = accelerations[:2]
    raw = np.stack([y - _bridged(d[part], np.isfinite(d[part])), dy, ddy, ψ, dψ, ddψ, φ, dφ, ym - y, dym - dy])
    names = (
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
    fast = _without_slow_part(raw, _distance(window, known, part), parameters.longest_wavelength)
    return dict(zip(names, fast, strict=True))


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


def _distance(window: Window, known: BoolArray, part: slice) -> FloatArray:
    """Distance run in the stretch, (n,) m, ascending from zero; where a sample is missing, interpolated."""
    speed = _bridged(window.speed[part], known)
    return np.asarray(_running_integral(speed[None, :], window.sample_interval_s)[0])


def _without_slow_part(signals: FloatArray, distance: FloatArray, longest: float) -> FloatArray:
    """Project out cosines in distance of wavelengths above ``longest``, a line and a parabola in time.

    Parameters
    ----------
    signals
        (m, n).
    distance
        (n,) m, from zero.
    longest
        Cut-off wavelength, m.
    """
    basis = slow_basis(distance, longest)
    gram = basis @ basis.T
    gram[np.diag_indices_from(gram)] *= 1 + 1e-12  # cosines and parabola are nearly dependent in short stretches
    return np.asarray(signals - cho_solve(cho_factor(gram), basis @ signals.T).T @ basis)


def slow_basis(distance: FloatArray, longest: float) -> FloatArray:
    """Return (k, n) functions that span what varies more slowly than ``longest``, orthogonal to rounding or nearly."""
    n = len(distance)
    length = float(distance[-1])
    terms = int(2 * length / longest)
    t = np.linspace(-1.0, 1.0, n)
    basis = np.empty((terms + 3, n))
    basis[0] = 1.0
    first = np.cos(np.pi * distance / length)
    if terms:
        basis[1] = first
    for k in range(2, terms + 1):
        basis[k] = 2 * first * basis[k - 1] - basis[k - 2]  # Chebyshev: cos(k x)
    basis[terms + 1] = t
    basis[terms + 2] = 1.5 * t * t - 0.5
    return basis
