"""A row of the worklist from what is stored of a wheelset: the numbers as published, nothing is estimated again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values.alerts import Severity
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.trend import TrendRecord
from estimation.values.worklist import AxlePosition, BogiePlace, OpenAlert, WorklistRow, WorklistState
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE
from estimation.worklist.inputs import WorklistInputs
from estimation.worklist.urgency import Ahead, judged

NO_GEOMETRY = Reason(ReasonCode.NO_GEOMETRY, "there is no geometry yet")
REPROFILED = Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "there is no geometry since the last reprofiling")
WITHOUT_GEOMETRY = (NO_GEOMETRY.code, REPROFILED.code)
NO_TREND = Reason(ReasonCode.TOO_FEW_POINTS, "there is no trend since the last reprofiling yet")
NOT_FINITE = Reason(ReasonCode.NOT_FINITE, "the calculation gave no finite number")
BEYOND = Reason(ReasonCode.BEYOND_HORIZON, "not reached within the forecast horizon")
REFUSALS_NAMED = 2
_NOWHERE = Forecast(None, None, None)
_SEVERITIES = list(Severity)


def worklist_row(inputs: WorklistInputs) -> WorklistRow:
    """Return what the worklist says of a wheelset."""
    return WorklistRow(
        wheelset=inputs.wheelset,
        vehicle_class=None if inputs.vehicle is None else inputs.vehicle.vehicle_class,
        position=_position(inputs),
        state=_state(inputs),
    )


def _position(inputs: WorklistInputs) -> AxlePosition | None:
    mounting = inputs.wheelset.mounting
    if mounting is None:
        return None
    if inputs.vehicle_class is None or inputs.vehicle_class.bogie is None:
        return AxlePosition()
    bogie, place = divmod(mounting.axle - 1, AXLES_OF_A_BOGIE)
    return AxlePosition(bogie + 1, BogiePlace.TRAILING if place else BogiePlace.LEADING)


def _state(inputs: WorklistInputs) -> WorklistState:
    conicity = _conicity(inputs)
    trend = _current_trend(inputs)
    ahead = _ahead(inputs, trend, conicity)
    alerts = tuple(sorted(inputs.alerts, key=_worst_first))
    ends = [inputs.last_window_ns, None if inputs.geometry is None else inputs.geometry.to_ns]
    last_data_ns = max((end for end in ends if end is not None), default=None)
    verdict = judged(
        mounted=inputs.wheelset.mounting is not None,
        ahead=ahead.ahead,
        alerts=alerts,
        last_ns=last_data_ns,
        refused=bool(inputs.refused),
    )
    has_geometry = inputs.geometry is not None and code_of(conicity.reason) not in WITHOUT_GEOMETRY
    return WorklistState(
        status=conicity.status,
        conicity=conicity,
        measured_until_ns=inputs.geometry.to_ns if inputs.geometry is not None and has_geometry else None,
        slope_per_1000_km=_slope(trend),
        limit=None if trend is None else _finite(trend.trend.limit),
        probability_over_limit=ahead.ahead.probability_over_limit,
        distance_to_limit_km=ahead.ahead.distance_km,
        since_trend_km=ahead.since_trend_km,
        date_of_limit_ns=ahead.date_ns,
        forecast_reason=ahead.ahead.reason,
        mileage=inputs.mileage,
        last_data_ns=last_data_ns,
        alerts=alerts,
        urgency=verdict.urgency,
        reasons=verdict.reasons,
    )


def _conicity(inputs: WorklistInputs) -> Estimate:
    """Return the conicity at 3 mm of the profile that the wheelset has now."""
    geometry = inputs.geometry
    if inputs.failure is not None:
        return Estimate.unknown(inputs.failure, status=Status.INVALID)
    if geometry is None or not geometry.geometry.windows:
        return Estimate.unknown(_with_refusals(NO_GEOMETRY, inputs))
    if geometry.baseline != len(inputs.wheelset.reprofilings):
        return Estimate.unknown(_with_refusals(REPROFILED, inputs))
    return _published(conicity_at_limit_amplitude(geometry.geometry))


def _with_refusals(reason: Reason, inputs: WorklistInputs) -> Reason:
    """Return why there is no geometry, with what its newest windows are refused for."""
    named = list(inputs.refused.items())[:REFUSALS_NAMED]
    if not named:
        return reason
    refusals = ", ".join(f"{count} {code.value.replace('_', ' ')}" for code, count in named)
    rest = sum(inputs.refused.values()) - sum(count for _, count in named)
    return replace(reason, text=f"windows refused: {refusals}{f', {rest} other' if rest else ''}; {reason.text}")


def _current_trend(inputs: WorklistInputs) -> TrendRecord | None:
    """Return the trend, where it is of the profile that the wheelset has now."""
    trend = inputs.trend
    return trend if trend is not None and trend.baseline == len(inputs.wheelset.reprofilings) else None


def _slope(trend: TrendRecord | None) -> Estimate:
    return Estimate.unknown(NO_TREND) if trend is None else _published(trend.trend.slope_per_1000_km)


@dataclass(frozen=True, slots=True)
class _AheadWithDate:
    ahead: Ahead
    date_ns: Forecast
    since_trend_km: float | None


def _ahead(inputs: WorklistInputs, trend: TrendRecord | None, conicity: Estimate) -> _AheadWithDate:
    """Return how far the limit is from where the wheelset is now."""
    unknown = _why_unknown(inputs, trend, conicity)
    if trend is None or unknown is not None:
        return _AheadWithDate(Ahead(_NOWHERE, None, unknown or NO_TREND), _NOWHERE, None)
    found = trend.trend
    since = None
    if inputs.mileage is not None and len(found.mileage_km):
        since = max(0.0, inputs.mileage.mileage_km - float(found.mileage_km[-1]))
    distance = _each(found.distance_to_limit_km, since or 0.0)
    date = _each(found.date_of_limit_ns, 0.0)
    missing = None in (distance.p10, distance.p50, distance.p90)
    ahead = Ahead(distance, _finite(found.probability_over_limit), BEYOND if missing else None)
    return _AheadWithDate(ahead, date, since)


def _why_unknown(inputs: WorklistInputs, trend: TrendRecord | None, conicity: Estimate) -> Reason | None:
    """Return why nothing is known of the limit; None where something is."""
    if inputs.failure is not None:
        return inputs.failure
    if code_of(conicity.reason) in WITHOUT_GEOMETRY or conicity.status is Status.MODEL_MISMATCH:
        return conicity.reason
    if trend is None:
        return NO_TREND
    if trend.trend.not_comparable is not None:
        return trend.trend.not_comparable
    if trend.trend.status is not Status.ESTIMATED:
        return trend.trend.reason or NO_TREND
    return None


def _each(forecast: Forecast, less: float) -> Forecast:
    """Return the quantiles less a distance, 0 where that is run already."""
    values = (_finite(value) for value in (forecast.p10, forecast.p50, forecast.p90))
    return Forecast(*(None if value is None else max(0.0, value - less) for value in values))


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _published(estimate: Estimate) -> Estimate:
    """Return an estimate that is unknown where a part of it is no finite number."""
    if None not in [_finite(value) for value in (estimate.value, estimate.std, estimate.low, estimate.high)]:
        return estimate
    status = Status.INVALID if estimate.status is Status.ESTIMATED else estimate.status
    return Estimate.unknown(estimate.reason or NOT_FINITE, _finite(estimate.count) or 0.0, status)


def _worst_first(alert: OpenAlert) -> tuple[int, int]:
    return -_SEVERITIES.index(alert.severity), alert.alert_id
