"""What is believed of a wheelset now, for findings on its limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.alerts.rules.conicity_limit import Believed
from estimation.trend.now import LimitState, limit_now
from estimation.values.alerts import NO_FORECAST, LimitNow, MileageNow
from estimation.values.geometry import WheelsetGeometry
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import WearTrend

NO_TREND = Estimate.unknown(Reason(ReasonCode.TOO_FEW_POINTS, "no trend"))


def believed(state: LimitState, limit: float = 0.4) -> Believed:
    """Return what is believed where the data alone say it."""
    against = state.against(limit)
    over = None if against is None else against.probability
    return Believed(state, limit, limit_of(over, state.conicity, limit))


def limit_of(
    over: float | None,
    conicity: Estimate,
    limit: float = 0.4,
    distance_km: Forecast = NO_FORECAST,
    reason: Reason | None = None,
    date_ns: Forecast = NO_FORECAST,
) -> LimitNow:
    """Return what is believed, as it is given."""
    return LimitNow(conicity, NO_TREND, limit, over, distance_km, None, date_ns, reason, None)


def ahead_of(geometry: WheelsetGeometry, trend: WearTrend, since_km: float | None = None) -> LimitNow:
    """Return what is believed so far behind the last point of a trend."""
    mileage = None if since_km is None else MileageNow(float(trend.mileage_km[-1]) + since_km, 2 * 86_400 * 10**9)
    return limit_now(geometry, trend, trend.limit, mileage)


def with_ahead(trend: WearTrend) -> WearTrend:
    """Return a trend made by hand with probabilities at the distances ahead, straight between its quantiles."""
    over, far = trend.probability_over_limit or 0.0, trend.distance_to_limit_km
    known = [(0.0, over)]
    known += [(km, p) for km, p in ((far.p10, 0.1), (far.p50, 0.5), (far.p90, 0.9)) if km is not None and p > over]
    ahead_km, over_ahead = np.array(known).T
    return replace(trend, ahead_km=ahead_km, over_ahead=over_ahead)
