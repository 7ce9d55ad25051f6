"""The track along a window: its alignment, and by how much its gauge moves the wheelset.

An alignment that has lost its long wavelengths is deconvolved before it is looked up.

What a fleet finds is F d, the alignment d behind the filter F of ``estimation.filters``. The motion needs
G (y - d) with a filter G of its own, and G (y - F d) would leave G (1 - F) d: a quarter of d at the cut-off.
So F is undone as far as G can bear it: G falls faster than F towards long wavelengths, and what is multiplied by up to
1/(2 e) here comes out of G smaller than it went in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline

from estimation.compiled import compiled
from estimation.filters import local_cubic_kernel, remove_wander
from estimation.motion.checks import fast_enough
from estimation.motion.integration import IntegratedWindow, SignalParameters, integrate
from estimation.motion.rolling_radius_difference import CROSSOVER, STEP, fuse, motion_signals
from estimation.values.arrays import FloatArray, frozen_array, runs
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleParameters

FEWEST_POINTS = 4  # of a spline
POINTS = 512  # of the alignment in a piece
SPLINE_MARGIN = 20  # points beyond a piece, so that the ends of its spline do not matter
PIECES = 256  # that are kept, 16 kB each


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
    first = min(max(int(np.searchsorted(curve.s, low)) - 1, 0), last_point - 1) // POINTS
    last = max(min(int(np.searchsorted(curve.s, high)), last_point) - 1, 0) // POINTS
    pieces = [_piece(curve, number) for number in range(first, last + 1)]
    coefficients = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
    s = curve.s[first * POINTS : first * POINTS + len(coefficients) + 1]
    if len(coefficients):
        places, coefficients = (frozen_array(one, one.shape, name="places") for one in (places, coefficients))
        evaluate(places, s, coefficients, found)
    return found


@lru_cache(maxsize=PIECES)
def _piece(curve: SampledCurve, number: int) -> FloatArray:
    """Return the coefficients (m, 4) of the spline between the points of a piece, highest power first.

    NaN where one of both points is not known.
    """
    begin, end = number * POINTS, min((number + 1) * POINTS, len(curve.s) - 1)
    first = max(begin - SPLINE_MARGIN, 0)
    values = curve.values[first : end + 1 + SPLINE_MARGIN]
    known = first + np.flatnonzero(np.isfinite(values))
    coefficients = np.full((max(end - begin, 0), 4), np.nan)
    if len(known) >= FEWEST_POINTS:
        spline = CubicSpline(curve.s[known], curve.values[known])
        beside = np.flatnonzero((np.diff(known) == 1) & (known[:-1] >= begin) & (known[:-1] < end))
        coefficients[known[beside] - begin] = spline.c[:, beside].T
    return frozen_array(coefficients, (None, 4), name="coefficients")


@compiled(nogil=True)
def evaluate(places: FloatArray, s: FloatArray, coefficients: FloatArray, found: FloatArray) -> None:
    """Write the spline at places on the grid (m,); a place on a point of it belongs to the interval before.

    Args:
        s, coefficients: (m,) m, uniform, and (m - 1, 4) between its points.
        found: (n,); what is off the grid stays as it is.
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


FULL_BAND_FACTOR = 2.0  # times the wavelength that is looked at: an alignment that reaches further holds it unchanged

TRACKS = 16  # sections whose deconvolved alignment is kept: every window of a section needs it


def alignment_at(distance: FloatArray, track: TrackAlignment, cutoff_wavelength: float) -> FloatArray:
    """Return d (n,), m, by a cubic spline through the stored alignment; NaN off the section and where not known."""
    as_it_is = track.cutoff_wavelength >= FULL_BAND_FACTOR * cutoff_wavelength
    return at_places(_curve(track, as_it_is=as_it_is), distance)


@lru_cache(maxsize=2 * TRACKS)
def _curve(track: TrackAlignment, *, as_it_is: bool) -> SampledCurve:
    return SampledCurve(track.s, _certain(track) if as_it_is else deconvolved(track))


UNCERTAIN_STD = 0.25e-3  # m, of an alignment at a place from which on it is left out, where most of it is far better:
UNCERTAIN_TIMES = 3.0  # times the median


def _certain(track: TrackAlignment) -> FloatArray:
    """Return the alignment (n,), m, NaN where it is far less certain than elsewhere: it would blur what the rest shows.

    So it is at the places of a survey that no pass has made better.
    """
    if not (track.passes > 0).any():
        return track.alignment
    most = max(UNCERTAIN_STD, UNCERTAIN_TIMES * float(np.nanmedian(track.alignment_std)))
    certain = np.where(track.alignment_std <= most, track.alignment, np.nan)
    return frozen_array(certain, (len(certain),), name="alignment")


REGULARISATION = 0.03  # e: where F leaves less than about this, less is undone


@lru_cache(maxsize=TRACKS)
def deconvolved(track: TrackAlignment) -> FloatArray:
    """Return the alignment (n,), m, with F undone; as it is where the track has no cut-off. NaN stays NaN.

    Within a cut-off of a place that is not known nothing can be undone well: NaN too.
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
    inverse = left / (left**2 + REGULARISATION**2)
    return np.asarray(fft.irfft(fft.rfft(filtered, size) * inverse, size)[:n])


CUTOFF_WAVELENGTH = 120.0  # m, wavelength of rL - rR; what is longer is small: -2 l r0 d''


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
    ends = STEP * (len(local_cubic_kernel(CROSSOVER, STEP)) // 2)
    more = track.findings.stiffness_ratio.get(window.vehicle, 1.0) - 1.0
    e = np.interp(window.distance, track.s, track.gauge_deviation, left=np.nan, right=np.nan)
    shift = np.full(len(window.valid), np.nan)
    usable = window.valid & np.isfinite(e) & fast_enough(window, parameters)
    for segment in integrate(window, usable, parameters, earlier=earlier).segments:
        part, run = segment.part, segment.run
        grid = fuse(motion_signals(segment, vehicle), vehicle)
        certain = (grid.run >= grid.run[0] + ends) & (grid.run <= grid.run[-1] - ends)
        if not certain.any():
            continue
        whole = (grid.difference + more * grid.stiffness_term)[None, :]
        (fast,) = remove_wander(np.where(certain, whole, 0.0), grid.run - grid.run[0], certain, CUTOFF_WAVELENGTH)
        known = segment.known & (run >= grid.run[0] + ends) & (run <= grid.run[-1] - ends)
        shift[part][known] = table.at(np.interp(run[known], grid.run, fast), e[part][known])
    return shift
