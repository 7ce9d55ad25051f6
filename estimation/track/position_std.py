"""How well positions of journeys are known, and positions shrunk to what was reported as far as they are not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.track.iteration import IterationResult
from estimation.track.journeys import Journey
from estimation.values.track import Correction

CORRELATED = 20.0  # m along the track over which the error of y - d - h(R) of a pass is one
REPORTED_STD = 1.0  # m, of a position as it was reported


def position_std(iterated: IterationResult) -> dict[Journey, float]:
    """Return the std of each journey's offset, m, by the slope of the alignment and the residuals; inf for none."""
    panel, solution = iterated.panel, iterated.solution
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.grid.step)
    weight = panel.grid.step / CORRELATED / max(iterated.noise, 1e-9) ** 2
    information = {
        journey: weight * sum(float(np.sum(slope[item.used_points] ** 2)) for item in one.passes if not item.empty)
        for journey, one in iterated.placed.items()
    }
    return {journey: one**-0.5 if one > 0.0 else float("inf") for journey, one in information.items()}


def shrunk(iterated: IterationResult) -> Mapping[Journey, Correction]:
    """Return the corrections of journeys, each as far as it is better known than the reported position."""
    found = {}
    for journey, std in position_std(iterated).items():
        share = REPORTED_STD**2 / (REPORTED_STD**2 + std**2)
        one = iterated.corrections[journey]
        found[journey] = replace(one, offset=share * one.offset, scale=share * one.scale)
    return found
