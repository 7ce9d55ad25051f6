"""A wheelset's indicator since the last reprofiling: robust slope, value now, distance and date to its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache

import numpy as np

from estimation.trend.calibration import SharedError, shared_error
from estimation.trend.change_point import CONICITY, ChangePoint, Series, newest_change
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE, by_amplitude
from estimation.trend.now import QUANTILES, probability_above
from estimation.trend.parameters import CURVES
from estimation.trend.points import PointColumns, columns_of
from estimation.trend.wear_curve import WearCurve, fit_wear_curve
from estimation.values.alerts import NO_FORECAST
from estimation.values.arrays import FloatArray
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.memory import MEMORY
from estimation.values.quantities import Estimate, Forecast, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.trend import FleetWear, TrendPoint, TrendRecord, TrendStep, WearComponent, WearTrend
from estimation.values.units import STD_PER_MAD, YEAR_NS


def fit_recent(
    x: FloatArray,
    value: FloatArray,
    std: FloatArray,
    params: TrendParameters,
    prior: Sequence[WearComponent] | None = None,
    origin: float | None = None,
) -> WearCurve:
    """Fit the curve to the newest points that it agrees with."""
    scatter = _scatter(value, std, params)
    first = 0
    while True:
        curve = fit_wear_curve(x[first:], value[first:], std[first:], prior, origin)
        left = len(x) - first
        later = first + min(left // 2, left - params.fewest_judged)
        if later <= first or not x[-1] > x[later] or _agrees(curve, x[first:], value[first:], scatter[first:], params):
            return curve
        first = later


def _agrees(curve: WearCurve, x: FloatArray, value: FloatArray, scatter: FloatArray, params: TrendParameters) -> bool:
    level, slope = float(curve.weight @ curve.level), float(curve.weight @ curve.slope)
    off = np.clip((value - level - slope * (x - x[-1])) / scatter, -params.clipped_stds, params.clipped_stds)
    judged = [count for count in params.judged_together if params.judged_share * count <= len(x)]
    return all(abs(float(np.mean(off[-count:]))) * np.sqrt(count) <= params.disagreement_stds for count in judged)


def _scatter(value: FloatArray, std: FloatArray, params: TrendParameters) -> FloatArray:
    """Return how far each point (k,) scatters about its neighbours: what all points have in common is not in it."""
    if len(value) < params.fewest_judged:
        return std
    steps = np.diff(value) / np.hypot(std[1:], std[:-1])
    share = STD_PER_MAD * float(np.median(np.abs(steps - np.median(steps))))
    return std * min(1.0, max(params.least_scatter, share))


ONE_DATE = Reason(ReasonCode.SINGLE_DATE, "all points have one date")


@dataclass(frozen=True, slots=True)
class TrendParameters:
    """What shapes a trend; changing any of it changes the provenance of the next refresh."""

    minimum_points: int = 2
    minimum_span_km: float = 1.0
    horizon_km: float = 500_000.0
    horizon_years: float = 10.0
    smallest_std: float = 1e-6  # a std below it is not credible
    judged_together: tuple[int, int, int] = (3, 6, 12)  # last points that are judged together
    judged_share: int = 3  # at most one in so many of the points
    fewest_judged: int = 6  # points that are left
    disagreement_stds: float = 2.5  # standard deviations of the mean of the last points off the curve
    clipped_stds: float = 3.0  # scatters that one point counts for
    least_scatter: float = 0.1  # of the stated standard deviation
    scale_std: float = 0.05  # relative, of all differences of a wheelset: slopes were found 5 to 9 % too small
    covering_share: float = 0.75  # of the newest intervals, and of those before, that cover the amplitude
    newest_points: int = 8  # intervals
    points_before: int = 24
    points_looked_back: int = 12  # intervals behind a step of which one showed it first


def refresh(
    points: Sequence[TrendPoint],
    limit: float,
    params: TrendParameters | None = None,
    *,
    quantity: str = "equivalent_conicity",
    note: Reason | None = None,
    not_comparable: Reason | None = None,
    fleet: FleetWear | None = None,
    origin_km: float | None = None,
    measured: Sequence[TrendPoint] = (),
) -> WearTrend:
    """Return the trend of the points, in whatever order they come.

    Args:
        fleet: What is known of the wear of the wheelset beforehand; None for nothing.
        origin_km: Mileage at which the profile began to wear; None for that of the first point.
        measured: Values by measured profiles of the same wheels, at the mileages of estimates.
        not_comparable: Why the points cannot be compared with the limit, which then nothing is said about; None where
            they can.

    Returns:
        WearTrend: The slopes are those at the last point; ``fitted`` is the fitted value there. With too few points the
            trend is ``unestimated`` and says why; ``fitted`` is then the last value itself, where there is one.
    """
    params = params or TrendParameters()
    columns = columns_of(points, params.smallest_std)
    lacking = _lacking(columns, params)
    if lacking is not None:
        why = replace(lacking, text="; ".join(str(reason) for reason in (note, lacking) if reason is not None))
        code = lacking.code if note is None or len(columns.value) else note.code
        trend = _unestimated(columns, limit, quantity, replace(why, code=code))
    else:
        trend = _estimated(columns, limit, params, quantity, note, fleet, origin_km, measured)
    if note is not None and note.code is ReasonCode.AMPLITUDE_EXTRAPOLATED and trend.fitted.value is not None:
        trend = replace(trend, fitted=replace(trend.fitted, reason=note))
    if not_comparable is None:
        return trend
    return replace(
        trend,
        distance_to_limit_km=NO_FORECAST,
        date_of_limit_ns=NO_FORECAST,
        probability_over_limit=None,
        not_comparable=not_comparable,
    )


def points_of(points: Sequence[TrendPoint], params: TrendParameters) -> PointColumns | None:
    """Return the points of a trend in their order; None where they are too few for one."""
    columns = columns_of(points, params.smallest_std)
    return None if _lacking(columns, params) is not None else columns


def _lacking(points: PointColumns, params: TrendParameters) -> Reason | None:
    k = len(points.value)
    wanted = max(2, params.minimum_points)
    if k < wanted:
        return Reason(
            ReasonCode.TOO_FEW_POINTS, f"{k} point{'' if k == 1 else 's'} since the last reprofiling, {wanted} needed"
        )
    span = float(points.mileage_km[-1] - points.mileage_km[0])
    if span < params.minimum_span_km:
        text = f"the points span {span:.3g} km, {params.minimum_span_km:.3g} km needed"
        return Reason(ReasonCode.SPAN_TOO_SHORT, text)
    return None


def _unestimated(points: PointColumns, limit: float, quantity: str, reason: Reason | None) -> WearTrend:
    unknown = Estimate.unknown(reason or ONE_DATE, len(points.value))
    fitted, probability = unknown, None
    if len(points.value):
        fitted = with_interval(float(points.value[-1]), float(points.std[-1]))
        probability = probability_above(fitted, limit)
    return WearTrend(
        quantity=quantity,
        mileage_km=points.mileage_km,
        measured_ns=points.measured_ns,
        value=points.value,
        std=points.std,
        noise=points.noise,
        slope_per_1000_km=unknown,
        slope_per_year=unknown,
        fitted=fitted,
        limit=limit,
        distance_to_limit_km=NO_FORECAST,
        date_of_limit_ns=NO_FORECAST,
        probability_over_limit=probability,
        status=Status.UNESTIMATED,
        reason=reason,
    )


def _estimated(
    points: PointColumns,
    limit: float,
    params: TrendParameters,
    quantity: str,
    note: Reason | None,
    fleet: FleetWear | None,
    origin_km: float | None,
    measured: Sequence[TrendPoint],
) -> WearTrend:
    prior = None if fleet is None else fleet.components
    by_distance = fit_recent(points.mileage_km, points.value, points.noise, params, prior, origin_km)
    level_now = float(by_distance.weight @ by_distance.level)
    error = shared_error(points, level_now, params.scale_std, measured, by_distance.share)
    by_distance = _believed(by_distance, error, None if prior is None else CURVES.growing_km)
    count = float(by_distance.share.sum())
    order = np.argsort(points.measured_ns, kind="stable")
    since, by_date = points.measured_ns[order] - points.measured_ns.max(), None
    slope_per_year, date = Estimate.unknown(ONE_DATE, count), NO_FORECAST
    if since[0] != 0:
        years, value, noise = since / YEAR_NS, points.value[order], points.noise[order]
        km_per_year = float((points.mileage_km[-1] - points.mileage_km[0]) / (years[-1] - years[0]))
        of_years, origin = _by_date(km_per_year, float(points.mileage_km[0]), float(years[0]), prior, origin_km)
        by_date = fit_recent(years, value, noise, params, of_years, origin)
        by_date = _believed(by_date, error, None if prior is None else CURVES.growing_km / km_per_year)
        slope_per_year = by_date.slope_now().estimate(count)
        reached, _ = _forecast(by_date, limit, params.horizon_years)
        last = int(points.measured_ns.max())
        date = Forecast(*(None if year is None else last + round(year * YEAR_NS) for year in astuple(reached)))
    level, (distance, (ahead_km, over_ahead)) = (
        by_distance.level_now(),
        _forecast(by_distance, limit, params.horizon_km),
    )
    return replace(
        _unestimated(points, limit, quantity, note),
        slope_per_1000_km=by_distance.slope_now().estimate(count).scaled(1000.0),
        slope_per_year=slope_per_year,
        fitted=level.estimate(count),
        distance_to_limit_km=distance,
        date_of_limit_ns=date,
        probability_over_limit=level.above(limit),
        status=Status.ESTIMATED,
        converged=by_distance.converged and (by_date is None or by_date.converged),
        ahead_km=ahead_km,
        over_ahead=over_ahead,
        fleet=fleet,
        origin_km=origin_km,
        calibration=error.measured,
    )


def _believed(curve: WearCurve, error: SharedError, growing: float | None) -> WearCurve:
    """Return the curve less the errors that all points have in common.

    ``growing`` is the distance over which the indicator is known to grow; None where nothing is known beforehand.
    """
    return (curve if growing is None else curve.growing(growing, CURVES.falling_share)).less(error)


def _by_date(
    km_per_year: float,
    first_km: float,
    first_year: float,
    prior: Sequence[WearComponent] | None,
    origin_km: float | None,
) -> tuple[Sequence[WearComponent] | None, float | None]:
    """Return what is known beforehand, over years in place of km, and when the profile began to wear."""
    origin = None if origin_km is None else first_year - (first_km - origin_km) / km_per_year
    return None if prior is None else [component.per(km_per_year) for component in prior], origin


def _forecast(curve: WearCurve, limit: float, horizon: float) -> tuple[Forecast, tuple[FloatArray, FloatArray]]:
    """Return where the limit is reached, and distances from the last point with the probabilities of being over it."""
    ahead = curve.ahead(limit, horizon)
    reached = Forecast(*(curve.reached_with(limit, probability, ahead) for probability in QUANTILES.values()))
    # the quantiles are among the distances: in between it is interpolated, and at these it is exact
    further = np.array([distance for distance in astuple(reached) if distance])
    distances, first = np.unique(np.concatenate([ahead[0], further]), return_index=True)
    return reached, (distances, np.concatenate([ahead[1], curve.above_after(further, limit)])[first])


_Covered = tuple[IntervalConicities, Mapping[int, KnownConicity]]  # with its conicities by amplitude in micrometres


def newest_step(records: Sequence[IntervalConicities], params: TrendParameters) -> TrendStep | None:
    """Return the newest sudden change of the conicity of a wheelset; None where there is none."""
    # it is looked for at the largest amplitude up to 3 mm that intervals on both sides cover, never by extrapolation: a
    # profile that was turned moves further than before
    covered = [(r, by_amplitude(r)) for r in sorted(records, key=lambda record: (record.mileage_km, record.from_ns))]
    amplitude = _amplitude([conicities for _, conicities in covered if conicities], 2 * CONICITY.least_points, params)
    having = [(r, conicities[amplitude]) for r, conicities in covered if amplitude in conicities]
    if len(having) < 2 * CONICITY.least_points:
        return None
    series = Series(
        np.array([r.mileage_km for r, _ in having], dtype=np.float64),
        np.array([0.5 * (r.from_ns + r.to_ns) for r, _ in having], dtype=np.float64),
        np.array([conicity.value for _, conicity in having], dtype=np.float64),
        np.maximum([conicity.noise for _, conicity in having], params.smallest_std),
    )
    change = newest_change(series)
    if change is None:
        return None
    before, after = having[change.last][0], having[change.first][0]
    return TrendStep(
        before_km=before.mileage_km,
        after_km=after.mileage_km,
        before_ns=min(before.to_ns, after.from_ns),
        after_ns=after.from_ns,
        found_ns=having[_shown_by(series, change, params)][0].to_ns,
        size=with_interval(change.size, change.std, count=float(len(having) - change.first)),
        level_before=change.level,
        amplitude=amplitude * SAME_AMPLITUDE,
        probability=change.probability,
        before=change.before,
        behind=len(having) - change.first,
    )


def behind_step(records: Sequence[IntervalConicities], step: TrendStep | None) -> list[IntervalConicities]:
    """Return the intervals behind a step; all where there is none."""
    return [record for record in records if step is None or record.from_ns >= step.after_ns]


def with_step(trend: WearTrend, step: TrendStep) -> WearTrend:
    """Return the trend of the points behind a step; where they are few it says so and forecasts nothing."""
    enough = CURVES.points_for_outliers  # with fewer a trend finds no outlier
    if len(trend.value) >= enough:
        return replace(trend, step=step)
    text = f"{len(trend.value)} intervals behind a step at {step.after_km:,.0f} km, {enough} are enough"
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


def _shown_by(series: Series, change: ChangePoint, params: TrendParameters) -> int:
    last = min(len(series.value), change.first + params.points_looked_back)
    for until in range(change.first + CONICITY.least_points, last):
        earlier = newest_change(series.part(0, until))
        if earlier is not None and earlier.first > change.last:
            return until - 1
    return last - 1


def _amplitude(covered: Sequence[Mapping[int, KnownConicity]], newest: int, params: TrendParameters) -> int:
    """Return the key of an amplitude that most intervals cover, the newest and those before alike."""
    # of several it is the one that most of the very newest cover, then the largest: a worn wheelset moves ever less,
    # and a step that its newest intervals show must not wait until they cover what it once did
    limit = round(LIMIT_AMPLITUDE / SAME_AMPLITUDE)
    recent = params.newest_points
    sides = covered[-recent:], covered[-recent - params.points_before : -recent]
    keys = {key for of_interval in covered for key in of_interval if key <= limit}
    enough = [key for key in keys if all(sum(key in of for of in s) >= params.covering_share * len(s) for s in sides)]
    return max(enough, key=lambda key: (sum(key in of for of in covered[-newest:]), key), default=0)


def trend_up_to(record: TrendRecord, mileage_km: float, parameters: TrendParameters) -> TrendRecord:
    """Return the trend as it was at a mileage, had all data before been there."""
    now = record.trend
    until = int(np.searchsorted(now.mileage_km, mileage_km, side="right"))
    columns = (now.mileage_km, now.measured_ns, now.value, now.std, now.noise)
    points = tuple(column[:until].tobytes() for column in columns)
    measured = () if now.calibration is None else now.calibration.measured
    measured = tuple(point for point in measured if point.mileage_km <= mileage_km)
    then = _refitted(points, now.limit, now.quantity, (now.fleet, now.origin_km, measured), parameters)
    if now.step is not None:
        then = with_step(then, now.step)
    return replace(record, trend=replace(then, raise_probability=now.raise_probability))


@lru_cache(MEMORY.trends)
def _refitted(
    points: tuple[bytes, ...],
    limit: float,
    quantity: str,
    beforehand: tuple[FleetWear | None, float | None, tuple[TrendPoint, ...]],
    parameters: TrendParameters,
) -> WearTrend:
    kinds = (np.float64, np.int64, np.float64, np.float64, np.float64)
    columns = [np.frombuffer(column, kind).tolist() for column, kind in zip(points, kinds, strict=True)]
    rows = [TrendPoint(*row) for row in zip(*columns, strict=True)]
    fleet, origin_km, measured = beforehand
    return refresh(rows, limit, parameters, quantity=quantity, fleet=fleet, origin_km=origin_km, measured=measured)
