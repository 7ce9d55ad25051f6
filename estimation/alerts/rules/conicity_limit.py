"""Rule: equivalent conicity over the limit of the vehicle's class and speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.evidence import (
    DecidingEvidence,
    Evidence,
    number_evidence,
)
from estimation.alerts.rules.intervals import with_standing
from estimation.alerts.rules.limit_state import Against, LimitState, limit_state
from estimation.alerts.rules.rule import AlertRule, Probability, WheelsetFacts, WindowCount, too_few_windows
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, QUANTITY, conicity_at_limit_amplitude
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason
from estimation.values.registry import VehicleRecord

ANY_CLASS = "*"
SPEED_DIGITS = 6  # of km/h: 120 km/h in m/s and back is 120.00000000000001, which belongs to the band up to 120


@dataclass(frozen=True, slots=True)
class SpeedBand:
    """The conicity limit of a vehicle class up to a speed: ``limit + per_km_h * speed``."""

    limit: Annotated[float, Interval(ge=0.001, le=2.0)]
    up_to_km_h: Annotated[float, Interval(ge=1.0)] = float("inf")
    per_km_h: Annotated[float, Interval(ge=-1.0, le=1.0)] = 0.0
    vehicle_class: str = ANY_CLASS

    def at(self, speed_km_h: float) -> float:
        """Return the limit."""
        return self.limit + self.per_km_h * speed_km_h


DEFAULT_BANDS = (SpeedBand(0.40, 120.0), SpeedBand(0.534, 300.0, -1.0 / 900.0), SpeedBand(0.20))


@dataclass(frozen=True, slots=True, kw_only=True)
class ConicityLimitEvidence(DecidingEvidence):
    """Evidence of `conicity_limit`: equivalent conicity against its limit."""

    quantity: Annotated[str, Served("What is compared with the limit.", example="equivalent_conicity")]
    amplitude_mm: Annotated[float | None, Served("Amplitude that the conicity is of.")]
    conicity: Annotated[Estimate, Served("Equivalent conicity that is compared with the limit.", "conicity_1")]
    current: Annotated[Estimate, Served("Equivalent conicity of the current geometry.", "current_1")]
    windows: Annotated[int, Served("Windows behind the geometry.")]
    limit: Annotated[float | None, Served("The raise limit.", "limit_1")]


@dataclass(frozen=True, slots=True)
class ConicityLimitRule(AlertRule):
    """Equivalent conicity over its limit for the vehicle's class and greatest speed."""

    kind: ClassVar[str] = "conicity_limit"
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = ConicityLimitEvidence
    counts_km: ClassVar[bool] = True
    of_wear: ClassVar[bool] = True

    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.9
    clear_margin: float = 0.02  # of the clear limit below the raise limit
    critical_margin: float = 0.05  # critical when over the limit by this much
    minimum_windows: WindowCount = 3
    bands: tuple[SpeedBand, ...] = DEFAULT_BANDS

    def limit_for(self, vehicle: VehicleRecord) -> float | None:
        """Return the limit of a vehicle; None where no band applies."""
        speed_km_h = round(3.6 * vehicle.max_speed_m_s, SPEED_DIGITS)
        return self.limit_at(vehicle.vehicle_class, speed_km_h)

    def limit_at(self, vehicle_class: str, speed_km_h: float) -> float | None:
        """Return the limit; bands of the class itself go before those of any class. None where no band applies."""
        for band in (*self._bands(vehicle_class), *self._bands(ANY_CLASS)):
            if speed_km_h <= band.up_to_km_h:
                return band.at(speed_km_h)
        return None

    def _bands(self, vehicle_class: str) -> Sequence[SpeedBand]:
        return sorted((b for b in self.bands if b.vehicle_class == vehicle_class), key=lambda b: b.up_to_km_h)

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding on the limit, by the conicity at 3 mm, or at the amplitude reached where that is less.

        At 3 mm it is that of the fitted trend, or of the current geometry where no trend is comparable with the limit.
        An alert stands by all intervals of mileage.
        """
        return with_standing(self._find, facts, self.delays)

    def _find(self, facts: WheelsetFacts) -> Finding | None:
        limit, state = self.limit_of(facts), limit_state(facts)
        if facts.geometry is None or limit is None or state is None:
            return None
        return conicity_limit_finding(
            self,
            facts.wheelset.serial,
            state,
            facts.geometry.geometry.windows,
            limit,
            facts.geometry.to_ns,
            current=conicity_at_limit_amplitude(facts.geometry.geometry),
            not_assessable_reason=facts.not_assessable_reason,
        )

    def limit_of(self, facts: WheelsetFacts) -> float | None:
        """Return the limit of a wheelset; None in no vehicle, or where no band applies."""
        return None if facts.vehicle is None else self.limit_for(facts.vehicle)


def conicity_limit_finding(
    rule: ConicityLimitRule,
    wheelset: str,
    state: LimitState,
    windows: int,
    limit: float,
    measured_ns: int,
    *,
    current: Estimate | None = None,
    not_assessable_reason: Reason | None = None,
) -> Finding:
    """Return the finding on the limit by the conicity.

    Args:
        state: The conicity at 3 mm now, and what else is compared with the limit.
        windows: Windows behind it.
        measured_ns: Time of the newest data behind the conicity.
        current: That of the current geometry, where the conicity is of the trend.
        not_assessable_reason: Why the data do not describe the present wheelset (silent, sensor fault, reprofiled
            since); None where they do.
    """
    against = state.against(limit)
    reason = not_assessable_reason or too_few_windows(windows, rule.minimum_windows)
    if reason is None and against is None:
        reason = state.conicity.reason
    over = None if reason or against is None else against.probability
    clear_limit = limit - rule.clear_margin
    severity = Severity.WARNING
    if _probability(state.against(limit + rule.critical_margin)) >= rule.raise_probability:
        severity = Severity.CRITICAL
    return Finding(
        wheelset=wheelset,
        kind=ConicityLimitRule.kind,
        breached=None if over is None else over >= rule.raise_probability,
        cleared=None if over is None else _is_clear(rule, state, clear_limit),
        severity=severity,
        probability=number_evidence(over, 3),
        evidence=ConicityLimitEvidence(
            quantity=QUANTITY,
            amplitude_mm=number_evidence(1e3 * (LIMIT_AMPLITUDE if against is None else against.amplitude)),
            conicity=state.conicity if against is None else against.conicity,
            current=state.conicity if current is None else current,
            windows=windows,
            limit=number_evidence(limit),
            unknown=reason,
        ).stored(),
        action="reprofile" if severity is Severity.CRITICAL else "plan_reprofiling",
        raise_limit=limit,
        clear_limit=clear_limit,
        measured_ns=measured_ns,
    )


def _is_clear(rule: ConicityLimitRule, state: LimitState, clear_limit: float) -> bool | None:
    """Return whether the conicity is below the clear limit at every amplitude that is known; None where 3 mm is not."""
    at_limit, at_reached = state.at_limit(clear_limit), state.at_reached(clear_limit)
    if _probability(at_reached) >= rule.raise_probability:
        return False
    return None if at_limit is None else 1.0 - at_limit.probability >= rule.clear_probability


def _probability(against: Against | None) -> float:
    return 0.0 if against is None else against.probability
