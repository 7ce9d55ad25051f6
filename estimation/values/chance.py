"""How improbable a statistic is where nothing but chance made it."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc


def log10_chance(statistic: float, degrees: float) -> float:
    """Return the decimal logarithm of the chance that a chi-square variable exceeds a value; -inf beyond about 1400.

    Args:
        statistic: The value, 0 or more.
    """
    with np.errstate(divide="ignore"):
        return float(np.log10(chdtrc(degrees, statistic)))
