"""How far a worn wheelset moves: it runs over a piece of irregular track by its kinematic equations.

With x the lateral displacement relative to the track, d its alignment and s the distance::

    dx/ds = psi - dd/ds,        dpsi/ds = -R(x) / (2 l r0) - kappa psi

``kappa`` is the yaw spring over creep. What a wheelset covers follows from its own curve: a steep one holds it in the
middle, a flat one lets it run out to where the curve rises. Every wheelset here runs on the same track, more or less
irregular.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from bench.worn_family import DISPLACEMENT
from estimation.values.arrays import FloatArray

LENGTH, STEP, STARTS = 3000.0, 0.1, 200.0  # m
WAVES = (3.0, 60.0)  # m
TWICE_L_R0 = 2.0 * 0.7452 * 0.45  # m2
BEYOND = 0.0025  # of the running is beyond the amplitude that is covered, on either side


def amplitude_reached(curves: FloatArray, irregularity: FloatArray, kappa: FloatArray, seed: int) -> FloatArray:
    """Return the amplitude (m,), m, that each wheelset covers.

    Args:
        curves: (m, n) m, rolling radius difference at ``DISPLACEMENT``.
        irregularity: (m,) m, standard deviation of the alignment.
        kappa: (m,) 1/m.
    """
    slope = _alignment_slope(seed)
    x, yaw, travelled = np.zeros(len(curves)), np.zeros(len(curves)), []
    first, spacing, flat = DISPLACEMENT[0], DISPLACEMENT[1] - DISPLACEMENT[0], curves.ravel()
    begin = curves.shape[1] * np.arange(len(curves))
    for change in slope:
        x = np.clip(x + STEP * (yaw - irregularity * change), 0.99 * first, -0.99 * first)
        place = (x - first) / spacing
        node = place.astype(np.int64)
        share = place - node
        radius = (1.0 - share) * flat[begin + node] + share * flat[begin + node + 1]
        yaw = yaw - STEP * (radius / TWICE_L_R0 + kappa * yaw)
        travelled.append(x.astype(np.float32))
    low, high = np.quantile(np.array(travelled)[int(STARTS / STEP) :], [BEYOND, 1.0 - BEYOND], axis=0)
    return np.asarray(np.minimum(-low, high), dtype=np.float64)


def _alignment_slope(seed: int) -> FloatArray:
    """Return the slope of an alignment of unit standard deviation at every step."""
    band = butter(2, [2.0 * STEP / wave for wave in reversed(WAVES)], "band", output="sos")
    noise = np.random.default_rng(seed).standard_normal(round(LENGTH / STEP))
    alignment = sosfiltfilt(band, np.cumsum(sosfiltfilt(band, noise)))
    return np.asarray(np.gradient(alignment / alignment.std(), STEP))
