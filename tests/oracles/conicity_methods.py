"""Two other definitions of equivalent conicity, as cross-checks of the integration of EN 15302."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.contact import conicity
from estimation.values.arrays import FloatArray

ANGLES = 240


def linear_regression_conicity(
    lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike, amplitudes: npt.ArrayLike
) -> FloatArray:
    """Return half the slope of the regression line of Delta r over +- each amplitude around its zero crossing.

    Parameters, errors and NaN as `equivalent_conicity`. With y measured from the crossing and the line through it:
    tan(gamma_e) = sum(y Delta r) / (2 sum(y^2)), the sums as integrals.
    """
    y, difference = conicity._curve(lateral_displacement, rolling_radius_difference)
    centre = float(conicity._equilibrium(y, difference)[0])
    share = np.linspace(-1.0, 1.0, 2 * ANGLES + 1)
    result = []
    for amplitude in conicity._amplitudes(amplitudes):
        offset = amplitude * share
        values = np.interp(centre + offset, y, difference, left=np.nan, right=np.nan)
        result.append(np.trapezoid(offset * values, offset) / np.trapezoid(2.0 * offset**2, offset))
    return np.array(result)


def harmonic_conicity(
    lateral_displacement: npt.ArrayLike, rolling_radius_difference: npt.ArrayLike, amplitudes: npt.ArrayLike
) -> FloatArray:
    """Return the describing function of Delta r for a sine of each amplitude around its zero crossing, halved.

    Parameters, errors and NaN as `equivalent_conicity`.
    tan(gamma_e) = 1/(2 pi A) * integral over 0..2 pi of Delta r(y0 + A sin p) sin p dp.
    """
    y, difference = conicity._curve(lateral_displacement, rolling_radius_difference)
    centre = float(conicity._equilibrium(y, difference)[0])
    sine = np.sin((np.arange(4 * ANGLES) + 0.5) * (2.0 * math.pi / (4 * ANGLES)))
    travel = centre + conicity._amplitudes(amplitudes)[:, np.newaxis] * sine
    values = np.interp(travel, y, difference, left=np.nan, right=np.nan)
    return np.asarray((values * sine).mean(axis=1) / conicity._amplitudes(amplitudes))
