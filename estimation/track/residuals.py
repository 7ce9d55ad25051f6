"""How far passes are from the alignment and the curve that were found, by journey and by wheelset.

A wheelset whose R(y - d) is no single curve, because it hits its flanges, hunts, or is hollow on one side, is further
off than sensors make the others. It is heard less, for its error is not noise: more of its passes would not make up.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.track.iteration import IterationResult
from estimation.track.journeys import Journey, PositionParameters, journeys
from estimation.track.panel.basis import pass_residual

USUAL = 1.5  # times the median of the wheelsets
USUAL_LEAST = 0.12e-3  # m
POWER = 4
WORTH = 0.25  # weight of the one that is furthest off, above which nothing would change


@dataclass(frozen=True, slots=True)
class Residuals:
    """Root mean squares of y - d - h(R), m; NaN where nothing that is known was covered."""

    of_journeys: Mapping[Journey, float]
    of_wheelsets: Mapping[str, float]

    def weights(self) -> dict[str, float]:
        """Return by wheelset how much a pass counts: 1 up to what is usual, less and less beyond.

        Empty where none is so far off that it would matter.
        """
        known = [value for value in self.of_wheelsets.values() if np.isfinite(value)]
        usual = max(USUAL * float(np.median(known)), USUAL_LEAST) if known else np.inf
        found = {name: (usual / value) ** POWER for name, value in self.of_wheelsets.items() if value > usual}
        return found if min(found.values(), default=1.0) < WORTH else {}


@dataclass(slots=True)
class _Sums:
    squares: float = 0.0
    count: int = 0

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")


@dataclass(slots=True)
class _Tally:
    journeys: dict[Journey, _Sums] = field(default_factory=lambda: defaultdict(_Sums))
    wheelsets: dict[str, _Sums] = field(default_factory=lambda: defaultdict(_Sums))


def residuals(iterated: IterationResult, positions: PositionParameters) -> Residuals:
    """Return the residuals of a settled section."""
    tally, d = _Tally(), iterated.solution.alignment
    for journey, members in journeys(iterated.passes, positions).items():
        for item in members:
            own = tally.journeys[journey], tally.wheelsets[item.wheelset]
            curve = iterated.solution.curves[0, iterated.solution.wheelsets.index(item.wheelset)]
            told = pass_residual(item, curve, iterated.panel)
            if told is None:
                continue
            at, values = told
            rest = (values - d[at])[np.isfinite(d[at])]
            for sums in own:
                sums.squares, sums.count = sums.squares + float(rest @ rest), sums.count + len(rest)
    return Residuals(
        {journey: sums.rms for journey, sums in tally.journeys.items()},
        {wheelset: sums.rms for wheelset, sums in tally.wheelsets.items()},
    )
