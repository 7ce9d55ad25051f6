"""What may be behind a step of a conicity, and how well each cause explains it.

A cause predicts the conicity behind the step: turned wheels have that of their design, a wheelset that was turned end
for end keeps its own, a sensor of another scale changes all wheelsets of its node by one factor, damage only raises it,
and another wheelset may have any. Causes are weighed by the density of what was found under each, and by how often
each happens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.geometry import KnownConicity
from estimation.values.trend import StepCause, StepExplanation, TrendStep

USUAL = {
    StepCause.TURNED: 0.4,
    StepCause.EXCHANGED: 0.35,
    StepCause.DAMAGED: 0.15,
    StepCause.SENSOR: 0.06,
    StepCause.TURNED_END_FOR_END: 0.04,
}
DESIGN_STD = 0.02  # of the conicity of turned wheels about that of their design
KEPT_STD = 0.02  # of a wheelset's own after it was turned end for end
ANY_CONICITY = (0.02, 0.6)  # of a wheelset of the fleet
DAMAGE_SIZE = 0.15  # mean of a rise by damage
SCALE_STD = 0.3  # of the logarithm of a sensor's scale
SAME_SCALE_STD = 0.05  # of it between wheelsets of one node
TOGETHER_NS = 3 * 86_400 * 10**9  # between steps of one node
ALONE = 0.3  # chance that a sensor's fault is one of a single wheelset's
LEAST_DENSITY = 1e-6
HALF_STEP = 0.125e-3  # m: amplitudes nearer to each other are the same


@dataclass(frozen=True, slots=True)
class StepSurroundings:
    """What else is known about the time of a step."""

    behind: tuple[KnownConicity, ...] = ()  # of the newest interval behind it
    designed: Mapping[float, float] | None = None  # conicity of the wheel as designed by amplitude (m)
    others: Sequence[TrendStep | None] = ()  # newest of the other wheelsets of the vehicle; None of one without


def explanations(step: TrendStep, around: StepSurroundings) -> tuple[StepExplanation, ...]:
    """Return the causes, the likeliest first.

    Args:
        around: What is known besides.
    """
    size, std = step.size.value or 0.0, step.size.std or 1.0
    found = {
        StepCause.TURNED: _turned(step, std, around),
        StepCause.EXCHANGED: (1.0 / (ANY_CONICITY[1] - ANY_CONICITY[0]), 0.0),
        StepCause.DAMAGED: (float(np.exp(-size / DAMAGE_SIZE)) / DAMAGE_SIZE, 0.0)
        if size > 0.0
        else (0.0, -size / std),
        StepCause.SENSOR: _sensor(step, around.others),
        StepCause.TURNED_END_FOR_END: _normal(size, float(np.hypot(std, KEPT_STD))),
    }
    weight = {cause: USUAL[cause] * max(density, LEAST_DENSITY) for cause, (density, _) in found.items()}
    total = sum(weight.values())
    ordered = sorted(found, key=lambda cause: -weight[cause])
    return tuple(StepExplanation(cause, weight[cause] / total, found[cause][1]) for cause in ordered)


def _turned(step: TrendStep, std: float, around: StepSurroundings) -> tuple[float, float]:
    """Return density and what is left where the wheels have been turned to their design."""
    after = step.level_before + (step.size.value or 0.0)
    if not around.designed:
        falls = after < step.level_before
        return (1.0 / max(step.level_before, KEPT_STD), 0.0) if falls else (0.0, abs(step.size.value or 0.0) / std)
    nearest = min(around.designed, key=lambda at: abs(at - step.amplitude))
    density, left = _normal(after - around.designed[nearest], float(np.hypot(std, DESIGN_STD)))
    apart = [
        (one.value - around.designed[at]) / DESIGN_STD
        for one in around.behind
        for at in around.designed
        if abs(at - one.amplitude) < HALF_STEP
    ]
    shape = float(np.sqrt(np.mean(np.square(apart)))) if apart else left
    worse = max(left, shape)
    return density * float(np.exp(-0.5 * (worse**2 - left**2))), worse


def _sensor(step: TrendStep, others: Sequence[TrendStep | None]) -> tuple[float, float]:
    """Return density and what is left where a sensor has another scale: wheelsets of one node change by one factor."""
    after = max(step.level_before + (step.size.value or 0.0), KEPT_STD)
    scale = _log_scale(step)
    together = [one for one in others if one is not None and _together(step, one)]
    density, left = _normal(scale, SCALE_STD)
    if not together:
        alone = ALONE if others else 1.0
        return alone * density / after, 0.0
    same = [abs(_log_scale(one) - scale) / float(np.hypot(_log_std(one), np.hypot(_log_std(step), SAME_SCALE_STD)))
            for one in together]  # fmt: skip
    left = float(np.sqrt(np.mean(np.square(same))))
    sharper = SCALE_STD / SAME_SCALE_STD  # one factor for all is a sharp prediction
    return sharper * len(together) / len(others) * density * float(np.exp(-0.5 * left**2)) / after, left


def _together(first: TrendStep, second: TrendStep) -> bool:
    return first.before_ns - TOGETHER_NS <= second.after_ns and second.before_ns <= first.after_ns + TOGETHER_NS


def _log_scale(step: TrendStep) -> float:
    after = max(step.level_before + (step.size.value or 0.0), KEPT_STD)
    return float(np.log(after / max(step.level_before, KEPT_STD)))


def _log_std(step: TrendStep) -> float:
    return (step.size.std or 1.0) / max(step.level_before + (step.size.value or 0.0), KEPT_STD)


def _normal(apart: float, std: float) -> tuple[float, float]:
    left = abs(apart) / std
    return float(np.exp(-0.5 * left**2) / (std * np.sqrt(2.0 * np.pi))), left
