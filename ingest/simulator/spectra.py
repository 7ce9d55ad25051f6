"""Track irregularities from power spectral densities: the German / ERRI B176 forms, by random phases.

Densities are one-sided over angular wavenumber W (rad/m): the variance is their integral over W > 0. Recorded lines
have far more gauge variation than the German gauge spectrum gives, so the level is set by standard deviation and
only the *form* is taken from the spectrum. Random phases make the values Gaussian; ``kurtosis`` changes that.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import scipy.fft
import scipy.integrate

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray

Irregularity = Literal["alignment", "gauge"]

CRITICAL_WAVENUMBER = 0.8246  # Wc, rad/m
LOW_WAVENUMBER = 0.0206  # Wr, rad/m
GAUGE_WAVENUMBER = 0.4380  # Ws, rad/m
ALIGNMENT_LEVEL = {"low": 2.119e-7, "high": 6.125e-7}  # A, m2 rad/m


def density(kind: Irregularity, wavenumber: FloatArray, level: float = ALIGNMENT_LEVEL["low"]) -> FloatArray:
    """Return the one-sided power spectral density (n,), m2/(rad/m), of an irregularity.

    Alignment: S = A Wc^2 / ((W^2 + Wr^2)(W^2 + Wc^2)). Gauge, as cross level: the same times W^2 / (W^2 + Ws^2).

    Args:
        wavenumber: (n,) angular wavenumber, rad/m.
        level: A, m2 rad/m.
    """
    w2 = np.asarray(wavenumber, dtype=np.float64) ** 2
    S = level * CRITICAL_WAVENUMBER**2 / ((w2 + LOW_WAVENUMBER**2) * (w2 + CRITICAL_WAVENUMBER**2))
    return S * w2 / (w2 + GAUGE_WAVENUMBER**2) if kind == "gauge" else S


def standard_deviation(kind: Irregularity, wavelengths: tuple[float, float], level: float) -> float:
    """Return the standard deviation, m, of the density over a band.

    Args:
        wavelengths: Shortest and longest, m.
        level: A, m2 rad/m.
    """
    low, high = _band(wavelengths)
    variance, _ = scipy.integrate.quad(lambda w: float(density(kind, np.array(w), level)), low, high)
    return math.sqrt(variance)


def synthesise(
    kind: Irregularity,
    *,
    length: float,
    interval: float,
    target_std: float,
    wavelengths: tuple[float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """Return an irregularity (n,), m, every ``interval`` m over ``length`` m, with exactly ``target_std`` m.

    Every wavenumber line inside the band carries the amplitude of the density and a random phase. The mean is
    removed and the standard deviation set on the stretch that is returned.

    Args:
        length: Of the track, m.
        interval: Between points, m.
        target_std: Standard deviation of the result, m.
        wavelengths: Shortest and longest, m.

    Raises:
        ParameterError: The band is empty or not resolved by ``interval``, or the stretch is shorter than the longest
            wavelength.
    """
    _band(wavelengths)
    if wavelengths[0] < 4.0 * interval:
        raise ParameterError(f"a grid of {interval} m cannot carry a wavelength of {wavelengths[0]} m")
    if length < wavelengths[1]:
        raise ParameterError(f"{length} m of track are shorter than the longest wavelength, {wavelengths[1]} m")
    count = round(length / interval) + 1
    if target_std == 0.0:
        return np.zeros(count)
    values = periodic(kind, period_of(count, wavelengths[1], interval), interval, wavelengths, rng)[:count]
    values -= values.mean()
    return np.asarray(values * (target_std / values.std()))


def period_of(count: int, longest: float, interval: float) -> int:
    """Return how many points a periodic irregularity has of which ``count`` points are used.

    Args:
        longest: Longest wavelength, m: that much is left over, so that begin and end do not follow each other.
        interval: Between points, m.
    """
    return int(scipy.fft.next_fast_len(count + round(longest / interval), real=True))


def periodic(
    kind: Irregularity, size: int, interval: float, wavelengths: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return one period (size,) of an irregularity, of any level: every line inside the band has a random phase.

    Args:
        interval: Between points, m.
        wavelengths: Shortest and longest, m.

    Raises:
        ParameterError: The band is empty.
    """
    low, high = _band(wavelengths)
    wavenumber = 2.0 * np.pi * scipy.fft.rfftfreq(size, interval)
    inside = (wavenumber >= low) & (wavenumber <= high)
    amplitude = np.where(inside, np.sqrt(density(kind, np.maximum(wavenumber, low))), 0.0)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(wavenumber))
    return np.asarray(scipy.fft.irfft(amplitude * np.exp(1j * phase), size))


def _band(wavelengths: tuple[float, float]) -> tuple[float, float]:
    shortest, longest = wavelengths
    if not 0.0 < shortest < longest:
        raise ParameterError(f"wavelengths {shortest} m to {longest} m are no band")
    return 2.0 * math.pi / longest, 2.0 * math.pi / shortest
