"""A row of the worklist from what is stored of a wheelset, and what its windows wait for: nothing is estimated again.

What is not known is never taken for good: a wheelset without a number to trust comes before all that are known to last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

from estimation.alerts.rule_book import ALERT_RULES
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, MeasureRule
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.alerts.rules.trend import LimitForecastRule
from estimation.trend.now import BEYOND, SCALE, limit_now
from estimation.values.alerts import (
    AxlePosition,
    BogiePlace,
    Condition,
    LimitNow,
    OpenAlert,
    Severity,
    Urgency,
    WorklistRow,
    WorklistState,
)
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, utc_text
from estimation.values.runs import JobOutcome, JobRun, Quarantined
from estimation.values.track import AlignmentRecord, AlignmentSource
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE
from estimation.worklist.stored import WorklistInputs

TURN, MEASURE = "turn the wheelset, or measure its profiles", "measure its profiles"
ADVICE = {rule.kind: rule.advice for rule in ALERT_RULES if rule.advice}
HIDING = {rule.kind: rule.hides_wear for rule in ALERT_RULES if rule.hides_wear is not None}
URGENCY_OF = {Severity.CRITICAL: Urgency.CRITICAL_ALERT, Severity.WARNING: Urgency.WATCH}
OF_LIMIT = (ConicityLimitRule.kind, LimitForecastRule.kind)
EXCEEDED = {Urgency.OVER_LIMIT: "limit exceeded", Urgency.PROBABLY_OVER: "limit probably exceeded"}
_Why = tuple[Urgency, Reason]


def judged(
    *, mounted: bool, now: LimitNow, alerts: Sequence[OpenAlert], last_ns: int | None, refused: bool = False
) -> tuple[Urgency, tuple[Reason, ...]]:
    """Return how urgent a wheelset is, and why."""
    standing = [alert for alert in alerts if alert.condition in {Condition.ACTIVE, Condition.UNKNOWN}]
    of_limit = {alert.kind: alert for alert in standing if alert.kind in OF_LIMIT}
    exceeded, not_known = of_limit.get(ConicityLimitRule.kind), _why_not_known(now)
    why = _of_limit(now, exceeded, of_limit.get(LimitForecastRule.kind), not_known)
    over = SCALE.over(now.probability_over_limit)
    # that its profiles are to be measured is said with the limit
    said = OF_LIMIT if over is None else (*OF_LIMIT, MeasureRule.kind)
    why += [_of_alert(alert, last_ns, refused=refused) for alert in standing if alert.kind not in said]
    if not_known is not None and over is None and (exceeded is None or exceeded.condition is not Condition.ACTIVE):
        why.append(_of_conicity(now, not_known))
    why.sort(key=lambda pair: pair[0].rank)
    if mounted:
        return why[0][0], tuple(reason for _, reason in why)
    nowhere = Reason(ReasonCode.NOT_MOUNTED, "runs under no vehicle")
    return Urgency.NOT_MOUNTED, (nowhere, *(reason for _, reason in why))


def _why_not_known(now: LimitNow) -> Reason | None:
    """Return why nothing is forecast; None where something is: that the limit is beyond the horizon is."""
    reason = now.forecast_reason
    return None if reason is None or reason.code is ReasonCode.BEYOND_HORIZON else reason


def _of_limit(
    now: LimitNow, exceeded: OpenAlert | None, forecast: OpenAlert | None, not_known: Reason | None
) -> list[_Why]:
    """Return how urgent the limit makes a wheelset, by what is believed now and the open alerts on the limit."""
    over, distance = SCALE.over(now.probability_over_limit), now.distance_to_limit_km
    if over is not None or (exceeded is not None and _is_hidden(now, exceeded)):
        return [_exceeded(over, exceeded, now.probability_over_limit)]
    due = forecast is not None or SCALE.due(distance)
    if exceeded is not None:
        text = (
            f"the alert on the limit is not cleared yet (probability {_percent(now.probability_over_limit)}): {MEASURE}"
        )
        return [(Urgency.DUE if due else Urgency.WATCH, Reason(ReasonCode.LIMIT_EXCEEDED, text))]
    if due:
        text = _due(now) if not_known is None else "the limit was forecast near when it could be assessed last"
        return [(Urgency.DUE, Reason(ReasonCode.LIMIT_AHEAD, text))]
    if not_known is not None:
        return []
    if distance.p10 is None:
        return [(Urgency.FINE, now.forecast_reason or BEYOND)]
    return [(Urgency.FINE, Reason(ReasonCode.LIMIT_AHEAD, _due(now)))]


def _is_hidden(now: LimitNow, alert: OpenAlert) -> bool:
    """Return whether what led to an alert cannot be assessed any more."""
    return now.probability_over_limit is None or alert.condition is Condition.UNKNOWN


def _of_conicity(now: LimitNow, not_known: Reason) -> _Why:
    """Return how urgent a wheelset is by its conicity alone: nothing is forecast of it."""
    if not SCALE.far_below(now):
        return Urgency.UNKNOWN, not_known
    text = f"conicity of at most {now.conicity.high:.2f}, far below the limit of {now.limit:.2f}; {not_known.text}"
    return Urgency.FINE, Reason(not_known.code, text)


def _exceeded(over: Urgency | None, alert: OpenAlert | None, probability: float | None) -> _Why:
    """Return that the limit is exceeded, or probably, or was when it could be assessed last."""
    if over is not None and (alert is None or alert.condition is not Condition.UNKNOWN):
        return over, Reason(
            ReasonCode.LIMIT_EXCEEDED, f"{EXCEEDED[over]} (probability {_percent(probability)}): {TURN}"
        )
    critical = alert is not None and alert.severity is Severity.CRITICAL
    last = over or (Urgency.OVER_LIMIT if critical else Urgency.PROBABLY_OVER)
    return last, Reason(ReasonCode.LIMIT_EXCEEDED, f"{EXCEEDED[last]} when it could be assessed last: {TURN}")


def _percent(probability: float | None) -> str:
    """Return a probability in words; rounded down, so that none reads as what it has not reached."""
    return f"{min(99, math.floor(100.0 * (probability or 0.0) + 1e-9))}%"


def _due(now: LimitNow) -> str:
    distance = now.distance_to_limit_km
    after = "beyond the horizon" if distance.p50 is None else f"in {rounded_km(distance.p50)} km"
    if distance.p10 is None:
        return f"due {after}"
    if distance.p10 <= 0.0:
        return f"due {after}, perhaps already (probability {_percent(now.probability_over_limit)})"
    return f"due {after} (p10 {rounded_km(distance.p10)} km)"


def rounded_km(distance_km: float) -> str:
    """Return a distance as every text has it: three digits, which is what a forecast can claim."""
    step = 10 ** max(0, math.floor(math.log10(max(1.0, distance_km))) - 2)
    return f"{math.floor(distance_km / step + 0.5) * step:,}"


def _of_alert(alert: OpenAlert, last_ns: int | None, *, refused: bool) -> tuple[Urgency, Reason]:
    hides = HIDING.get(alert.kind)
    if alert.kind == NoDataRule.kind and hides is not None:
        since = "ever" if last_ns is None else f"since {utc_text(last_ns)[:10]}"
        text = f"no usable data {since}" if refused else f"no data {since}"
        return Urgency.UNKNOWN, Reason(hides.code, text)
    if hides is not None:
        return Urgency.UNKNOWN, hides
    urgency = URGENCY_OF.get(alert.severity, Urgency.FINE)
    text = ADVICE.get(alert.kind) or f"{alert.severity.value} alert: {alert.kind.replace('_', ' ')}"
    if alert.condition is Condition.UNKNOWN:
        text += ", not assessable any more"
    return urgency, Reason(ReasonCode.ALERT_OPEN, text)


NO_GEOMETRY = Reason(ReasonCode.NO_GEOMETRY, "there is no geometry yet")
REPROFILED = Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "there is no geometry since the last reprofiling")
WITHOUT_GEOMETRY = (NO_GEOMETRY.code, REPROFILED.code)
REFUSALS_NAMED = 2
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
    now = _now(inputs)
    worst_first = sorted(inputs.alerts, key=lambda alert: (-_SEVERITIES.index(alert.severity), alert.alert_id))
    ends = [inputs.last_window_ns, None if inputs.geometry is None else inputs.geometry.to_ns]
    last_data_ns = max((end for end in ends if end is not None), default=None)
    urgency, reasons = judged(
        mounted=inputs.wheelset.mounting is not None,
        now=now,
        alerts=worst_first,
        last_ns=last_data_ns,
        refused=bool(inputs.refused),
    )
    geometry = _geometry(inputs)
    return WorklistState(
        **{item.name: getattr(now, item.name) for item in fields(LimitNow)},
        status=now.conicity.status,
        measured_until_ns=geometry.to_ns if isinstance(geometry, GeometryRecord) else None,
        last_data_ns=last_data_ns,
        alerts=tuple(worst_first),
        urgency=urgency,
        reasons=reasons,
    )


def _now(inputs: WorklistInputs) -> LimitNow:
    geometry, trend = _geometry(inputs), inputs.trend
    status = Status.UNESTIMATED if inputs.failure is None else Status.INVALID
    unknown = Estimate.unknown(geometry, status=status) if isinstance(geometry, Reason) else None
    of_profile = trend is not None and trend.baseline == len(inputs.wheelset.reprofilings)
    return limit_now(
        geometry.geometry if isinstance(geometry, GeometryRecord) else None,
        trend.trend if trend is not None and of_profile else None,
        None if trend is None else trend.trend.limit,  # of its vehicle, whatever the profile
        inputs.mileage,
        unknown,
    )


def _geometry(inputs: WorklistInputs) -> GeometryRecord | Reason:
    """Return the geometry of the present profile, or why there is none."""
    if inputs.failure is not None:
        return inputs.failure
    if inputs.geometry is None or not inputs.geometry.geometry.windows:
        return _with_refusals(NO_GEOMETRY, inputs)
    if inputs.geometry.baseline != len(inputs.wheelset.reprofilings):
        return _with_refusals(REPROFILED, inputs)
    return inputs.geometry


def _with_refusals(reason: Reason, inputs: WorklistInputs) -> Reason:
    named = list(inputs.refused.items())[:REFUSALS_NAMED]
    if not named:
        return reason
    refusals = ", ".join(f"{count} {code.value.replace('_', ' ')}" for code, count in named)
    rest = sum(inputs.refused.values()) - sum(count for _, count in named)
    return replace(reason, text=f"windows refused: {refusals}{f', {rest} other' if rest else ''}; {reason.text}")


ESTIMATION, ALIGNMENT, GEOMETRIES = "estimate_windows", "refresh_alignment", "refresh_geometry"
"""Jobs that make bin tables of windows, alignments of sections, and geometries of wheelsets."""


@dataclass(frozen=True, slots=True)
class SectionFacts:
    """What is stored of a section and decides what its windows wait for."""

    code: str  # of the section
    in_force: AlignmentRecord | None = None  # its alignment; None where there is none
    looked_at: bool = False  # whether its passes have been looked at
    found: Reason | None = None  # why the last look found no alignment; None where it did
    survey: Reason | None = None  # why the survey on file is not used; None where it is, or there is none
    failed: Quarantined | None = None  # last failure of :data:`ALIGNMENT` at it; None where it succeeded

    @property
    def aligned(self) -> bool:
        """Whether windows can be estimated on it."""
        return self.in_force is not None and self.in_force.status is Status.ESTIMATED

    @property
    def placed_by_fleet(self) -> bool:
        """Whether windows are estimated only where their place on it is found: on a survey they are not."""
        return self.in_force is not None and self.in_force.source is AlignmentSource.FLEET


def waits_for(
    section: SectionFacts | None, no_class: Reason | None, last_run: JobRun | None, *, placed: bool
) -> Reason:
    """Return what a window waits for; None is a section not known, a class on file, a job that has never run."""
    if no_class is not None:
        return no_class
    if section is not None and not section.aligned:
        return no_alignment(section)
    if section is not None and section.placed_by_fleet and not placed:
        text = f"its place on section {section.code} is not found yet: {_looked(section)}"
        return Reason(ReasonCode.WAITS_FOR_POSITION, text)
    return Reason(ReasonCode.WAITS_FOR_ESTIMATION, f"it waits for {_next_run(ESTIMATION, last_run)}")


def no_alignment(section: SectionFacts) -> Reason:
    """Return that a section has no alignment, and why."""
    survey = "" if section.survey is None else f"; the survey is {section.survey.text}"
    text = f"the alignment of section {section.code} is not known yet: {_looked(section)}{survey}"
    return Reason(ReasonCode.ALIGNMENT_UNKNOWN, text)


def tried_again(reason: Reason, failed: Quarantined | None) -> Reason:
    """Return a reason with when it is tried again, where a failure is kept."""
    return reason if failed is None else replace(reason, text=f"{reason.text}; {_again(failed)}")


def no_geometry_yet(last_run: JobRun | None, failed: Quarantined | None) -> Reason:
    """Return why estimated windows have given no geometry."""
    if failed is not None:
        return Reason(failed.code, f"{GEOMETRIES} failed at it: {failed.error}; {_again(failed)}")
    return Reason(ReasonCode.NO_GEOMETRY, f"the geometry waits for {_next_run(GEOMETRIES, last_run)}")


def _looked(section: SectionFacts) -> str:
    if section.failed is not None:
        return f"{ALIGNMENT} failed at it: {section.failed.error}; {_again(section.failed)}"
    if section.found is not None:
        return section.found.text
    return f"{ALIGNMENT} looks at it again with the next passes" if section.looked_at else f"{ALIGNMENT} has yet to run"


def _again(failed: Quarantined) -> str:
    return f"tried again from {utc_text(failed.due_ns)} on ({failed.attempts} failures in a row)"


def _next_run(job: str, last: JobRun | None) -> str:
    if last is None:
        return f"{job}, which has never run"
    began = utc_text(last.started_ns)
    if last.outcome is JobOutcome.RUNNING:
        return f"{job}, which has been running since {began}"
    if last.outcome is JobOutcome.SUCCEEDED:
        return f"the next run of {job}"
    return f"the next run of {job}; the last, of {began}, {last.outcome.value}: {last.error}"
