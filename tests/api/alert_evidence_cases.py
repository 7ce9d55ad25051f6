"""A finding of every rule, and how its evidence is answered."""

from __future__ import annotations

from typing import Any

import numpy as np
from believed_now import believed, limit_of
from windows_finding import silence_finding, windows_finding

from api.times import to_rfc3339
from estimation.alerts.identity import IdentityEvent, Mistake
from estimation.alerts.rules.conicity_limit import (
    ConicityLimitRule,
    MeasureRule,
    conicity_limit_finding,
    measure_finding,
)
from estimation.alerts.rules.running_gear import (
    HuntingRule,
    LowAdhesionRule,
    SuspensionChangeRule,
    WeakDamperRule,
    section_finding,
    suspension_change_finding,
    weak_damper_finding,
)
from estimation.alerts.rules.sensor_data import (
    DataQualityRule,
    NoDataRule,
    SensorFaultRule,
    identity_finding,
)
from estimation.alerts.rules.trend import (
    LimitForecastRule,
    UnregisteredChangeRule,
    limit_forecast_finding,
    unregistered_change_finding,
)
from estimation.alerts.rules.wheels import (
    Asymmetry,
    WheelAsymmetryRule,
    WheelFlatRule,
    wheel_asymmetry_finding,
)
from estimation.trend.now import LimitState
from estimation.values.alerts import Finding
from estimation.values.opinions import CellFriction, GearDamper, SectionAdhesion
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.registry import Mounting
from estimation.values.trend import StepSurroundings, SuspensionChange, TrendStep, WearTrend

AT = 1_767_225_600_123_456_789
WHOLE = AT - AT % 10**9
HIGH = Estimate(0.5, 0.01, 0.48, 0.52, 12.0, Status.ESTIMATED)
MOUNTING = Mounting("W", "V-1", 3, AT, None, 0.0, 0.0)
ESTIMATE = {"value": 0.5, "std": 0.01, "interval_95": [0.48, 0.52], "n_windows": 12.0, "status": "estimated"}
UNEXPLAINED = {"reason": None, "reason_code": None}
STEP = TrendStep(
    before_km=41_000.0,
    after_km=42_000.0,
    before_ns=AT - 10**9,
    after_ns=AT,
    found_ns=AT + 10**9,
    size=Estimate(-0.2, 0.01, -0.22, -0.18, 4.0, Status.ESTIMATED),
    level_before=0.3,
    amplitude=2.5e-3,
    probability=0.99,
    before=30,
    behind=4,
)
TREND = WearTrend(
    quantity="equivalent_conicity",
    mileage_km=np.arange(3.0),
    measured_ns=np.arange(3),
    value=np.full(3, 0.3),
    std=np.full(3, 0.01),
    noise=np.full(3, 0.004),
    slope_per_1000_km=HIGH,
    slope_per_year=HIGH,
    fitted=HIGH,
    limit=0.4,
    distance_to_limit_km=Forecast(1000.0, 2000.0, None),
    date_of_limit_ns=Forecast(float(AT), float(AT + 10**15), None),
    probability_over_limit=0.0,
    status=Status.ESTIMATED,
)
AHEAD = limit_of(0.0, HIGH, distance_km=TREND.distance_to_limit_km, date_ns=TREND.date_of_limit_ns)
DECIDES = {"unknown_because": None, "unknown_because_code": None}
NO_WINDOWS = {"unknown_because": "0 windows, 3 needed", "unknown_because_code": "too_few_windows", "windows": 0}


def weak_damper() -> GearDamper:
    share = Estimate(0.3, 0.05, 0.2, 0.4, 9.0, Status.ESTIMATED)
    return GearDamper(
        "V-1", 3, share, 0.99, weak=True, windows=9, diverged=1, refused=0, from_ns=1, to_ns=AT, from_km=1.0, to_km=2.0
    )


CASES: list[tuple[Finding | None, dict[str, Any]]] = [
    (
        conicity_limit_finding(ConicityLimitRule(), "W", believed(LimitState(HIGH)), 5, AT),
        {
            "quantity": "equivalent_conicity",
            "amplitude_mm": 3.0,
            "conicity_1": ESTIMATE | UNEXPLAINED,
            "current_1": ESTIMATE | UNEXPLAINED,
            "windows": 5,
            "limit_1": 0.4,
            **DECIDES,
        },
    ),
    (
        measure_finding(
            MeasureRule(),
            believed(LimitState(HIGH)),
            conicity_limit_finding(ConicityLimitRule(), "W", believed(LimitState(HIGH)), 5, AT),
            measured=False,
        ),
        {
            "quantity": "equivalent_conicity",
            "conicity_1": ESTIMATE | UNEXPLAINED,
            "reached_mm": 3.0,
            "reached_1": ESTIMATE | UNEXPLAINED,
            "windows": 5,
            "limit_1": 0.4,
            **DECIDES,
        },
    ),
    (
        limit_forecast_finding(LimitForecastRule(), "W", TREND, AHEAD, AT),
        {
            "quantity": "equivalent_conicity",
            "slope_1_per_1000_km": ESTIMATE | UNEXPLAINED,
            "fitted_1": ESTIMATE | UNEXPLAINED,
            "probability_over_limit_1": 0.0,
            "distance_to_limit_km": {
                "p10": 1000.0,
                "p50": 2000.0,
                "p90": None,
                "reason": "not reached within the forecast horizon",
                "reason_code": "beyond_horizon",
            },
            "date_of_limit": {
                "p10": "2026-01-01T00:00:00Z",
                "p50": "2026-01-12T13:46:40Z",
                "p90": None,
                "reason": "not reached within the forecast horizon",
                "reason_code": "beyond_horizon",
            },
            "within_km": 20000.0,
            "limit_1": 0.4,
            "points": 3,
            **DECIDES,
        },
    ),
    (
        wheel_asymmetry_finding(
            WheelAsymmetryRule(), "W", Asymmetry(Estimate(4e-3, 1e-4, 3e-3, 5e-3, 9.0, Status.ESTIMATED), HIGH), 5, AT
        ),
        {
            "offset_mm": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": 4.0,
                "std": 0.1,
                "interval_95": [3.0, 5.0],
                "n_windows": 9.0,
            },
            "shape_mm": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": 500.0,
                "std": 10.0,
                "interval_95": [480.0, 520.0],
            },
            "raised_by": ["offset", "shape"],
            "windows": 5,
            **DECIDES,
        },
    ),
    (
        silence_finding(NoDataRule(), AT, AT - 5 * 10**9, AT + 40 * 86_400 * 10**9),
        {
            "last_usable_at": "2026-01-01T00:00:00.123456789Z",
            "in_service_since": "2025-12-31T23:59:55.123456789Z",
            "limit_days": 28.0,
            "refused_windows": 0,
            "reasons": {},
            "reason": None,
        },
    ),
    (
        windows_finding(SensorFaultRule(), mounted_ns=AT),
        {"faulty_windows": 0, "reasons": {}, **NO_WINDOWS},
    ),
    (
        identity_finding(IdentityEvent("W", Mistake.SWAPPED, "W2", AT, AT + 1, AT + 2, 7.0, 0.5), MOUNTING, None),
        {
            "mistake": "swapped",
            "partner": "W2",
            "last_data_before_at": "2026-01-01T00:00:00.123456789Z",
            "first_data_after_at": "2026-01-01T00:00:00.12345679Z",
            "jump_1": 7.0,
            "left_1": 0.5,
            "reason": "the geometry has become that of another wheelset, and the other's has become this one's",
            "mounted": {
                "vehicle": "V-1",
                "axle": 3,
                "reversed": False,
                "mounted_from": "2026-01-01T00:00:00.123456789Z",
            },
        },
    ),
    (
        windows_finding(HuntingRule(), mounted_ns=AT),
        {
            "hunting_windows": 0,
            "frequency_hz": None,
            "wavelength_m": None,
            "amplitude_mm": None,
            "speed_max_km_h": None,
            **NO_WINDOWS,
        },
    ),
    (
        suspension_change_finding(SuspensionChangeRule(), "W", SuspensionChange("V-1", -0.5, 0.1, 9, 3, 4, AT)),
        {
            "vehicle": "V-1",
            "change_1": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": -0.5,
                "std": 0.1,
                "interval_95": [-0.695996, -0.304004],
                "n_windows": 3.0,
            },
            "step_probability_1": None,
            "step_at": None,
            "past_findings": 9,
            "recent_findings": 3,
            "other_vehicles": 4,
            "limit_1": 0.2,
        },
    ),
    (
        windows_finding(DataQualityRule(), mounted_ns=AT),
        {
            "implausible_windows": 0,
            "reasons": {},
            "rejected_recordings": 0,
            "rejected_reasons": {},
            **NO_WINDOWS,
        },
    ),
    (
        section_finding(
            LowAdhesionRule(),
            SectionAdhesion(
                "S",
                AT - 10**9,
                AT,
                8,
                (CellFriction(2, Estimate(0.1, 0.01, 0.08, 0.12, 5.0, Status.ESTIMATED), 0.08, 0.97, 5),),
                ((100.0, 150.0),),
            ),
        ),
        {
            "track_section": "S",
            "stretches": [{"from_m": 100.0, "to_m": 150.0}],
            "friction_1": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": 0.1,
                "std": 0.01,
                "interval_95": [0.08, 0.12],
                "n_windows": 5.0,
            },
            "passes": 5,
            "windows": 8,
            "measured_from": to_rfc3339(AT - 10**9),
            "measured_to": to_rfc3339(AT),
            "limit_1": 0.15,
        },
    ),
    (
        weak_damper_finding(
            WeakDamperRule(),
            "W",
            weak_damper(),
        ),
        {
            "vehicle": "V-1",
            "first_axle": 3,
            "damping_share_1": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": 0.3,
                "std": 0.05,
                "interval_95": [0.2, 0.4],
                "n_windows": 9.0,
            },
            "windows": 9,
            "measured_from": to_rfc3339(1),
            "measured_to": to_rfc3339(AT),
            "limit_1": 0.5,
            "unknown_because": None,
            "unknown_because_code": None,
        },
    ),
    (
        unregistered_change_finding(UnregisteredChangeRule(), "W", STEP, StepSurroundings()),
        {
            "last_data_before_at": to_rfc3339(AT - 10**9),
            "first_data_behind_at": to_rfc3339(AT),
            "before_km": 41_000.0,
            "after_km": 42_000.0,
            "size_1": {
                **ESTIMATE,
                **UNEXPLAINED,
                "value": -0.2,
                "std": 0.01,
                "interval_95": [-0.22, -0.18],
                "n_windows": 4.0,
            },
            "level_before_1": 0.3,
            "amplitude_mm": 2.5,
            "intervals_before": 30,
            "intervals_behind": 4,
            "causes": [
                {"cause": "turned", "share_1": 0.69, "left_1": 0.0},
                {"cause": "exchanged", "share_1": 0.31, "left_1": 0.0},
                {"cause": "sensor", "share_1": 0.0005, "left_1": 0.0},
                {"cause": "damaged", "share_1": 7.7e-08, "left_1": 20.0},
                {"cause": "turned_end_for_end", "share_1": 2.1e-08, "left_1": 8.9},
            ],
            "reason": "the conicity has fallen by 0.20 at 42,000 km, which no event on file explains: turned or "
            "exchanged; register what happened",
        },
    ),
    (
        windows_finding(WheelFlatRule()),
        {
            "striking_windows": 0,
            "blow_m_s2": None,
            "wheel": None,
            "turn_m": None,
            "speed_max_km_h": None,
            **NO_WINDOWS,
        },
    ),
]
