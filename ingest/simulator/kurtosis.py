"""Irregularities that are not Gaussian: more kurtosis at the same spectrum and standard deviation.

Recorded lines have a kurtosis of 6 to 9 where random phases give 3. An irregularity is changed by iteration between
two demands (amplitude-adjusted surrogates, Schreiber and Schmitz, Phys. Rev. Lett. 77 (1996) 635): its values, in their
order, are replaced by those of u + c u^3, u Gaussian, and its spectral lines are given their amplitudes back. The
spectral demand comes last and is met exactly. The first one is then met nearly, so c is adjusted until the kurtosis of
the stretch that is used is right. There is nothing random in it: the seed of the phases decides.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
import scipy.optimize
import scipy.special

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray

GAUSSIAN = 3.0
HIGHEST = 15.0  # of what is asked for
TOLERANCE = 0.02  # of the kurtosis, relative
_CUBIC = (-0.06, 5.0)  # c: u + c u^3 has a kurtosis of 2.05 to 43
_SWEEPS = 8  # between two adjustments of c
_ADJUSTMENTS = 25


def kurtosis_of(values: FloatArray) -> float:
    """Return the kurtosis of values (n,) about their mean: 3 for Gaussian ones."""
    centred = values - values.mean()
    return float(np.mean(centred**4) / np.mean(centred**2) ** 2)


def with_kurtosis(period: FloatArray, count: int, target: float) -> FloatArray:
    """Return the period (n,) of an irregularity with another kurtosis of its first ``count`` values.

    Args:
        period: (n,) one period, mean 0.
        target: Kurtosis, 3 or more.

    Raises:
        ParameterError: The target is below 3, or the stretch has too few waves for it.
    """
    if not GAUSSIAN <= target <= HIGHEST:
        raise ParameterError(
            f"a kurtosis of {target:g} is outside the range, {GAUSSIAN:g} to {HIGHEST:g}", field="kurtosis"
        )
    lines = np.abs(scipy.fft.rfft(period))
    gaussian = np.asarray(scipy.special.ndtri((np.arange(len(period)) + 0.5) / len(period)))
    asked, values = target, period
    for _ in range(_ADJUSTMENTS):
        marginal = _cubic(gaussian, asked)
        for _ in range(_SWEEPS):
            values = _with_lines(_with_values(values, marginal), lines)
        reached = kurtosis_of(values[:count])
        if abs(reached - target) <= 0.5 * TOLERANCE * target:
            return values
        asked = min(max(asked + target - reached, _CUBIC_KURTOSIS[0]), _CUBIC_KURTOSIS[1])
    if abs(reached - target) <= TOLERANCE * target:
        return values
    raise ParameterError(
        f"{target:g} cannot be made: too few waves are on the track; {reached:.1f} can be reached", field="kurtosis"
    )


def _cubic_kurtosis(c: float) -> float:
    """Return the kurtosis of u + c u^3 from the moments of a Gaussian u."""
    fourth = 3.0 + 60.0 * c + 630.0 * c**2 + 3780.0 * c**3 + 10395.0 * c**4
    return fourth / (1.0 + 6.0 * c + 15.0 * c**2) ** 2


_CUBIC_KURTOSIS = tuple(_cubic_kurtosis(c) for c in _CUBIC)


def _cubic(gaussian: FloatArray, kurtosis: float) -> FloatArray:
    """Return the sorted values (n,) of u + c u^3 with that kurtosis."""
    lowest, highest = _CUBIC
    c = float(scipy.optimize.brentq(lambda c: _cubic_kurtosis(c) - kurtosis, lowest - 0.01, highest + 1.0))
    return np.sort(gaussian + c * gaussian**3)


def _with_values(shape: FloatArray, ordered: FloatArray) -> FloatArray:
    """Return the values ``ordered`` (n,) in the order of ``shape`` (n,)."""
    values = np.empty_like(shape)
    values[np.argsort(shape, kind="stable")] = ordered
    return values


def _with_lines(values: FloatArray, lines: FloatArray) -> FloatArray:
    """Return values (n,) whose spectral lines have the amplitudes ``lines`` and keep their phases."""
    spectrum = scipy.fft.rfft(values)
    size = np.abs(spectrum)
    phases = np.divide(spectrum, size, out=np.ones_like(spectrum), where=size > 0.0)
    return np.asarray(scipy.fft.irfft(lines * phases, len(values)))
