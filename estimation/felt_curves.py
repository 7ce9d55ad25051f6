"""Curves felt where no layout is on file: on straight track an axlebox does not lean.

In a curve the lateral accelerometers of wheelset and mass feel V^2 kappa - g theta, the acceleration that the cant
leaves uncompensated. An offset of the sensor looks the same, but does not change within a minute. What cannot be felt:
a window that lies in one curve as a whole, and a curve whose cant is that of the speed.
"""

from __future__ import annotations

import numpy as np

from estimation.arrays import BoolArray
from estimation.types import Window

MEAN_S = 5.0  # over which the motion of the wheelset averages out
LEAST_SHARE = 0.5  # of the samples that a mean needs


def felt_curve(window: Window, usable: BoolArray, most_lean: float) -> str:
    """Return that a curve is felt; empty where the lean (:func:`lean`) changes by no more than ``most_lean``, m/s2."""
    leaning = lean(window, usable)
    if leaning <= most_lean:
        return ""
    return (
        f"a curve is felt and no layout is on file: the slow lateral acceleration changes by {leaning:.2f} m/s2,"
        f" at most {most_lean:g} may be drift"
    )


def lean(window: Window, usable: BoolArray) -> float:
    """Return by how much the slow lateral acceleration of wheelset and mass together changes in a window, m/s2.

    Parameters
    ----------
    window
        Measured accelerations.
    usable
        (n,) samples that count.
    """
    size = round(MEAN_S / window.sample_interval_s)
    count = len(usable) // size
    known = usable[: count * size].reshape(count, size)
    felt = 0.5 * (window.lateral_acceleration + window.mass_lateral_acceleration)[: count * size].reshape(count, size)
    enough = known.mean(axis=1) >= LEAST_SHARE
    if not enough.any():
        return 0.0
    means = np.where(known, felt, 0.0).sum(axis=1)[enough] / known.sum(axis=1)[enough]
    return float(np.ptp(means))
