"""By how much creepage exceeds the linear one at a force: Vermeulen and Johnson (1964), solved for the creepage.

With t = T/(mu N), T the resultant creep force of a wheel and N its normal force, the law t = 1 - (1 - u/3)^3 gives the
linear force that would act at the same creepage, u mu N = 3 (1 - (1 - t)^(1/3)) mu N. To first order it exceeds T by
t/3 of it.
"""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray

MOST_UTILISATION = 0.98  # near 1 the creepage is beyond all bounds
LEAST_UTILISATION = 1e-6


def creep_excess(utilisation: FloatArray) -> FloatArray:
    """Return linear over true creep force less 1, of any shape: 0 without slip, 2 at full slip.

    Parameters
    ----------
    utilisation
        T/(mu N), not negative; of more than 0.98 the excess at 0.98.
    """
    t = np.clip(utilisation, LEAST_UTILISATION, MOST_UTILISATION)
    return np.asarray(3.0 * (1.0 - np.cbrt(1.0 - t)) / t - 1.0)
