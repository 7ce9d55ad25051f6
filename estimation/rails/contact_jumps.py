"""Where the wheel as designed is next to a contact jump: nothing follows for it there from worn wheels.

At a jump the conicity changes steeply over the amplitude, and another gauge or wear of the rails moves the jump over
the amplitude, which is no matter of adding a number. On the rails as on file the curve is known exactly, and any steep
change counts. As found on worn rails a rise counts: where the motion begins to reach a jump, the conicity rises within
a fraction of a millimetre; behind it it falls as the inverse of the amplitude, and that of worn wheels falls likewise.
"""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray

WITHIN = 0.25e-3  # m of amplitude
SAME_AMPLITUDE = 1e-9  # m


def next_to_jump(curve: FloatArray, amplitude: FloatArray, most: float) -> BoolArray:
    """Return where (k,) a conicity changes by more than ``most`` within 0.25 mm of amplitude, to either side.

    Args:
        curve: (k,) conicity; NaN where it is not known.
        amplitude: (k,) m, increasing.
    """
    return np.asarray((np.abs(_changes(curve, amplitude)) > most).any(axis=1))


def on_rise(curve: FloatArray, amplitude: FloatArray, most: float) -> BoolArray:
    """Return where (k,) a conicity rises by more than ``most`` within 0.25 mm of amplitude, before or behind."""
    return np.asarray((_changes(curve, amplitude) > most).any(axis=1))


def _changes(curve: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return by how much (k, k) the conicity grows from the smaller to the larger of two amplitudes that are near."""
    apart = amplitude[:, None] - amplitude[None, :]
    near = np.abs(apart) <= WITHIN + SAME_AMPLITUDE
    grown = np.sign(apart) * (curve[:, None] - curve[None, :])
    return np.where(near & np.isfinite(grown), grown, 0.0)
