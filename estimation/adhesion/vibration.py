"""Axle boxes that vibrate: accelerations without what is faster than wheelsets move under them.

An axle box vibrates at tens of hertz, many times as strongly as its wheelset moves there. To the filter that would be a
wheelset that does not follow its class. Where lateral accelerations hold more above the band of the forces than contact
jumps put there, all accelerations of the running gear are low-passed, with no shift in time.
"""

from __future__ import annotations

import numpy as np
import scipy.signal

from estimation.values.arrays import BoolArray, FloatArray

BAND_HZ = 12.0
"""End of the band that is kept."""
VIBRATING = 0.25
"""Rms of what a lateral acceleration has above the band, m/s2: more than contact jumps make."""
HALF_LENGTH_S = 0.12
"""Of the low-pass, on each side."""


def without_vibration(
    accelerations: FloatArray, known: BoolArray, sample_interval_s: float, lateral: slice
) -> tuple[FloatArray, bool]:
    """Return accelerations of a running gear, low-passed where its axle boxes vibrate, and whether they do.

    Args:
        accelerations: (k, n) without means, 0 where not known; m/s2 and rad/s2.
        known: (n,) samples that were measured.
        sample_interval_s: Between samples, s.
    """
    rate = 1.0 / sample_interval_s
    weights = scipy.signal.firwin(2 * round(HALF_LENGTH_S * rate) + 1, BAND_HZ, fs=rate)
    smooth = scipy.signal.fftconvolve(accelerations, weights[None], mode="same", axes=1)
    rest = (accelerations - smooth)[lateral][:, known]
    if float(np.sqrt(np.mean(rest**2, axis=1)).max()) <= VIBRATING:
        return accelerations, False
    return np.where(known, smooth, 0.0), True
