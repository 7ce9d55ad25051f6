"""From a wheelset's interval geometries to the newest sudden change of its conicity, and what is behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.trend.change_point import ChangePoint, Series, StepModel, newest_change
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE
from estimation.trend.trend import NO_FORECAST
from estimation.trend.wear_curve import POINTS_FOR_OUTLIERS
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.trend import TrendStep, WearTrend

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
    covered = sorted(((r, _by_amplitude(r)) for r in records), key=lambda one: (one[0].mileage_km, one[0].from_ns))
    amplitude = _amplitude([known for _, known in covered if known], 2 * model.least_points)
    having = [(r, known) for r, known in covered if amplitude in known]
    if len(having) < 2 * model.least_points:
        return None
    series = _series(having, amplitude)
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
    """Return the intervals behind a step; all where there is none.

    Args:
        step: Its newest.
    """
    return [record for record in records if step is None or record.from_ns >= step.after_ns]


def with_step(trend: WearTrend, step: TrendStep) -> WearTrend:
    """Return the trend of the points behind a step; where they are few it says so and forecasts nothing.

    Args:
        trend: Of the points behind it alone.
        step: That it begins behind.
    """
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


def _by_amplitude(record: IntervalConicities) -> dict[int, KnownConicity]:
    return {round(one.amplitude / SAME_AMPLITUDE): one for one in record.known}


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


def _series(having: Sequence[_Covered], amplitude: int) -> Series:
    return Series(
        np.array([r.mileage_km for r, _ in having], dtype=np.float64),
        np.array([0.5 * (r.from_ns + r.to_ns) for r, _ in having], dtype=np.float64),
        np.array([known[amplitude].value for _, known in having], dtype=np.float64),
        np.maximum([known[amplitude].std for _, known in having], SMALLEST_STD),
    )
