"""What the operator sets: limits and delays of every rule, with the shipped defaults.

Limits belong to the operator's maintenance plan (EN 15313 leaves them there). The shipped conicity limits are the
combinations of speed and equivalent conicity at which EN 14363 asks for stability to be shown; confirm them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.alerts.identity import IdentityParameters
from estimation.values.alerts import AlertKind

ANY_CLASS = "*"


@dataclass(frozen=True, slots=True)
class AlertDelays:
    """How long something must be so before an alert follows it.

    An evaluation counts only when newer data than the last one are behind it, so that repeating a job never raises or
    clears anything.
    """

    on_evaluations: int = 1
    off_evaluations: int = 2
    acknowledgement_days: float = 90.0  # after which an acknowledgement ends by itself


@dataclass(frozen=True, slots=True)
class SpeedBand:
    """The conicity limit of a vehicle class up to a speed: ``limit + per_km_h * speed``."""

    up_to_km_h: float  # infinity for the last band
    limit: float
    per_km_h: float = 0.0
    vehicle_class: str = ANY_CLASS

    def at(self, speed_km_h: float) -> float:
        """Return the limit at a speed."""
        return self.limit + self.per_km_h * speed_km_h


DEFAULT_BANDS = (
    SpeedBand(120.0, 0.40),
    SpeedBand(300.0, 0.534, -1.0 / 900.0),
    SpeedBand(float("inf"), 0.20),
)


@dataclass(frozen=True, slots=True)
class ConicityLimitRule:
    """Equivalent conicity over its limit for the vehicle's class and greatest speed."""

    enabled: bool = True
    raise_probability: float = 0.9
    clear_probability: float = 0.9
    clear_margin: float = 0.02  # the clear limit lies this far below
    critical_margin: float = 0.05  # critical when over the limit by this much
    minimum_windows: int = 3
    delays: AlertDelays = field(default_factory=AlertDelays)
    bands: tuple[SpeedBand, ...] = DEFAULT_BANDS

    def limit_for(self, vehicle_class: str, speed_km_h: float) -> float | None:
        """Return the limit; bands of the class itself go before those of any class. None where no band applies."""
        for wanted in (vehicle_class, ANY_CLASS):
            bands = sorted((b for b in self.bands if b.vehicle_class == wanted), key=lambda b: b.up_to_km_h)
            for band in bands:
                if speed_km_h <= band.up_to_km_h:
                    return band.at(speed_km_h)
        return None


@dataclass(frozen=True, slots=True)
class LimitForecastRule:
    """The conicity limit is going to be reached within a distance."""

    enabled: bool = True
    within_km: float = 20_000.0
    clear_within_km: float = 30_000.0
    raise_probability: float = 0.5  # that it is reached within within_km
    clear_probability: float = 0.8  # that it is not reached within clear_within_km
    minimum_points: int = 3
    delays: AlertDelays = field(default_factory=AlertDelays)


@dataclass(frozen=True, slots=True)
class WheelAsymmetryRule:
    """Left and right wheel differ: an offset of the rolling line, or unequal tread shapes."""

    enabled: bool = True
    offset_limit_mm: float = 2.0  # lateral displacement at which both wheels roll on one radius
    offset_clear_mm: float = 1.5
    shape_limit_mm: float = 0.5  # even part of the rolling radius difference, outside against inside
    shape_clear_mm: float = 0.35
    raise_probability: float = 0.95
    clear_probability: float = 0.9
    minimum_windows: int = 3
    delays: AlertDelays = field(default_factory=AlertDelays)


@dataclass(frozen=True, slots=True)
class NoDataRule:
    """No window that could be estimated for some days."""

    enabled: bool = True
    days: float = 7.0
    critical_days: float = 28.0
    delays: AlertDelays = field(default_factory=lambda: AlertDelays(off_evaluations=1))


@dataclass(frozen=True, slots=True)
class SensorFaultRule:
    """Too many of the latest windows have a sensor that failed, clips or marks its values invalid."""

    enabled: bool = True
    latest_windows: int = 20
    minimum_windows: int = 3
    raise_share: float = 0.5
    clear_share: float = 0.1
    raise_probability: float = 0.8
    clear_probability: float = 0.8
    clipped_share: float = 0.05  # of a window's samples that makes it faulty
    invalid_share: float = 0.2
    delays: AlertDelays = field(default_factory=AlertDelays)


@dataclass(frozen=True, slots=True)
class IdentityRule:
    """A wheelset is not the one on file, or not the way round; its alert stands until its mounting is corrected."""

    enabled: bool = True
    delays: AlertDelays = field(default_factory=AlertDelays)
    parameters: IdentityParameters = field(default_factory=IdentityParameters)


@dataclass(frozen=True, slots=True)
class StormRule:
    """How many new alerts of one kind in one fleet become one fleet alert."""

    more_than: int = 5
    within_hours: float = 24.0  # between the times at which the first and the last of them were opened


@dataclass(frozen=True, slots=True)
class RuleBook:
    """All rules; ``RuleBook()`` holds the shipped defaults."""

    conicity_limit: ConicityLimitRule = field(default_factory=ConicityLimitRule)
    limit_forecast: LimitForecastRule = field(default_factory=LimitForecastRule)
    wheel_asymmetry: WheelAsymmetryRule = field(default_factory=WheelAsymmetryRule)
    no_data: NoDataRule = field(default_factory=NoDataRule)
    sensor_fault: SensorFaultRule = field(default_factory=SensorFaultRule)
    identity: IdentityRule = field(default_factory=IdentityRule)
    storm: StormRule = field(default_factory=StormRule)

    def delays_of(self, kind: AlertKind) -> AlertDelays:
        """Return the delays of the rule behind an alert kind."""
        return self._rule(kind).delays

    def enabled(self, kind: AlertKind) -> bool:
        """Return whether the rule behind an alert kind is switched on."""
        return self._rule(kind).enabled

    def _rule(
        self, kind: AlertKind
    ) -> ConicityLimitRule | LimitForecastRule | WheelAsymmetryRule | NoDataRule | SensorFaultRule | IdentityRule:
        match kind:
            case AlertKind.CONICITY_LIMIT:
                return self.conicity_limit
            case AlertKind.LIMIT_FORECAST:
                return self.limit_forecast
            case AlertKind.WHEEL_ASYMMETRY:
                return self.wheel_asymmetry
            case AlertKind.NO_DATA:
                return self.no_data
            case AlertKind.SENSOR_FAULT:
                return self.sensor_fault
            case AlertKind.IDENTITY:
                return self.identity
