"""Alert rules: their configuration, and one pure function a rule from values to a finding."""

from __future__ import annotations

from estimation.rules.book import (
    AlertDelays,
    ConicityLimitRule,
    IdentityRule,
    LimitForecastRule,
    NoDataRule,
    RuleBook,
    SensorFaultRule,
    SpeedBand,
    StormRule,
    WheelAsymmetryRule,
)
from estimation.rules.conicity_limit import conicity_limit_finding
from estimation.rules.identity import Break, identity_finding
from estimation.rules.limit_forecast import limit_forecast_finding
from estimation.rules.loading import load_rules
from estimation.rules.no_data import no_data_finding
from estimation.rules.sensor_fault import sensor_fault_finding
from estimation.rules.wheel_asymmetry import Asymmetry, asymmetry_of, wheel_asymmetry_finding

__all__ = [
    "AlertDelays",
    "Asymmetry",
    "Break",
    "ConicityLimitRule",
    "IdentityRule",
    "LimitForecastRule",
    "NoDataRule",
    "RuleBook",
    "SensorFaultRule",
    "SpeedBand",
    "StormRule",
    "WheelAsymmetryRule",
    "asymmetry_of",
    "conicity_limit_finding",
    "identity_finding",
    "limit_forecast_finding",
    "load_rules",
    "no_data_finding",
    "sensor_fault_finding",
    "wheel_asymmetry_finding",
]
