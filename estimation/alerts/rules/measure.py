"""Rule: the wheelset may be beyond its conicity limit, which its data do not decide: measure its profiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.conicity_limit import ConicityLimitRule, conicity_limit_finding
from estimation.alerts.rules.evidence import (
    DecidingEvidence,
    Evidence,
    number_evidence,
    unknown_evidence,
)
from estimation.alerts.rules.intervals import with_standing
from estimation.alerts.rules.limit_state import LimitState, limit_state
from estimation.alerts.rules.rule import AlertRule, Kilometres, WheelsetFacts
from estimation.trend.extrapolation import QUANTITY
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import code_of

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
class MeasureRule(AlertRule):
    """The conicity may be over its limit: not surely enough for `conicity_limit`, too probably to leave it."""

    kind: ClassVar[str] = "measure"
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = MeasureEvidence
    advice: ClassVar[str] = "may be beyond its limit: measure its profiles"
    counts_km: ClassVar[bool] = True
    of_wear: ClassVar[bool] = True
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("clear_probability", "<=", "raise_probability"),
        ("clear_probability", "<=", "extrapolated_probability"),
    )

    raise_probability: Annotated[float, ANY_PROBABILITY] = 0.5  # that it is over where the motion covers 3 mm
    extrapolated_probability: Annotated[float, ANY_PROBABILITY] = 0.12  # and where it does not: no data will decide it
    clear_probability: Annotated[float, ANY_PROBABILITY] = 0.1
    reaches: Annotated[float, Interval(ge=1.0, le=10.0)] = 1.5  # limits that an interval at 3 mm goes up to
    measured_within_km: Kilometres = 10_000.0  # a measurement decides for as long

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding, which stands by all intervals; None without a geometry or a limit."""
        return with_standing(self._find, facts, self.delays)

    def _find(self, facts: WheelsetFacts) -> Finding | None:
        rule, state = facts.limit_rule, limit_state(facts)
        if not isinstance(rule, ConicityLimitRule) or facts.geometry is None or state is None:
            return None
        limit = rule.limit_of(facts)
        if limit is None:
            return None
        decided = conicity_limit_finding(
            rule,
            facts.wheelset.serial,
            state,
            facts.geometry.geometry.windows,
            limit,
            facts.geometry.to_ns,
            not_assessable_reason=facts.not_assessable_reason,
        )
        return measure_finding(self, state, decided, limit, measured=self._is_measured(facts))

    def _is_measured(self, facts: WheelsetFacts) -> bool:
        """Return whether its profiles have been measured within the last kilometres."""
        if facts.geometry is None or facts.profiles_measured_km is None:
            return False
        return facts.geometry.mileage_km - facts.profiles_measured_km <= self.measured_within_km


def measure_finding(rule: MeasureRule, state: LimitState, decided: Finding, limit: float, *, measured: bool) -> Finding:
    """Return whether the profiles are to be measured.

    Args:
        state: What is known of the conicity.
        decided: The finding of the limit's own rule, which goes before.
        limit: Of the conicity at 3 mm.
    """
    at_limit, at_reached = state.at_limit(limit), state.at_reached(limit)
    over = max((one.probability for one in (at_limit, at_reached) if one is not None), default=0.0)
    needed = rule.extrapolated_probability if state.extrapolated else rule.raise_probability
    at_3_mm = 0.0 if at_limit is None else at_limit.probability
    reached = 0.0 if at_reached is None else at_reached.probability
    open_far = not state.extrapolated and (state.conicity.high or 0.0) >= rule.reaches * limit
    unsaid = at_limit is None and (state.reached is not None or state.left_open) and _is_of_data(state, decided)
    may_be = at_3_mm >= needed or reached >= rule.raise_probability or open_far or unsaid
    silent, settled = decided.breached is None and not unsaid, measured or decided.breached is True
    is_clear = at_3_mm <= rule.clear_probability and reached <= rule.clear_probability and not may_be
    return Finding(
        wheelset=decided.wheelset,
        kind=MeasureRule.kind,
        breached=None if silent else may_be and not settled,
        cleared=None if silent else settled or is_clear,
        severity=Severity.WARNING,
        probability=None if silent else number_evidence(over, 3),
        evidence=MeasureEvidence(
            quantity=QUANTITY,
            conicity=state.conicity,
            reached_mm=number_evidence(1e3 * state.reached_amplitude),
            reached=state.conicity if state.reached is None else state.reached,
            limit=number_evidence(limit),
        ).stored()
        | {name: decided.evidence[name] for name in ("windows", *unknown_evidence(None))},
        action="measure_wheel_profiles",
        raise_limit=limit,
        clear_limit=limit,
        measured_ns=decided.measured_ns,
    )


def _is_of_data(state: LimitState, decided: Finding) -> bool:
    """Return whether nothing else hides the state than that the data do not say what is at 3 mm."""
    return decided.breached is not None or decided.evidence["unknown_because_code"] == code_of(state.conicity.reason)
