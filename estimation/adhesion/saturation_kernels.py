"""By how much creepage exceeds the linear one at a force, of every sample at every friction, compiled.

The law is that of Vermeulen and Johnson (1964), solved for the creepage. With t = T/(mu N), T the resultant creep force
of a wheel and N its normal force, t = 1 - (1 - u/3)^3 gives the linear force that would act at the same creepage,
u mu N = 3 (1 - (1 - t)^(1/3)) mu N. To first order it exceeds T by t/3 of it.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, IntArray, frozen_array

SHARE_ROUNDS = 3  # of spin and saturation, each of which decides on the other
MOST_UTILISATION = 0.98  # near 1 the creepage is beyond all bounds
LEAST_UTILISATION = 1e-6
STEPS = 4096  # of the table of excesses


@cache
def excess_table() -> FloatArray:
    """Return linear over true creep force of a wheel less 1 at T/(mu N) from 0 to 0.98 in equal steps, (4097,).

    It is 0 without slip. Between the points it is taken as linear, which misses it by less than 1e-5.
    """
    t = np.maximum(np.linspace(0.0, MOST_UTILISATION, STEPS + 1), LEAST_UTILISATION)
    return frozen_array(3.0 * (1.0 - np.cbrt(1.0 - t)) / t - 1.0, (STEPS + 1,), name="excess")


@compiled(nogil=True)
def excess_at(table: FloatArray, utilisation: float) -> float:
    """Return linear over true creep force of a wheel less 1.

    Args:
        table: (4097,) of :func:`excess_table`.
        utilisation: T/(mu N), not negative; of more than 0.98 the excess at 0.98.
    """
    at = min(utilisation / MOST_UTILISATION, 1.0) * STEPS
    below = min(int(at), STEPS - 1)
    return float(table[below] + (at - below) * (table[below + 1] - table[below]))


@compiled(nogil=True)
def add_saturated(
    table: FloatArray,
    signals: FloatArray,
    forces: FloatArray,
    place: IntArray,
    bounds: FloatArray,
    saturated: FloatArray,
) -> None:
    """Add the sums of g e, g g, g q and g x, g = q times the mean excess of both wheels, to each place and friction.

    Args:
        table: (4097,) of :func:`excess_table`.
        signals: (3, n) e, q and x.
        forces: (3, n) of a wheel: longitudinal and lateral creep force without spin, and the linear lateral force of
            spin, which is the other way round on the right wheel.
        place: (n,) index of the place.
        bounds: (k,) mu N.
        saturated: (c, 4, k) changed.
    """
    for i in range(len(place)):
        e, q, x = signals[0, i], signals[1, i], signals[2, i]
        along, lateral, spin = forces[0, i], forces[1, i], forces[2, i]
        sums = saturated[place[i]]
        for k in range(len(bounds)):
            excess = 0.0
            for _ in range(SHARE_ROUNDS):
                own = spin / (1.0 + excess)
                left = math.sqrt(along * along + (lateral + own) * (lateral + own))
                right = math.sqrt(along * along + (lateral - own) * (lateral - own))
                excess = 0.5 * (excess_at(table, left / bounds[k]) + excess_at(table, right / bounds[k]))
            g = q * excess
            sums[0, k] += g * e
            sums[1, k] += g * g
            sums[2, k] += g * q
            sums[3, k] += g * x
