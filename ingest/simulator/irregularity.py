"""An irregularity of the track as a sum of parts, each with its band of wavelengths and its standard deviation.

Its form is that of the German / ERRI B176 power spectral densities, by random phases. They are one-sided over angular
wavenumber W (rad/m): the variance is their integral over W > 0. Recorded lines have far more gauge variation than the
German gauge spectrum gives, so the level is set by standard deviation and only the *form* is taken from the spectrum.
Random phases make the values Gaussian; ``kurtosis`` changes that.

Recorded lines have a kurtosis of 6 to 9 where random phases give 3. An irregularity is changed by iteration between
two demands (amplitude-adjusted surrogates, Schreiber and Schmitz, Phys. Rev. Lett. 77 (1996) 635): its values, in their
order, are replaced by those of u + c u^3, u Gaussian, and its spectral lines are given their amplitudes back. The
spectral demand comes last and is met exactly. The first one is then met nearly, so c is adjusted until the kurtosis of
the stretch that is used is right. There is nothing random in it: the seed of the phases decides.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import scipy.fft
import scipy.optimize
import scipy.special
from annotated_types import Interval

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.values.fields import MM, PERCENT, FileUnit, Key, M
from ingest.file_value import As, IncreasingPlaces, between
from ingest.input_file import Positive, field_error

Irregularity = Literal["alignment", "gauge"]

CRITICAL_WAVENUMBER = 0.8246  # Wc, rad/m
LOW_WAVENUMBER = 0.0206  # Wr, rad/m
GAUGE_WAVENUMBER = 0.4380  # Ws, rad/m
ALIGNMENT_LEVEL = 2.119e-7  # A of the low level, m2 rad/m


def density(kind: Irregularity, wavenumber: FloatArray) -> FloatArray:
    """Return the one-sided power spectral density (n,), m2/(rad/m), of an irregularity.

    Alignment: S = A Wc^2 / ((W^2 + Wr^2)(W^2 + Wc^2)). Gauge, as cross level: the same times W^2 / (W^2 + Ws^2).
    """
    w2 = np.asarray(wavenumber, dtype=np.float64) ** 2
    S = ALIGNMENT_LEVEL * CRITICAL_WAVENUMBER**2 / ((w2 + LOW_WAVENUMBER**2) * (w2 + CRITICAL_WAVENUMBER**2))
    return S * w2 / (w2 + GAUGE_WAVENUMBER**2) if kind == "gauge" else S


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
    """
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

    The longest wavelength, m, is left over, so that begin and end do not follow each other.
    """
    return int(scipy.fft.next_fast_len(count + round(longest / interval), real=True))


def periodic(
    kind: Irregularity, size: int, interval: float, wavelengths: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return one period (size,) of an irregularity, of any level: every line inside the band has a random phase."""
    low, high = _band(wavelengths)
    wavenumber = 2.0 * np.pi * scipy.fft.rfftfreq(size, interval)
    inside = (wavenumber >= low) & (wavenumber <= high)
    amplitude = np.where(inside, np.sqrt(density(kind, np.maximum(wavenumber, low))), 0.0)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(wavenumber))
    return np.asarray(scipy.fft.irfft(amplitude * np.exp(1j * phase), size))


def _band(wavelengths: tuple[float, float]) -> tuple[float, float]:
    return 2.0 * math.pi / wavelengths[1], 2.0 * math.pi / wavelengths[0]


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
    """Return the period (n,) of an irregularity with another kurtosis of its first ``count`` values."""
    lines = np.abs(scipy.fft.rfft(period))
    gaussian = np.asarray(scipy.special.ndtri((np.arange(len(period)) + 0.5) / len(period)))
    asked, values, (lowest, highest) = target, period, (_CUBIC[0] - 0.01, _CUBIC[1] + 1.0)
    for _ in range(_ADJUSTMENTS):
        c = float(scipy.optimize.brentq(lambda c, asked: _cubic_kurtosis(c) - asked, lowest, highest, (asked,)))
        marginal = np.sort(gaussian + c * gaussian**3)
        for _ in range(_SWEEPS):
            ordered = np.empty_like(values)
            ordered[np.argsort(values, kind="stable")] = marginal
            spectrum = scipy.fft.rfft(ordered)
            size = np.abs(spectrum)
            phases = np.divide(spectrum, size, out=np.ones_like(spectrum), where=size > 0.0)
            values = np.asarray(scipy.fft.irfft(lines * phases, len(values)))
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


FEWEST_INTERVALS = 8  # of the grid over an isolated irregularity
DRAWN_SHARE = (0.5, 1.5)  # of the size, of one that is drawn


class IsolatedKind(StrEnum):
    """What it is; this decides its shapes over its length."""

    DEFECT = "defect"  # alignment and gauge rise and fall as one wave of a cosine
    SWITCH = "switch"  # alignment has a kink in the middle; gauge stays off over the middle half
    JOINT = "joint"  # alignment has a kink in the middle; gauge as of a defect


@dataclass(frozen=True, slots=True)
class Isolated:
    """Isolated irregularities of one kind and size; m.

    Where they are drawn, their number is Poisson distributed, their sizes vary by ``DRAWN_SHARE``, and their alignment
    is to either side.
    """

    kind: Annotated[IsolatedKind, Key(None)]
    length: Annotated[float, Interval(gt=0.0, le=200.0), M]  # from begin to end
    alignment: Annotated[float, between(-30.0, 30.0), MM] = 0.0  # in the middle, positive to the left
    gauge: Annotated[float, between(-30.0, 30.0), MM] = 0.0  # in the middle, positive is wide
    at: Annotated[IncreasingPlaces, Key("at_m")] = ()  # middles, distance along the section
    per_metre: Annotated[float, between(0.0, 200.0), FileUnit("", divisor=1e3), Key("per_km")] = 0.0  # drawn beside

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse what is nowhere, or changes nothing."""
        if not self.at and self.per_metre == 0.0:
            raise field_error("is missing; give the middles, or 'per_km' to draw them", "at_m")
        if self.alignment == 0.0 and self.gauge == 0.0:
            raise field_error("is missing, and 'gauge_mm' too: it changes nothing", "alignment_mm")
        return self


def _usual(kind: IsolatedKind, length: float, alignment_mm: float = 0.0, gauge_mm: float = 0.0) -> As:
    """Return what a file need not say of a kind."""
    sizes = (("alignment", 1e-3 * alignment_mm), ("gauge", 1e-3 * gauge_mm))
    return As(Isolated, (("kind", kind), ("length", length), *sizes))


@dataclass(frozen=True, slots=True)
class IsolatedTables:
    """``[[section.defects]]``, ``[[section.switches]]``, ``[[section.joints]]``."""

    defects: tuple[Annotated[Isolated, _usual(IsolatedKind.DEFECT, 10.0)], ...] = ()
    switches: tuple[Annotated[Isolated, _usual(IsolatedKind.SWITCH, 20.0, 2.0, -3.0)], ...] = ()
    joints: tuple[Annotated[Isolated, _usual(IsolatedKind.JOINT, 4.0, 0.8, -0.5)], ...] = ()

    def plan(self) -> tuple[Isolated, ...]:
        """Return them all."""
        return (*self.defects, *self.switches, *self.joints)


def isolated(items: Sequence[Isolated], s: FloatArray, rngs: Sequence[np.random.Generator]) -> FloatArray:
    """Return what isolated irregularities add to alignment and gauge deviation (2, n), m."""
    added = np.zeros((2, len(s)))
    for item, rng in zip(items, rngs, strict=True):
        for at in item.at:
            added += _shape(item, s, at)
        for _ in range(rng.poisson(item.per_metre * float(s[-1] - s[0]))):
            at, share = rng.uniform(float(s[0]), float(s[-1])), rng.uniform(*DRAWN_SHARE)
            side = rng.choice((-1.0, 1.0))
            added += share * np.array([[side], [1.0]]) * _shape(item, s, at)
    return added


def _shape(item: Isolated, s: FloatArray, at: float) -> FloatArray:
    """Return alignment and gauge (2, n) of one irregularity; 0 outside its length."""
    u = np.clip((s - at) / item.length, -0.5, 0.5)
    wave = 0.5 * (1.0 + np.cos(2.0 * np.pi * u))
    kink = (1.0 - 2.0 * np.abs(u)) ** 2
    plateau = 0.5 * (1.0 + np.cos(2.0 * np.pi * np.clip(2.0 * np.abs(u) - 0.5, 0.0, 0.5)))
    line = wave if item.kind is IsolatedKind.DEFECT else kink
    wide = plateau if item.kind is IsolatedKind.SWITCH else wave
    return np.stack([item.alignment * line, item.gauge * wide])
