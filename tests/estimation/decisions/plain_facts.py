"""Facts about one wheelset, made without a simulation, for the limits of the alert rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from believed_now import ahead_of, believed, with_ahead
from scipy import stats
from wheelset_life import geometry_of, known

from estimation.alerts.rules.conicity_limit import ConicityLimitRule, conicity_limit_finding
from estimation.alerts.rules.rule import (
    WheelsetFacts,
)
from estimation.alerts.rules.trend import LimitForecastRule, limit_forecast_finding
from estimation.alerts.rules.wheels import Asymmetry, WheelAsymmetryRule, wheel_asymmetry_finding
from estimation.trend.now import LimitState
from estimation.values.alerts import Alert, Condition, Finding, Severity
from estimation.values.geometry import GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord, WearTrend

MOUNTING = Mounting("W", "V", 1, 100, None, 0.0, 0.0)


WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, MOUNTING)


VEHICLE = VehicleRecord("V", "F", "metro", 4, 100.0 / 3.6, (0.0, 2.5, 15.0, 17.5))


BELOW = geometry_of(conicity=0.2)  # the limit
OTHER = Reason(ReasonCode.SENSOR_FAULTY, "faulty")


def above(probability: float, limit: float, std: float) -> Estimate:
    """Return an estimate that is above a limit with a probability."""
    return known(limit + std * float(stats.norm.ppf(probability)), std)


def geometry_record(geometry: WheelsetGeometry, *, baseline: int = 0, to_ns: int = 500) -> GeometryRecord:
    return GeometryRecord("W", baseline, None, 1.0, 200, to_ns, geometry, "d", {}, {}, "test", 1)


def trend_of(*, fitted: Estimate | None = None, points: int = 3, probability: float | None = 0.0) -> WearTrend:
    trend = WearTrend(
        quantity="conicity at 2 mm",
        mileage_km=np.arange(points, dtype=float),
        measured_ns=np.arange(points),
        value=np.full(points, 0.3),
        std=np.full(points, 0.01),
        noise=np.full(points, 0.01),
        slope_per_1000_km=known(0.01, 0.001),
        slope_per_year=known(0.01, 0.001),
        fitted=fitted or known(0.3, 0.01),
        limit=0.4,
        distance_to_limit_km=Forecast(10_000.0, 20_000.0, 30_000.0),
        date_of_limit_ns=Forecast(1.0, 2.0, 3.0),
        probability_over_limit=probability,
        status=Status.ESTIMATED,
    )
    return with_ahead(trend)


def facts_of(**changes: object) -> WheelsetFacts:
    plain = WheelsetFacts(
        wheelset=WHEELSET,
        vehicle=VEHICLE,
        geometry=geometry_record(geometry_of(conicity=0.6)),
        trend=None,
        windows=(),
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def trend_record(trend: WearTrend, baseline: int = 0) -> TrendRecord:
    return TrendRecord("W", baseline, trend, "d", "test", 1)


def conicity_at(value: Estimate, windows: int = 3) -> Finding:
    return conicity_limit_finding(ConicityLimitRule(), "W", believed(LimitState(value)), windows, 5)


def forecast(trend: WearTrend) -> Finding:
    return limit_forecast_finding(LimitForecastRule(), "W", trend, ahead_of(BELOW, trend), 5)


def at_km(p10: float, p50: float, p90: float) -> WearTrend:
    return with_ahead(replace(trend_of(), distance_to_limit_km=Forecast(p10, p50, p90)))


def asymmetry(offset: Estimate | None = None, shape: Estimate | None = None, windows: int = 3) -> Finding:
    both = Asymmetry(offset or known(0.0, 1e-6), shape or known(0.0, 1e-6))
    return wheel_asymmetry_finding(WheelAsymmetryRule(), "W", both, windows, 5)


def open_alert(kind: str, evidence: object = None, opened_ns: int = 200) -> Alert:
    return Alert(
        alert_id=1,
        fleet="F",
        wheelset="W",
        kind=kind,
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=opened_ns,
        last_seen_ns=250,
        occurrence_count=1,
        probability=None,
        evidence=evidence or {},  # type: ignore[arg-type]
        action="",
        raise_limit=None,
        clear_limit=None,
    )
