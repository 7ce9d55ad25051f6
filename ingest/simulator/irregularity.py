"""An irregularity of the track as a sum of parts, each with its band of wavelengths and its standard deviation."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.file_units import MM, PERCENT, Key
from ingest.file_value import between
from ingest.input_file import Positive, field_error
from ingest.simulator.kurtosis import GAUSSIAN, with_kurtosis
from ingest.simulator.spectra import Irregularity, period_of, periodic, synthesise


@dataclass(frozen=True, slots=True)
class Waves:
    """A part of an irregularity: the form of a spectrum over a band of wavelengths, at a standard deviation."""

    form: Irregularity
    std: float  # m
    wavelengths: tuple[float, float]  # shortest and longest, m


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Wavelengths as files have them."""

    shortest: Annotated[Positive, Key("shortest_wavelength_m")] = 3.0
    longest: Annotated[Positive, Key("longest_wavelength_m")] = 70.0

    def plan(self) -> tuple[float, float]:
        """Return the shortest and the longest, m."""
        return self.shortest, self.longest


@dataclass(frozen=True, slots=True, kw_only=True)
class _WavesTable:
    form: ClassVar[Irregularity] = "gauge"
    shortest: Annotated[Positive, Key("shortest_wavelength_m")] = 3.0
    longest: Annotated[Positive, Key("longest_wavelength_m")] = 70.0
    std: float

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a band without wavelengths."""
        if self.longest <= self.shortest:
            raise field_error(f"{self.longest:g} m must be greater than {self.shortest:g} m", "longest_wavelength_m")
        return self

    def plan(self) -> Waves:
        """Return the waves."""
        return Waves(self.form, self.std, (self.shortest, self.longest))


@dataclass(frozen=True, slots=True, kw_only=True)
class LongWaves(_WavesTable):
    """``[section.long_alignment]``, ``[section.long_gauge]``: of the form of the spectrum of alignment, both."""

    form: ClassVar[Irregularity] = "alignment"
    shortest: Annotated[Positive, Key("shortest_wavelength_m")] = 100.0
    longest: Annotated[Positive, Key("longest_wavelength_m")] = 1000.0
    std: Annotated[float, between(0.0, 50.0), MM]


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossLevel(_WavesTable):
    """``[section.cross_level]``; the spectrum of cross level is that of gauge."""

    std: Annotated[float, between(0.0, 20.0), MM]


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadVariation(_WavesTable):
    """``[section.load_variation]``, over the mean load."""

    std: Annotated[float, between(0.0, 40.0), PERCENT]


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
