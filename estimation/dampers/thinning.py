"""The low-pass that accelerations get before the filters, and how they are thinned out.

What bodies and bogie frames do as stiff bodies is below some 8 Hz, and the vibration of axle boxes above. Wheelsets and
what is above them get the same filter, which the equations do not notice.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from estimation.values.arrays import FloatArray, frozen_array

PASSED_HZ, STOPPED_HZ, STOPPED_DB = 5.0, 8.0, 70.0
STEP_S = 0.016  # between the samples that the filters take


def stride_of(sample_interval_s: float) -> int:
    """Return of how many samples one is kept."""
    return max(round(STEP_S / sample_interval_s), 1)


@lru_cache(maxsize=4)
def low_pass(sample_interval_s: float) -> FloatArray:
    """Return the taps (k,) of the low-pass, odd in number and symmetric."""
    from scipy.signal import firwin, kaiserord  # noqa: PLC0415 - slow to import, and few need it

    count, beta = kaiserord(STOPPED_DB, 2.0 * sample_interval_s * (STOPPED_HZ - PASSED_HZ))
    corner = 0.5 * (PASSED_HZ + STOPPED_HZ)
    taps = firwin(count | 1, corner, window=("kaiser", beta), fs=1.0 / sample_interval_s)
    return frozen_array(taps, (None,), name="taps")


def thinned(values: FloatArray, sample_interval_s: float) -> FloatArray:
    """Return the low-passed samples (s,) at which the filter sees measured values alone.

    Args:
        values: (n,) as measured.
    """
    from scipy.signal import oaconvolve  # noqa: PLC0415 - slow to import, and few need it

    passed = oaconvolve(values, low_pass(sample_interval_s), mode="valid")
    return np.asarray(passed[:: stride_of(sample_interval_s)])


def between_samples(values: FloatArray) -> FloatArray:
    """Return what, run straight from sample to sample, is the signal (s,): a straight line takes (pi f dt)^2/3 of it.

    Args:
        values: (s,) of the signal.
    """
    raised = values.copy()
    raised[1:-1] -= np.diff(values, 2) / 12.0
    return raised
