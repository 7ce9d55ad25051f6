"""Rules: equivalent conicity over the limit of the vehicle's class and speed, or not known well enough to say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Interval

from estimation.alerts.rules.rule import (
    IntervalsRule,
    Kilometres,
    Probability,
    WheelsetFacts,
    WindowCount,
    too_few_windows,
)
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, QUANTITY
from estimation.trend.now import SCALE, LimitState, limit_now, limit_state
from estimation.values.alerts import DecidingEvidence, Finding, LimitNow, Severity, number_evidence, unknown_evidence
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, code_of
from estimation.values.registry import VehicleRecord
from estimation.values.units import KM_H_IN_M_S

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
class ConicityLimitRule(IntervalsRule):
    """Equivalent conicity over its limit for the vehicle's class and greatest speed."""

    kind = "conicity_limit"
    limit_unit = "1"
    evidence = ConicityLimitEvidence

    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.9
    clear_margin: float = 0.02  # of the clear limit below the raise limit
    minimum_windows: WindowCount = 3
    bands: tuple[SpeedBand, ...] = DEFAULT_BANDS

    def limit_for(self, vehicle: VehicleRecord) -> float | None:
        """Return the limit of a vehicle; None where no band applies."""
        speed_km_h = round(KM_H_IN_M_S * vehicle.max_speed_m_s, SPEED_DIGITS)
        return self.limit_at(vehicle.vehicle_class, speed_km_h)

    def limit_at(self, vehicle_class: str, speed_km_h: float) -> float | None:
        """Return the limit; bands of the class itself go before those of any class. None where no band applies."""
        for band in (*self._bands(vehicle_class), *self._bands(ANY_CLASS)):
            if speed_km_h <= band.up_to_km_h:
                return band.at(speed_km_h)
        return None

    def _bands(self, vehicle_class: str) -> Sequence[SpeedBand]:
        return sorted((b for b in self.bands if b.vehicle_class == vehicle_class), key=lambda b: b.up_to_km_h)

    def find_now(self, facts: WheelsetFacts) -> Finding | None:
        """Return the finding on the limit, by the conicity at 3 mm, or at the amplitude reached where that is less."""
        # at 3 mm it is that of the fitted trend, or of the current geometry where no trend is comparable with the limit
        believed = self.believed(facts)
        return None if believed is None else self.decided(facts, believed)

    def decided(self, facts: WheelsetFacts, believed: Believed) -> Finding:
        """Return the finding on the limit by what is believed of the current geometry."""
        assert facts.geometry is not None  # without one nothing is believed
        return conicity_limit_finding(
            self,
            facts.wheelset.serial,
            believed,
            facts.geometry.geometry.windows,
            facts.geometry.to_ns,
            not_assessable_reason=facts.not_assessable_reason,
        )

    def believed(self, facts: WheelsetFacts) -> Believed | None:
        """Return what is known of the conicity of a wheelset and its limit; None without a geometry or a limit."""
        limit = None if facts.vehicle is None else self.limit_for(facts.vehicle)
        if facts.geometry is None or limit is None:
            return None
        geometry, record = facts.geometry.geometry, facts.current_trend
        trend = None if record is None else replace(record.trend, raise_probability=self.raise_probability)
        return Believed(limit_state(geometry, trend), limit, limit_now(geometry, trend, limit, facts.mileage))


@dataclass(frozen=True, slots=True)
class Believed:
    """What the data show of the conicity, its limit, and what is therefore believed now."""

    state: LimitState
    limit: float
    now: LimitNow


def conicity_limit_finding(
    rule: ConicityLimitRule,
    wheelset: str,
    believed: Believed,
    windows: int,
    measured_ns: int,
    *,
    not_assessable_reason: Reason | None = None,
) -> Finding:
    """Return the finding on the limit by the conicity: the data decide, and the alert says what is believed now."""
    state, limit, now = believed.state, believed.limit, believed.now
    against = state.against(limit)
    reason = not_assessable_reason or too_few_windows(windows, rule.minimum_windows)
    if reason is None and against is None:
        reason = state.conicity.reason
    over = None if reason or against is None else against.probability
    clear_limit = limit - rule.clear_margin
    severity = SCALE.severity(now.probability_over_limit)
    return Finding(
        wheelset=wheelset,
        kind=ConicityLimitRule.kind,
        breached=None if over is None else over >= rule.raise_probability,
        cleared=None if over is None else _is_clear(rule, state, clear_limit),
        severity=severity,
        probability=None if over is None else number_evidence(now.probability_over_limit, 3),
        evidence=ConicityLimitEvidence(
            quantity=QUANTITY,
            amplitude_mm=number_evidence(1e3 * (LIMIT_AMPLITUDE if against is None else against.amplitude)),
            conicity=state.conicity if against is None else against.conicity,
            current=now.conicity,
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
    at_limit, at_reached = state.at_limit(clear_limit), state.at_reached(clear_limit)
    if at_reached is not None and at_reached.probability >= rule.raise_probability:
        return False
    return None if at_limit is None else 1.0 - at_limit.probability >= rule.clear_probability


ANY_PROBABILITY = Interval(ge=0.01, le=0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureEvidence(DecidingEvidence):
    """Evidence of `measure`: the conicity may be over its limit, and only a measurement of the profiles decides."""

    quantity: Annotated[str, Served("What is compared with the limit.", example="equivalent_conicity")]
    conicity: Annotated[Estimate, Served("Equivalent conicity at 3 mm; its reason says if extrapolated.", "conicity_1")]
    reached_mm: Annotated[float | None, Served("Largest amplitude that the motion covers, at most 3 mm.")]
    reached: Annotated[Estimate, Served("Equivalent conicity at that amplitude.", "reached_1")]
    windows: Annotated[int | None, Served("Windows behind the geometry.")] = None
    limit: Annotated[float | None, Served("Limit of the conicity at 3 mm.", "limit_1")]


@dataclass(frozen=True, slots=True)
class MeasureRule(IntervalsRule):
    """The conicity may be over its limit: not surely enough for `conicity_limit`, too probably to leave it."""

    kind = "measure"
    limit_unit = "1"
    evidence = MeasureEvidence
    advice = "may be beyond its limit: measure its profiles"
    relations = (
        ("clear_probability", "<=", "raise_probability"),
        ("clear_probability", "<=", "extrapolated_probability"),
    )

    raise_probability: Annotated[float, ANY_PROBABILITY] = 0.5  # that it is over where the motion covers 3 mm
    extrapolated_probability: Annotated[float, ANY_PROBABILITY] = 0.12  # and where it does not: no data will decide it
    clear_probability: Annotated[float, ANY_PROBABILITY] = 0.1
    reaches: Annotated[float, Interval(ge=1.0, le=10.0)] = 1.5  # limits that an interval at 3 mm goes up to
    measured_within_km: Kilometres = 10_000.0  # a measurement decides for as long

    def find_now(self, facts: WheelsetFacts) -> Finding | None:
        """Return the finding; None without a geometry or a limit."""
        rule = facts.limit_rule
        believed = rule.believed(facts) if isinstance(rule, ConicityLimitRule) else None
        if not isinstance(rule, ConicityLimitRule) or facts.geometry is None or believed is None:
            return None
        at_km = facts.profiles_measured_km
        measured = at_km is not None and facts.geometry.mileage_km - at_km <= self.measured_within_km
        return measure_finding(self, believed, rule.decided(facts, believed), measured=measured)


def measure_finding(rule: MeasureRule, believed: Believed, decided: Finding, *, measured: bool) -> Finding:
    """Return whether the profiles are to be measured."""
    state, limit, now = believed.state, believed.limit, believed.now
    at_limit, at_reached = state.at_limit(limit), state.at_reached(limit)
    over = max((against.probability for against in (at_limit, at_reached) if against is not None), default=None)
    needed = rule.extrapolated_probability if state.extrapolated else rule.raise_probability
    at_3_mm = 0.0 if at_limit is None else at_limit.probability
    reached = 0.0 if at_reached is None else at_reached.probability
    open_far = not state.extrapolated and (state.conicity.high or 0.0) >= rule.reaches * limit
    unsaid = (
        at_limit is None
        and (state.reached is not None or state.left_open)
        and (decided.breached is not None or decided.evidence["unknown_because_code"] == code_of(state.conicity.reason))
    )  # nothing else hides the state
    may_be = at_3_mm >= needed or reached >= rule.raise_probability or open_far or unsaid
    silent, decisive = decided.breached is None and not unsaid, measured or decided.breached is True
    is_clear = at_3_mm <= rule.clear_probability and reached <= rule.clear_probability and not may_be
    return Finding(
        wheelset=decided.wheelset,
        kind=MeasureRule.kind,
        breached=None if silent else may_be and not decisive,
        cleared=None if silent else decisive or is_clear,
        probability=None if silent else number_evidence(over, 3),
        evidence=MeasureEvidence(
            quantity=QUANTITY,
            conicity=now.conicity,
            reached_mm=number_evidence(1e3 * state.reached_amplitude),
            reached=now.conicity if state.reached is None else state.reached,
            limit=number_evidence(limit),
        ).stored()
        | {name: decided.evidence[name] for name in ("windows", *unknown_evidence(None))},
        action="measure_wheel_profiles",
        raise_limit=limit,
        clear_limit=limit,
        measured_ns=decided.measured_ns,
    )
