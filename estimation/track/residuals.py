"""How far passes are from the alignment and the curve that were found, by journey and by wheelset.

A wheelset whose R(y - d) is no single curve, because it hits its flanges, hunts, or is hollow on one side, is further
off than sensors make the others. It is given less weight: its error is not noise, and more passes would not reduce it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.track.iteration import IterationResult
from estimation.track.journeys import Journey
from estimation.track.panel.basis import pass_residual
from estimation.track.profile_life import ProfileLife
from estimation.values.arrays import FloatArray

USUAL_FACTOR = 1.5  # times the median of the wheelsets
LEAST_USUAL = 0.12e-3  # m
POWER = 4
LARGEST_EFFECTIVE_WEIGHT = 0.25  # weight of the one that is furthest off, above which nothing would change


@dataclass(frozen=True, slots=True)
class Residuals:
    """Root mean squares of y - d - h(R), m; NaN where nothing that is known was covered."""

    of_journeys: Mapping[Journey, float]
    of_lives: Mapping[ProfileLife, float]
    of_usual_wheelsets: Mapping[Journey, float] = field(default_factory=dict)  # lower median of those of a journey

    def weights(self) -> dict[ProfileLife, float]:
        """Return by profile life how much a pass counts: 1 up to what is usual, less and less beyond.

        Empty where none is so far off that it would matter.
        """
        known = [value for value in self.of_lives.values() if np.isfinite(value)]
        usual = max(USUAL_FACTOR * float(np.median(known)), LEAST_USUAL) if known else np.inf
        found = {life: (usual / value) ** POWER for life, value in self.of_lives.items() if value > usual}
        return found if any(weight < LARGEST_EFFECTIVE_WEIGHT for weight in found.values()) else {}


@dataclass(slots=True)
class _MeanSquare:
    squares: float = 0.0
    count: int = 0

    def add(self, values: FloatArray) -> None:
        self.squares, self.count = self.squares + float(values @ values), self.count + len(values)

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")


@dataclass(slots=True)
class _Sums:
    journeys: dict[Journey, _MeanSquare] = field(default_factory=dict)
    lives: dict[ProfileLife, _MeanSquare] = field(default_factory=dict)
    parts: dict[Journey, dict[ProfileLife, _MeanSquare]] = field(default_factory=dict)

    def usual_wheelset(self, journey: Journey) -> float:
        """Return the lower median of the wheelsets of a journey: one that is wrong alone does not make it larger."""
        known = sorted(mean.rms for mean in self.parts.get(journey, {}).values())
        return known[(len(known) - 1) // 2] if known else float("nan")


def residuals(iterated: IterationResult) -> Residuals:
    """Return the residuals of an iterated section, by journey and by wheelset."""
    sums, d = _Sums(), iterated.solution.alignment
    for journey, one in iterated.placed.items():
        for item in one.passes:
            sums.journeys.setdefault(journey, _MeanSquare())
            sums.lives.setdefault(item.life, _MeanSquare())
            curve = iterated.solution.curve_of(item.life)
            if item.empty or curve is None:
                continue
            values = pass_residual(item, curve, iterated.panel)[item.inside]
            rest = (values - d[item.used_points])[np.isfinite(d[item.used_points])]
            sums.journeys[journey].add(rest)
            sums.lives[item.life].add(rest)
            if len(rest):
                sums.parts.setdefault(journey, {}).setdefault(item.life, _MeanSquare()).add(rest)
    return Residuals(
        {journey: mean.rms for journey, mean in sums.journeys.items()},
        {life: mean.rms for life, mean in sums.lives.items()},
        {journey: sums.usual_wheelset(journey) for journey in sums.journeys},
    )
