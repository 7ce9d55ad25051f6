"""Forecasts of a distance to a limit against what happened: CRPS, PIT, and 80 % intervals.

A forecast is the probability that the limit has been reached, known at some distances ahead and linear between; so the
continuous ranked probability score is a sum of closed integrals over these pieces, up to the horizon. A distance beyond
the horizon counts as the horizon. Where the forecast has a probability of its own for "now" or "beyond", the
probability integral transform of what happened is drawn within that (seeded): of a calibrated forecast it is even.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.coverage import Coverage, Verdict
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate, Status
from estimation.values.trend import WearTrend

HORIZON_KM = 500_000.0  # of the product
OUTER = (0.1, 0.9)  # probabilities at the ends of an 80 % interval
MISS_80 = 10.0  # weight of a miss in the interval score of 80 % intervals
BINS = 10


@dataclass(frozen=True, slots=True)
class Prediction:
    """What is forecast of a wheelset: level and slope at its last point, and when its limit will have been reached.

    Attributes:
        level: With its 95 % interval.
        slope: Per km.
        ahead_km: Distances (a,) from the last point, from 0, increasing.
        reached: Probabilities (a,) that the limit has been reached by there, not decreasing.
    """

    level: Estimate
    slope: Estimate
    ahead_km: FloatArray
    reached: FloatArray

    @classmethod
    def of(cls, trend: WearTrend) -> Prediction | None:
        """Return what the product forecasts; None where it does not."""
        if trend.status is not Status.ESTIMATED or not len(trend.ahead_km):
            return None
        reached = np.asarray(np.maximum.accumulate(trend.over_ahead))
        return cls(trend.fitted, trend.slope_per_1000_km.scaled(1e-3), trend.ahead_km, reached)

    def quantile(self, probability: float) -> float:
        """Return by which distance (km) the limit has been reached with a probability; the horizon where beyond."""
        at = int(np.searchsorted(self.reached, probability))
        if at == 0:
            return 0.0
        if at == len(self.reached):
            return HORIZON_KM
        share = (probability - self.reached[at - 1]) / (self.reached[at] - self.reached[at - 1])
        return float(self.ahead_km[at - 1] + share * (self.ahead_km[at] - self.ahead_km[at - 1]))

    def chance(self, distance_km: float) -> float:
        """Return the probability that the limit has been reached by a distance."""
        return float(np.interp(distance_km, self.ahead_km, self.reached))

    def crps(self, distance_km: float) -> float:
        """Return the continuous ranked probability score, km, up to the horizon, of what happened."""
        happened = min(distance_km, HORIZON_KM)
        nodes = np.unique([*self.ahead_km[self.ahead_km < HORIZON_KM], happened, HORIZON_KM])
        chance = np.interp(nodes, self.ahead_km, self.reached)
        first, last, width = chance[:-1], chance[1:], np.diff(nodes)
        behind = nodes[:-1] >= happened
        first, last = first - behind, last - behind
        return float(np.sum(width * (first**2 + first * last + last**2)) / 3.0)

    def transform(self, distance_km: float, drawn: float) -> float:
        """Return the probability integral transform of what happened; ``drawn`` of 0 to 1 within now and beyond."""
        if distance_km <= 0.0:
            return drawn * float(self.reached[0])
        if distance_km >= HORIZON_KM:
            chance = self.chance(HORIZON_KM)
            return chance + drawn * (1.0 - chance)
        return self.chance(distance_km)


@dataclass(frozen=True, slots=True)
class Happened:
    """A forecast against what happened."""

    crps: float  # km
    score: float  # km, interval score of the 80 % interval
    width: float  # km, from p10 to p90
    transform: float

    @classmethod
    def of(cls, made: Prediction, distance_km: float, drawn: float) -> Happened:
        """Return a forecast against the distance at which the limit was reached (inf: never)."""
        happened = min(distance_km, HORIZON_KM)
        low, high = (made.quantile(one) for one in OUTER)
        missed = max(low - happened, happened - high, 0.0)
        return cls(
            made.crps(distance_km), high - low + MISS_80 * missed, high - low, made.transform(distance_km, drawn)
        )

    @property
    def covered(self) -> bool:
        """Whether the 80 % interval holds it."""
        return OUTER[0] <= self.transform <= OUTER[1]


COLUMNS = ("forecasts", "CRPS, km", "IS80, km", "p10 to p90, km", "cover of 80 %", "below p10, p50, p90", "PIT, %")


@dataclass(frozen=True, slots=True)
class ForecastFigures:
    """Figures of forecasts; clusters are fleets, which share what is not known."""

    count: int
    crps: float
    score: float
    width: float  # median
    cover: Coverage
    below: tuple[Coverage, Coverage, Coverage]  # p10, p50, p90
    histogram: FloatArray  # (BINS,) shares of the transforms

    @classmethod
    def of(cls, clusters: Iterable[Sequence[Happened]]) -> ForecastFigures:
        """Return those of all forecasts together."""
        fleets = [fleet for fleet in clusters if fleet]
        every = [one for fleet in fleets for one in fleet]
        transforms = np.array([one.transform for one in every])
        cover = Coverage.of([(len(fleet), sum(one.covered for one in fleet)) for fleet in fleets])
        p10, p50, p90 = (
            Coverage.of([(len(fleet), sum(one.transform <= limit for one in fleet)) for fleet in fleets])
            for limit in (OUTER[0], 0.5, OUTER[1])
        )
        histogram, _ = np.histogram(transforms, BINS, (0.0, 1.0))
        crps, score = (float(np.mean([getattr(one, name) for one in every])) for name in ("crps", "score"))
        width = float(np.median([one.width for one in every]))
        return cls(len(every), crps, score, width, cover, (p10, p50, p90), histogram / max(len(every), 1))

    @property
    def cells(self) -> tuple[str, ...]:
        """As text, for a table of the columns ``COLUMNS``."""
        kilometres = (f"{one:,.0f}" for one in (self.crps, self.score, self.width))
        below = "/".join(f"{100.0 * one.share:.0f}" for one in self.below)
        shares = " ".join(f"{100.0 * share:.0f}" for share in self.histogram)
        return str(self.count), *kilometres, str(self.cover), below, shares

    def calibrated(self, margin: float, tolerance: float) -> Verdict:
        """Return whether p10, p50 and p90 are below as often as they should, within a margin."""
        return Verdict.all(
            [
                cover.verdict(
                    (share - margin, share + margin), (share - margin - tolerance, share + margin + tolerance)
                )
                for cover, share in zip(self.below, (OUTER[0], 0.5, OUTER[1]), strict=True)
            ]
        )
