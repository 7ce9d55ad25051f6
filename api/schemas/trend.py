"""The trend of a wheelset's indicator since its last reprofiling."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, TypeVar

from pydantic import Field

from api.schemas.common import Derived, Links, Representation, Uncertain, finite, segment, uncertain, why
from api.schemas.windows import UnestimatedBecause, unestimated_because
from api.times import Timestamp, to_rfc3339
from estimation.trend.extrapolation import QUANTITY
from estimation.trend.now import BEYOND, QUANTILES, limit_now
from estimation.trend.trend import refresh
from estimation.values import trend as values
from estimation.values.alerts import LimitNow, MileageNow
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import TrendRecord, WearTrend
from estimation.values.windows import WithoutEstimate
from estimation.worklist.row import NO_GEOMETRY, REPROFILED

_NO_POINTS = (
    *("quantity", "slope_per_1000_km", "slope_per_year", "fitted", "limit", "probability_over_limit", "status"),
    *("reason", "converged", "step", "distance_to_limit_km", "date_of_limit_ns", "not_comparable", "few_behind"),
    *("ahead_km", "over_ahead", "raise_probability", "fleet", "origin_km", "calibration"),
)


class TrendPoints(Derived, of=WearTrend, without=_NO_POINTS):
    """The indicator's history, column by column."""

    mileage_km: list[float | None] = Field(description="Mileage of each point; null where unknown.")
    measured_at: list[Timestamp] = Field(description="When each point was measured.")
    value_1: list[float | None] = Field(description="Value of each point.")
    std_1: list[float | None] = Field(description="Standard deviation of each point.")
    noise_1: list[float | None] = Field(description="Part of it that differs from point to point.")


class DistanceForecast(Representation):
    """Quantiles of the distance still to run; null means beyond the horizon or unknown, and `reason` says which."""

    p10: float | None
    p50: float | None
    p90: float | None
    reason: str | None
    reason_code: ReasonCode | None


class DateForecast(Representation):
    """Quantiles of the date; null means beyond the horizon or unknown, and `reason` says which."""

    p10: Timestamp | None
    p50: Timestamp | None
    p90: Timestamp | None
    reason: str | None
    reason_code: ReasonCode | None


ForecastT = TypeVar("ForecastT", DistanceForecast, DateForecast)


class TrendStep(Derived, of=values.TrendStep, without=("found_ns",)):
    """A sudden change of the indicator, which the trend begins behind."""


class LevelCalibration(Derived, of=values.LevelCalibration, without=("measured",)):
    """What measured profiles of the same wheels say of the error that all points have in common."""


class TrendProvenance(Derived, of=TrendRecord, without=("wheelset", "baseline", "trend", "recorded_ns")):
    """What the trend was made from."""


_OF_NOW = (
    *("limit", "distance_to_limit_km", "date_of_limit_ns", "probability_over_limit", "not_comparable", "few_behind"),
    *("ahead_km", "over_ahead", "raise_probability", "fleet", "origin_km"),
)


class Trend(Derived, of=WearTrend, without=("mileage_km", "measured_ns", "value", "std", "noise", *_OF_NOW)):
    """An indicator since the last reprofiling, its robust slope, and when it reaches its limit.

    What is said of the limit is as of `mileage_km`, and the same as in the worklist. Without a trend the numbers are
    null, the points empty, and `reason` and `unestimated_because` explain it.
    """

    wheelset: str = Field(examples=["WS-0001"])
    unestimated_because: UnestimatedBecause | None = Field(
        description="Why nothing is estimated now, by the windows; null where there is a geometry, and with `as_of`."
    )
    baseline: int
    recorded_at: Timestamp | None = Field(description="When it was recorded; null without a trend.")
    points: TrendPoints = Field(description="The points behind it.")
    current_1: Uncertain = Field(
        description="Equivalent conicity at 3 mm of the current geometry: `equivalent_conicity_at_3_mm_1` there."
    )
    current_mileage_km: float | None = Field(description="Mileage that the current geometry is of.")
    limit_1: float | None = Field(description="Conicity limit by class and speed of its vehicle; null without one.")
    probability_over_limit_1: float | None = Field(
        description="That the limit is exceeded at `mileage_km`; null means unknown."
    )
    mileage_km: float | None = Field(description="Newest that is believed, which the distance counts from.")
    since_trend_km: float | None = Field(description="Run since the last point.")
    distance_to_limit_km: DistanceForecast
    date_of_limit: DateForecast
    provenance: TrendProvenance | None = Field(description="What it was made from; null without a trend.")
    links: Links


def forecast_of(
    model: type[ForecastT], read: Callable[[Any], Any], forecast: Mapping[str, Any], unknown: Reason | None
) -> ForecastT:
    """Return quantiles; ``unknown`` is why one is missing, None where it is beyond the horizon."""
    quantiles = {name: read(forecast.get(name)) for name in QUANTILES}
    return model(**quantiles, **why((unknown or BEYOND) if None in quantiles.values() else None))


def _moment(t_ns: float | None) -> str | None:
    value = finite(t_ns)
    return None if value is None or abs(value) >= 2.0**63 else to_rfc3339(int(value))


def distance_forecast(forecast: Forecast, unknown: Reason | None) -> DistanceForecast:
    """Return the quantiles of a distance."""
    return forecast_of(DistanceForecast, finite, asdict(forecast), unknown)


def date_forecast(forecast: Forecast, unknown: Reason | None) -> DateForecast:
    """Return the quantiles of a date."""
    return forecast_of(DateForecast, _moment, asdict(forecast), unknown)


def trend(
    record: TrendRecord,
    current: GeometryRecord | None,
    now: LimitNow | MileageNow | None,
    without: WithoutEstimate | None = None,
) -> Trend:
    """Return the representation of a trend.

    Args:
        now: What is believed now, or at which mileage something was believed; None counts from the last point.
        without: Why there is no geometry now, by its windows.
    """
    recorded_ns = record.recorded_ns if current is None else max(record.recorded_ns, current.recorded_ns)
    shown = _trend(record.wheelset, record.baseline, record.trend, current, now, without)
    path = shown.links["self"]
    shown.links["as_recorded"] = f"{path}?as_of={to_rfc3339(recorded_ns)}"
    of_record = {"recorded_at": to_rfc3339(record.recorded_ns), "provenance": TrendProvenance.made(record)}
    return shown.model_copy(update=of_record)


def no_trend(
    serial: str,
    baseline: int,
    reason: Reason,
    current: GeometryRecord | None,
    now: LimitNow | MileageNow | None = None,
    without: WithoutEstimate | None = None,
) -> Trend:
    """Return the representation of a wheelset that has no trend."""
    unknown = Estimate.unknown(reason)
    nothing = refresh((), math.nan, quantity=QUANTITY)
    nothing = replace(nothing, reason=reason, slope_per_1000_km=unknown, slope_per_year=unknown, fitted=unknown)
    return _trend(serial, baseline, nothing, current, now, without)


def _trend(
    serial: str,
    baseline: int,
    wear: WearTrend,
    current: GeometryRecord | None,
    now: LimitNow | MileageNow | None,
    without: WithoutEstimate | None,
) -> Trend:
    of_profile = None if current is None or current.baseline != baseline else current
    if not isinstance(now, LimitNow):
        unknown = Estimate.unknown(REPROFILED if baseline else NO_GEOMETRY)
        now = limit_now(None if of_profile is None else of_profile.geometry, wear, wear.limit, now, unknown)
    path = f"/v1/wheelsets/{segment(serial)}"
    return Trend.made(
        wear,
        wheelset=serial,
        **why(wear.reason if without is None else without.reason),
        unestimated_because=unestimated_because(without),
        baseline=baseline,
        recorded_at=None,
        points=TrendPoints.made(wear),
        current_1=uncertain(now.conicity),
        current_mileage_km=None if of_profile is None else finite(of_profile.mileage_km),
        limit_1=now.limit,
        probability_over_limit_1=now.probability_over_limit,
        mileage_km=None if now.mileage is None else finite(now.mileage.mileage_km),
        since_trend_km=now.since_trend_km,
        distance_to_limit_km=distance_forecast(now.distance_to_limit_km, now.forecast_reason),
        date_of_limit=date_forecast(now.date_of_limit_ns, now.forecast_reason),
        provenance=None,
        links={
            "self": f"{path}/trend",
            "wheelset": path,
            "geometry": f"{path}/geometry",
            "alerts": f"/v1/alerts?wheelset={segment(serial)}",
        },
    )


def table(trend_: Trend) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the points as a header and rows."""
    header = ["mileage_km", "measured_at", "value_1", "std_1"]
    return header, list(zip(*(getattr(trend_.points, name) for name in header), strict=True))
