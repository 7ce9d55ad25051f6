"""An irregularity of the track as a sum of parts, each with its band of wavelengths and its standard deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from ingest.simulator.kurtosis import GAUSSIAN, with_kurtosis
from ingest.simulator.spectra import Irregularity, period_of, periodic, synthesise


@dataclass(frozen=True, slots=True)
class Waves:
    """A part of an irregularity: the form of a spectrum over a band of wavelengths, at a standard deviation."""

    form: Irregularity
    std: float  # m
    wavelengths: tuple[float, float]  # shortest and longest, m


def superpose(
    parts: Sequence[Waves],
    rngs: Sequence[np.random.Generator],
    *,
    length: float,
    interval: float,
    kurtosis: float = GAUSSIAN,
) -> FloatArray:
    """Return the sum (n,), m, of independent parts, every ``interval`` m over ``length`` m.

    Each part has its standard deviation on that stretch. A kurtosis above 3 keeps the spectrum and the standard
    deviation of the sum.

    Args:
        length: Of the track, m.
        interval: Between points, m.
        kurtosis: Of the sum on the stretch; 3 leaves it Gaussian.

    Raises:
        ParameterError: As ``synthesise``, or the kurtosis cannot be made.
    """
    gaussian = [
        synthesise(
            part.form, length=length, interval=interval, target_std=part.std, wavelengths=part.wavelengths, rng=rng
        )
        for part, rng in zip(parts, rngs, strict=True)
    ]
    count = len(gaussian[0])
    if kurtosis == GAUSSIAN or not any(part.std for part in parts):
        return np.asarray(sum(gaussian[1:], gaussian[0]))
    size = period_of(count, max(part.wavelengths[1] for part in parts), interval)
    period = np.zeros(size)
    for part, rng in zip(parts, rngs, strict=True):
        waves = periodic(part.form, size, interval, part.wavelengths, rng)
        period += part.std / waves[:count].std() * waves
    values = with_kurtosis(period, count, kurtosis)[:count]
    values = values - values.mean()
    return np.asarray(values * (period[:count].std() / values.std()))
