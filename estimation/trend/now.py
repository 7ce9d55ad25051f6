"""What is believed of a wheelset and its limit as of its newest believed mileage: made here, printed everywhere else.

A limit is held at 3 mm (EN 15302). A wheelset that does not move as far is extrapolated; what it does at the largest
amplitude that it reaches is known better, and a conicity over the limit there is a danger whatever follows. The
trend is a smooth curve: the last two points of it, both over the limit, are over it too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from estimation.trend.extrapolation import (
    LIMIT_AMPLITUDE,
    SAME_AMPLITUDE,
    Extrapolation,
    below_limit,
    conicity_at_limit_amplitude,
    extrapolated,
)
from estimation.trend.parameters import CURVES
from estimation.values.alerts import NO_FORECAST, LimitNow, MileageNow, Severity, Urgency
from estimation.values.geometry import WheelsetGeometry
from estimation.values.quantities import Estimate, Forecast, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.trend import WearTrend

QUANTILES = {"p10": 0.1, "p50": 0.5, "p90": 0.9}
NO_TREND = Reason(ReasonCode.TOO_FEW_POINTS, "there is no trend since the last reprofiling yet")
NOT_FINITE = Reason(ReasonCode.NOT_FINITE, "the calculation gave no finite number")
BEYOND = Reason(ReasonCode.BEYOND_HORIZON, "not reached within the forecast horizon")


@dataclass(frozen=True, slots=True)
class UrgencyScale:
    """Where one word for a wheelset and its limit ends and the next begins: of urgencies and severities alike."""

    over_probability: float = 0.9  # 1, that it is over the limit: as the shipped rule on the limit raises its alert
    probably_over_probability: float = 0.5  # 1: more likely than not
    due_within_km: float = 30_000.0  # km, p10 of the distance: beyond, the shipped rule on the forecast lets go
    # of the limit: at a wear of 0.05 in 100,000 km, the rest of it lasts as far as that or more
    far_below_share: float = 0.8
    last_points: int = 2  # of a trend: one alone may be an outlier
    not_below_probability: float = 0.6  # 1, at 3 mm, for a conicity over the limit at a smaller amplitude to be over it

    def over(self, probability: float | None) -> Urgency | None:
        """Return whether the limit is exceeded, or probably is; None where it is not, or nothing is known."""
        if probability is None or probability < self.probably_over_probability:
            return None
        return Urgency.OVER_LIMIT if probability >= self.over_probability else Urgency.PROBABLY_OVER

    def severity(self, probability: float | None) -> Severity:
        """Return the severity of an alert on the limit: critical where the limit is exceeded."""
        return Severity.CRITICAL if self.over(probability) is Urgency.OVER_LIMIT else Severity.WARNING

    def due(self, distance_km: Forecast) -> bool:
        """Return whether the limit may be reached soon."""
        return distance_km.p10 is not None and distance_km.p10 <= self.due_within_km

    def far_below(self, now: LimitNow) -> bool:
        """Return whether the whole 95 % interval of the conicity is far below the limit."""
        high, limit = now.conicity.high, now.limit
        known = now.conicity.status is Status.ESTIMATED and high is not None and limit is not None
        return known and high < self.far_below_share * limit  # type: ignore[operator]  # both are known


SCALE = UrgencyScale()


def probability_above(estimate: Estimate, limit: float) -> float | None:
    """Return the probability that the true value is above ``limit``; None where nothing is estimated."""
    # the value is taken as normal with its standard deviation
    if estimate.value is None or estimate.std is None:
        return None
    if estimate.std <= 0.0:
        return float(estimate.value > limit)
    return float(ndtr((estimate.value - limit) / estimate.std))


@dataclass(frozen=True, slots=True)
class Against:
    """A conicity against a limit: which one decides, at which amplitude (m), and how probably it is over."""

    conicity: Estimate
    amplitude: float
    probability: float


@dataclass(frozen=True, slots=True)
class LimitState:
    """What the data show of the conicity of a wheelset.

    ``reached`` is that at the largest amplitude covered, where that is below 3 mm and not too small to say anything of
    a limit; ``last`` are the last points of a trend that a limit is held against; ``left_open`` says that the wheelset
    moves as far as a limit is held against it, and its data leave the conicity open.
    """

    conicity: Estimate  # at 3 mm
    reached: Estimate | None = None
    reached_amplitude: float = LIMIT_AMPLITUDE  # m
    last: Sequence[Estimate] = ()
    beyond: Extrapolation | None = None  # how an extrapolated conicity is spread about its mean
    left_open: bool = False

    def at_limit(self, limit: float) -> Against | None:
        """Return the conicity at 3 mm against a limit: of the trend, or of its last points; None where not known."""
        of_trend = self._above(self.conicity, limit)
        if of_trend is None:
            return None
        ways = [(self.conicity, of_trend)]
        if len(self.last) == SCALE.last_points:
            points = [(point, self._above(point, limit) or 0.0) for point in self.last]
            ways.append(min(points, key=lambda pair: pair[1]))
        conicity, probability = max(ways, key=lambda pair: pair[1])
        return Against(conicity, LIMIT_AMPLITUDE, probability)

    def at_reached(self, limit: float) -> Against | None:
        """Return the conicity at the largest amplitude covered against a limit; None where that is 3 mm or unknown."""
        probability = None if self.reached is None else probability_above(self.reached, limit)
        if self.reached is None or probability is None:
            return None
        return Against(self.reached, self.reached_amplitude, probability)

    def against(self, limit: float) -> Against | None:
        """Return the conicity that decides whether the limit is exceeded; None where none does."""
        # That is the one at 3 mm; at the amplitude reached where that one is over more probably and the one at 3 mm is
        # unknown or not rather below. One that is below at a smaller amplitude alone decides nothing.
        at_limit, at_reached = self.at_limit(limit), self.at_reached(limit)
        if at_reached is None or at_reached.probability < SCALE.not_below_probability:
            return at_limit
        if at_limit is None:
            return at_reached
        if at_limit.probability < SCALE.not_below_probability:
            return at_limit
        return max(at_limit, at_reached, key=lambda one: one.probability)

    def _above(self, estimate: Estimate, limit: float) -> float | None:
        if self.beyond is None or estimate.value is None:
            return probability_above(estimate, limit)
        return replace(self.beyond, value=estimate.value).mixture().above(limit)

    @property
    def extrapolated(self) -> bool:
        """Whether the conicity at 3 mm is extrapolated."""
        return self.reached is not None


def limit_state(geometry: WheelsetGeometry, trend: WearTrend | None) -> LimitState:
    """Return what the data show of the conicity of a wheelset, by its current geometry and the trend of its profile."""
    # the fitted trend says what is at 3 mm, or the current geometry where none is comparable
    fitted = None if trend is None or trend.not_comparable else trend.fitted
    conicity, fleet = fitted, None if trend is None else trend.fleet
    if conicity is None or conicity.status is not Status.ESTIMATED:
        conicity = conicity_at_limit_amplitude(geometry, fleet)
    amplitude = geometry.reported_amplitude
    reaches = CURVES.least_amplitude - SAME_AMPLITUDE < amplitude < LIMIT_AMPLITUDE - SAME_AMPLITUDE
    extrapolates = reaches and geometry.equivalent_conicity.status is Status.ESTIMATED
    beyond = extrapolated(below_limit(geometry), fleet=fleet) if extrapolates else None
    last: list[Estimate] = []
    if trend is not None and conicity is fitted:
        value, std = trend.value, trend.std
        if trend.calibration is not None and trend.calibration.profiles:
            # what is left in common is known better than how wheelsets like it go on beyond
            value, std, beyond = value + trend.calibration.shift, np.hypot(trend.noise, trend.calibration.std), None
        pairs = zip(value[-SCALE.last_points :].tolist(), std[-SCALE.last_points :].tolist(), strict=True)
        last = [with_interval(*pair) for pair in pairs]
    left_open = any(
        CURVES.least_amplitude - SAME_AMPLITUDE < place < LIMIT_AMPLITUDE + SAME_AMPLITUDE
        and code_of(estimate.reason) is ReasonCode.CONICITY_OPEN
        for place, estimate in zip(geometry.amplitude.tolist(), geometry.conicity, strict=True)
    )
    if not extrapolates:
        return LimitState(conicity, last=last, left_open=left_open)
    return LimitState(conicity, geometry.equivalent_conicity, amplitude, last, beyond, left_open)


def limit_now(
    geometry: WheelsetGeometry | None,
    trend: WearTrend | None,
    limit: float | None,
    mileage: MileageNow | None,
    unknown: Estimate | None = None,
) -> LimitNow:
    """Return what is believed now.

    Args:
        geometry: Current one of the present profile; None where there is none.
        trend: Of the present profile.
        limit: Of the conicity at 3 mm; None where none is known.
        mileage: Newest that is believed; None counts from the last point of the trend.
        unknown: What stands for the conicity without a geometry.
    """
    conicity = unknown or Estimate.unknown(NO_TREND)
    if geometry is not None:
        conicity = _published(conicity_at_limit_amplitude(geometry, None if trend is None else trend.fleet))
    now = LimitNow(
        conicity=conicity,
        slope_per_1000_km=Estimate.unknown(NO_TREND) if trend is None else _published(trend.slope_per_1000_km),
        limit=finite(limit),
        probability_over_limit=None,
        distance_to_limit_km=NO_FORECAST,
        since_trend_km=None,
        date_of_limit_ns=NO_FORECAST,
        forecast_reason=_why_no_forecast(geometry, trend, conicity),
        mileage=mileage,
    )
    if geometry is None or now.limit is None or conicity.status is Status.MODEL_MISMATCH:
        return now
    against = limit_state(geometry, trend).against(now.limit)
    now = replace(now, probability_over_limit=None if against is None else finite(against.probability))
    return now if trend is None or now.forecast_reason is not None else _ahead(now, trend)


def _why_no_forecast(geometry: WheelsetGeometry | None, trend: WearTrend | None, conicity: Estimate) -> Reason | None:
    if geometry is None or conicity.status is Status.MODEL_MISMATCH:
        return conicity.reason or NO_TREND
    if trend is None:
        return NO_TREND
    if trend.not_comparable is not None:
        return trend.not_comparable
    return trend.few_behind if trend.status is Status.ESTIMATED else trend.reason or NO_TREND


def probability_ahead(trend: WearTrend, distance_km: float) -> float | None:
    """Return the probability of being over the limit at a distance from the last point; None where not known."""
    if trend.status is not Status.ESTIMATED or not len(trend.ahead_km):
        return None
    return float(np.interp(distance_km, trend.ahead_km, trend.over_ahead))


def probability_within(trend: WearTrend, run_km: float, distance_km: float) -> float | None:
    """Return the greatest probability of being over the limit on a way that begins ``run_km`` behind the last point."""
    ends = [probability_ahead(trend, at_km) for at_km in (run_km, run_km + distance_km)]
    on_the_way = (trend.ahead_km > run_km) & (trend.ahead_km < run_km + distance_km)
    probabilities = [over for over in (*ends, *trend.over_ahead[on_the_way].tolist()) if over is not None]
    return max(probabilities) if None not in ends else None


def _ahead(now: LimitNow, trend: WearTrend) -> LimitNow:
    """Return it with what the trend says, which counts from its last point."""
    since = None
    if now.mileage is not None and len(trend.mileage_km):
        since = max(0.0, now.mileage.mileage_km - float(trend.mileage_km[-1]))
    run = since or 0.0
    over, by_data = finite(probability_ahead(trend, run)), now.probability_over_limit
    # the last points, or a smaller amplitude, may be over by themselves, for which the alert on the limit is raised; a
    # conicity that surely falls leaves them behind (a probability may sink because the forecast widens)
    slope = trend.slope_per_1000_km.high
    falls = slope is not None and slope < 0.0
    if by_data is not None and (over is None or (by_data >= trend.raise_probability and not falls)):
        over = max(by_data, over or 0.0)
    distance = {name: _from_now(trend, name, run, over) for name in QUANTILES}
    return replace(
        now,
        probability_over_limit=over,
        distance_to_limit_km=Forecast(**distance),
        date_of_limit_ns=Forecast(**{name: _date(trend, name, far, now.mileage) for name, far in distance.items()}),
        since_trend_km=since,
        forecast_reason=BEYOND if None in distance.values() else None,
    )


def _from_now(trend: WearTrend, name: str, run_km: float, over: float | None) -> float | None:
    """Return the distance from now at which the limit is exceeded with the probability of a quantile."""
    if over is not None and over >= QUANTILES[name]:
        return 0.0
    far = finite(getattr(trend.distance_to_limit_km, name))
    if far is None or far > run_km:
        return None if far is None else far - run_km
    # a conicity that has fallen below the limit since may come back to it
    again = np.flatnonzero((trend.ahead_km > run_km) & (trend.over_ahead >= QUANTILES[name]))
    if over is None or not len(again):
        return None
    reached, before_km = int(again[0]), max(run_km, float(trend.ahead_km[again[0] - 1]))
    before = probability_ahead(trend, before_km)
    nodes = [before_km, float(trend.ahead_km[reached])]
    return float(np.interp(QUANTILES[name], [before or 0.0, trend.over_ahead[reached]], nodes)) - run_km


def _date(trend: WearTrend, name: str, distance_km: float | None, mileage: MileageNow | None) -> float | None:
    """Return when the limit is reached: the rest of the way takes its share of the time that the whole way takes."""
    day, far = (finite(getattr(one, name)) for one in (trend.date_of_limit_ns, trend.distance_to_limit_km))
    if mileage is None:
        return day
    last_ns = float(trend.measured_ns.max())
    at_ns = max(float(mileage.at_ns), last_ns)
    if distance_km is None:  # beyond the horizon of the distance may be within that of the date
        return None if day is None or far is not None else max(day, at_ns)
    if distance_km <= 0.0:
        return at_ns
    if day is None or not far:
        return None
    return at_ns + max(0.0, day - last_ns) * distance_km / far


def finite(value: float | None) -> float | None:
    """Return a number; None where it is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def _published(estimate: Estimate) -> Estimate:
    if None not in [finite(value) for value in (estimate.value, estimate.std, estimate.low, estimate.high)]:
        return estimate
    status = Status.INVALID if estimate.status is Status.ESTIMATED else estimate.status
    return Estimate.unknown(estimate.reason or NOT_FINITE, finite(estimate.count) or 0.0, status)
