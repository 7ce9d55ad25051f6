"""The track along a window: its alignment, and by how much its gauge moves the wheelset.

An alignment that has lost its long wavelengths is deconvolved before it is looked up.

What a fleet finds is F d, the alignment d behind the filter F of ``estimation.filters.local_cubic``. The motion needs
G (y - d) with a filter G of its own, and G (y - F d) would leave G (1 - F) d: a quarter of d at the cut-off.
So F is undone as far as G can bear it: G falls faster than F towards long wavelengths, and what is multiplied by up to
1/(2 e) here comes out of G smaller than it went in.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import fft

from estimation.filters.local_cubic import local_cubic_kernel
from estimation.filters.smoothing_spline import remove_wander
from estimation.motion.fusion_parameters import FusionParameters
from estimation.motion.integration import IntegratedWindow, integrate
from estimation.motion.parameters import SignalParameters
from estimation.motion.rolling_radius_difference import fuse, motion_signals
from estimation.motion.spline_lookup import SampledCurve, at_places
from estimation.values.arrays import FloatArray, frozen_array, runs
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.equations_of_motion import VehicleParameters

FULL_BAND_FACTOR = 2.0  # times the wavelength that is looked at: an alignment that reaches further holds it unchanged

TRACKS = 16  # sections whose deconvolved alignment is kept: every window of a section needs it


def alignment_at(distance: FloatArray, track: TrackAlignment, cutoff_wavelength: float) -> FloatArray:
    """Return d (n,), m, by a cubic spline through the stored alignment; NaN off the section and where it is not known.

    Args:
        distance: (n,) m along the section; NaN where not known.
        cutoff_wavelength: m, of the high-pass that the motion goes through.
    """
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
    with np.errstate(invalid="ignore"):
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
    """Return by how much the gauge moves the wheelset (n,), m, NaN where that is not known.

    None where nothing is known of it: on constant gauge, or of a wheelset of which the section has no findings.

    Args:
        window: In the axes of the wheelset, at true positions.
        track: Alignment with the gauge deviation and what was found of wheelsets.
        vehicle: Parameters of Eq. 1 and Eq. 2, which turn motion into rL - rR.
        earlier: The same accelerations and speeds, integrated before.
    """
    table = None if track.findings is None else track.findings.gauge_shifts.get(window.wheelset)
    if track.findings is None or table is None:
        return None
    fusion = FusionParameters()
    ends = fusion.step * (len(local_cubic_kernel(fusion.crossover, fusion.step)) // 2)
    more = track.findings.stiffness_ratio.get(window.vehicle, 1.0) - 1.0
    e = np.interp(window.distance, track.s, track.gauge_deviation, left=np.nan, right=np.nan)
    shift = np.full(len(window.valid), np.nan)
    with np.errstate(invalid="ignore"):
        usable = np.asarray(window.valid & np.isfinite(e) & (window.speed >= parameters.least_speed_m_s))
    for segment in integrate(window, usable, parameters, earlier=earlier).segments:
        part, run = segment.part, segment.run
        grid = fuse(motion_signals(segment, vehicle), vehicle, fusion)
        certain = (grid.run >= grid.run[0] + ends) & (grid.run <= grid.run[-1] - ends)
        if not certain.any():
            continue
        whole = (grid.difference + more * grid.stiffness_term)[None, :]
        (fast,) = remove_wander(np.where(certain, whole, 0.0), grid.run - grid.run[0], certain, CUTOFF_WAVELENGTH)
        known = segment.known & (run >= grid.run[0] + ends) & (run <= grid.run[-1] - ends)
        shift[part][known] = table.at(np.interp(run[known], grid.run, fast), e[part][known])
    return shift
