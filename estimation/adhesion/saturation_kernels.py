"""By how much creepage exceeds the linear one at a force, of every sample at every friction, compiled.

The law is that of Vermeulen and Johnson (1964), solved for the creepage. With t = T/(mu N), T the resultant creep force
of a wheel and N its normal force, t = 1 - (1 - u/3)^3 gives the linear force that would act at the same creepage,
u mu N = 3 (1 - (1 - t)^(1/3)) mu N. To first order it exceeds T by t/3 of it.
"""

from __future__ import annotations

import math

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, IntArray

SHARE_ROUNDS = 3  # of spin and saturation, each of which decides on the other
MOST_UTILISATION = 0.98  # near 1 the creepage is beyond all bounds
LEAST_UTILISATION = 1e-6


@compiled(nogil=True)
def excess_at(utilisation: float) -> float:
    """Return linear over true creep force of a wheel less 1: 0 without slip, 2 at full slip.

    Parameters
    ----------
    utilisation
        T/(mu N), not negative; of more than 0.98 the excess at 0.98.
    """
    t = min(max(utilisation, LEAST_UTILISATION), MOST_UTILISATION)
    return 3.0 * (1.0 - math.pow(1.0 - t, 1.0 / 3.0)) / t - 1.0


@compiled(nogil=True)
def add_saturated(
    signals: FloatArray, forces: FloatArray, place: IntArray, bounds: FloatArray, saturated: FloatArray
) -> None:
    """Add the sums of g e, g g, g q and g x, g = q times the mean excess of both wheels, to each place and friction.

    Parameters
    ----------
    signals
        (3, n) e, q and x.
    forces
        (3, n) of a wheel: longitudinal and lateral creep force without spin, and the linear lateral force of spin,
        which is the other way round on the right wheel.
    place
        (n,) index of the place.
    bounds
        (k,) mu N.
    saturated
        (c, 4, k) changed.
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
                excess = 0.5 * (excess_at(left / bounds[k]) + excess_at(right / bounds[k]))
            g = q * excess
            sums[0, k] += g * e
            sums[1, k] += g * g
            sums[2, k] += g * q
            sums[3, k] += g * x
