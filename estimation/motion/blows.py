"""Blows: accelerations of an axle box that rise and fall within some ms, as no wheelset moves.

A wheel with a flat, a joint or a switch strikes the axle box, which rings. The lateral and the roll acceleration show
it by far more than the motion of a wheelset has there; yaw does not, for a wheelset that passes a contact jump turns
as suddenly. What rings is no motion.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, median_filter, uniform_filter1d

from estimation.values.arrays import BoolArray, FloatArray

SLOW_S = 0.05  # running mean over this is motion
RINGING_S = 0.1  # running median over this is motion even where a blow rings
SCALE_S = 2.0  # over which vibration is judged
LEAST_BLOW = 8.0  # m/s2 and rad/s2; right wheelsets on smooth track stay below 3, flange contact below 6
LEAST_STDS = 6.0  # of the vibration
TAIL = 0.12  # of the largest nearby: what still rings
TAIL_STDS = 3.0
REACH_S = 0.04  # on both sides of a blow, in which it may ring
GUARD_S = 0.004  # on both sides of what rings
SAID_BY_MEDIAN = 0.6745  # median of the magnitude of a normal signal over its std


def sharp(signals: FloatArray, interval_s: float) -> FloatArray:
    """Return signals (m, n), NaN where not known, less their running mean; there 0."""
    known = np.isfinite(signals)
    width = max(round(SLOW_S / interval_s), 3) | 1
    filled = np.where(known, signals, 0.0)
    share = uniform_filter1d(known.astype(np.float64), width, axis=1, mode="nearest")
    means = uniform_filter1d(filled, width, axis=1, mode="nearest") / np.maximum(share, 1.0 / width)
    return np.where(known, filled - means, 0.0)


def vibration(sharp_signals: FloatArray, interval_s: float) -> FloatArray:
    """Return the standard deviation (m, n) of what is sharp, blows apart: by the median of some seconds."""
    size = min(max(round(SCALE_S / interval_s), 1), sharp_signals.shape[1])
    count = max(sharp_signals.shape[1] // size, 1)
    blocks = np.abs(sharp_signals[:, : count * size]).reshape(len(sharp_signals), count, size)
    stds = np.median(blocks, axis=2) / SAID_BY_MEDIAN
    block = np.minimum(np.arange(sharp_signals.shape[1]) // size, count - 1)
    return np.asarray(stds[:, block])


def struck(lateral: FloatArray, roll: FloatArray, interval_s: float, lost: BoolArray | None = None) -> BoolArray:
    """Return which samples (n,) a blow has spoilt, from its begin until it has died down.

    Args:
        lateral, roll: (n,) m/s2 and rad/s2; NaN where not known.
        lost: (n,) samples that clipped in blows, near which it rings too; None for none.
    """
    both = np.stack([lateral, roll])
    lost = np.zeros(len(lateral), np.bool_) if lost is None else lost
    if not (lost.any() or np.nanmax(np.abs(both), initial=0.0) > LEAST_BLOW):
        return lost
    fast = np.abs(sharp(both, interval_s))
    std = vibration(fast, interval_s)
    found = lost.copy()
    reach = max(round(REACH_S / interval_s), 1)
    for signal, values, noise in zip(both, fast, std, strict=True):
        blows = values > np.maximum(LEAST_BLOW, LEAST_STDS * noise)
        if not (blows | lost).any():
            continue
        near = binary_dilation(blows | lost, iterations=reach)
        motion = median_filter(np.nan_to_num(signal), round(RINGING_S / interval_s) | 1)
        rest = np.abs(np.nan_to_num(signal) - motion)
        size = float(np.median(values[blows])) if blows.any() else LEAST_BLOW
        rings = near & (rest > np.maximum(TAIL_STDS * noise, TAIL * size))
        found |= binary_closing(rings | blows | lost, iterations=2)
    return np.asarray(binary_dilation(found, iterations=max(round(GUARD_S / interval_s), 1)) if found.any() else found)
