"""From a wheelset's interval geometries to the newest sudden change of its conicity, and what is behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.trend.change_point import ChangePoint, Series, StepModel, newest_change
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE, by_amplitude
from estimation.trend.trend import NO_FORECAST
from estimation.trend.wear_curve import POINTS_FOR_OUTLIERS
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.trend import StepCause, StepExplanation, TrendStep, WearTrend

COVERING = 0.75  # of the newest intervals, and of those before, that cover the amplitude
NEWEST, BEFORE = 8, 24  # intervals
ENOUGH_BEHIND = POINTS_FOR_OUTLIERS  # points among which a trend finds an outlier; with fewer it says so
LOOKED_BACK = 12  # intervals behind a step of which one showed it first
SMALLEST_STD = 1e-6  # a std below it is not credible

_Covered = tuple[IntervalConicities, Mapping[int, KnownConicity]]  # with its conicities by amplitude in micrometres


def newest_step(records: Sequence[IntervalConicities]) -> TrendStep | None:
    """Return the newest sudden change of the conicity of a wheelset; None where there is none.

    It is looked for at the largest amplitude up to 3 mm that intervals on both sides cover, never by extrapolation:
    a profile that was turned moves further than before.
    """
    model = StepModel()
    covered = sorted(((r, by_amplitude(r)) for r in records), key=lambda one: (one[0].mileage_km, one[0].from_ns))
    amplitude = _amplitude([known for _, known in covered if known], 2 * model.least_points)
    having = [(r, known) for r, known in covered if amplitude in known]
    if len(having) < 2 * model.least_points:
        return None
    series = Series(
        np.array([r.mileage_km for r, _ in having], dtype=np.float64),
        np.array([0.5 * (r.from_ns + r.to_ns) for r, _ in having], dtype=np.float64),
        np.array([known[amplitude].value for _, known in having], dtype=np.float64),
        np.maximum([known[amplitude].std for _, known in having], SMALLEST_STD),
    )
    found = newest_change(series, model)
    if found is None:
        return None
    before, after = having[found.last][0], having[found.first][0]
    return TrendStep(
        before_km=before.mileage_km,
        after_km=after.mileage_km,
        before_ns=min(before.to_ns, after.from_ns),
        after_ns=after.from_ns,
        found_ns=having[_shown_by(series, found, model)][0].to_ns,
        size=with_interval(found.size, found.std, count=float(len(having) - found.first)),
        level_before=found.level,
        amplitude=amplitude * SAME_AMPLITUDE,
        probability=found.probability,
        before=found.before,
        behind=len(having) - found.first,
    )


def behind_step(records: Sequence[IntervalConicities], step: TrendStep | None) -> list[IntervalConicities]:
    """Return the intervals behind a step; all where there is none."""
    return [record for record in records if step is None or record.from_ns >= step.after_ns]


def with_step(trend: WearTrend, step: TrendStep) -> WearTrend:
    """Return the trend of the points behind a step; where they are few it says so and forecasts nothing."""
    if len(trend.value) >= ENOUGH_BEHIND:
        return replace(trend, step=step)
    text = f"{len(trend.value)} intervals behind a step at {step.after_km:,.0f} km, {ENOUGH_BEHIND} are enough"
    few = Reason(ReasonCode.BEHIND_STEP, text)

    def marked(estimate: Estimate) -> Estimate:
        return replace(estimate, reason=combined([estimate.reason, few]))

    return replace(
        trend,
        step=step,
        few_behind=few,
        distance_to_limit_km=NO_FORECAST,
        date_of_limit_ns=NO_FORECAST,
        fitted=marked(trend.fitted),
        slope_per_1000_km=marked(trend.slope_per_1000_km),
        slope_per_year=marked(trend.slope_per_year),
        reason=combined([trend.reason, few]) if trend.status is Status.ESTIMATED else trend.reason,
    )


def _shown_by(series: Series, found: ChangePoint, model: StepModel) -> int:
    """Return the number of the point that showed a step first, looking back over some points."""
    k = len(series.value)
    for until in range(found.first + model.least_points, min(k, found.first + LOOKED_BACK)):
        earlier = newest_change(series.part(0, until), model)
        if earlier is not None and earlier.first > found.last:
            return until - 1
    return min(k, found.first + LOOKED_BACK) - 1


def _amplitude(covered: Sequence[Mapping[int, KnownConicity]], newest: int) -> int:
    """Return the key of an amplitude that most intervals cover, the newest and those before alike.

    Of several it is the one that most of the very newest cover, then the largest: a worn wheelset moves ever less, and
    a step that its newest intervals show must not wait until they cover what it once did.
    """
    limit = round(LIMIT_AMPLITUDE / SAME_AMPLITUDE)
    sides = [covered[-NEWEST:], covered[-NEWEST - BEFORE : -NEWEST]]
    keys = {key for one in covered for key in one if key <= limit}
    enough = [key for key in keys if all(sum(key in one for one in s) >= COVERING * len(s) for s in sides)]
    return max(enough, key=lambda key: (sum(key in one for one in covered[-newest:]), key), default=0)


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

    A cause predicts the conicity behind the step: turned wheels have that of their design, a wheelset that was turned
    end for end keeps its own, a sensor of another scale changes all wheelsets of its node by one factor, damage only
    raises it, and another wheelset may have any. Causes are weighed by the density of what was found under each, and by
    how often each happens.
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
