"""Creepage beyond the linear one after Vermeulen and Johnson, and its sums, in plain numpy."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray


def creep_excess(utilisation: FloatArray) -> FloatArray:
    """Return linear over true creep force less 1, of any shape."""
    t = np.clip(utilisation, 1e-6, 0.98)
    return np.asarray(3.0 * (1.0 - np.cbrt(1.0 - t)) / t - 1.0)


def saturated_sums(
    signals: FloatArray, forces: FloatArray, place: IntArray, bounds: FloatArray, places: int
) -> FloatArray:
    """Return the sums (c, 4, k) of g e, g g, g q and g x."""
    e, q, x = signals
    along, lateral, spin = forces
    found = np.zeros((places, 4, len(bounds)))
    for k, bound in enumerate(bounds):
        excess = np.zeros(len(e))
        for _ in range(3):
            own = spin / (1.0 + excess)
            wheels = np.hypot(along, np.stack([lateral + own, lateral - own]))
            excess = creep_excess(wheels / bound).mean(axis=0)
        g = q * excess
        for row, other in enumerate((e, g, q, x)):
            found[:, row, k] = np.bincount(place, g * other, places)
    return found
