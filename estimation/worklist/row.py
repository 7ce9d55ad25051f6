"""A row of the worklist from what is stored of a wheelset, and what its windows wait for: nothing is estimated again.

What is not known is never taken for good: a wheelset without a number to trust comes before all that are known to last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.alerts.rule_book import ALERT_RULES
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.alerts.rules.trend import LimitForecastRule
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values.alerts import (
    AxlePosition,
    BogiePlace,
    Condition,
    OpenAlert,
    Severity,
    Urgency,
    WorklistRow,
    WorklistState,
)
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, utc_text
from estimation.values.runs import JobOutcome, JobRun, Quarantined
from estimation.values.track import AlignmentRecord, AlignmentSource
from estimation.values.trend import TrendRecord
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE
from estimation.worklist.stored import WorklistInputs


@dataclass(frozen=True, slots=True)
class WorklistParameters:
    """When a wheelset is due."""

    # A wheelset is due where the limit is reached within this distance with a probability of 10 %. It is the distance
    # beyond which the shipped rule on the forecast lets its alert go.
    due_within_km: float = 30_000.0
    more_likely_than_not: float = 0.5


OF_WORKLIST = WorklistParameters()


TURN = "turn the wheelset, or measure its profiles"
FAR_KM = 1e9  # stands for a distance that is not known, behind all that are
BAND_KM = 1e10  # from one class of urgency to the next
ADVICE = {rule.kind: rule.advice for rule in ALERT_RULES if rule.advice}
HIDING = {rule.kind: rule.hides_wear for rule in ALERT_RULES if rule.hides_wear is not None}
NOWHERE = Forecast(None, None, None)
URGENCY_OF = {Severity.CRITICAL: Urgency.CRITICAL_ALERT, Severity.WARNING: Urgency.WARNING_ALERT}
OF_LIMIT = (ConicityLimitRule.kind, LimitForecastRule.kind)


@dataclass(frozen=True, slots=True)
class Ahead:
    """What is known of the limit: quantiles of the distance, whether it is exceeded, and what is missing."""

    distance_km: Forecast
    probability_over_limit: float | None
    reason: Reason | None
    date_ns: Forecast = NOWHERE
    since_trend_km: float | None = None  # run since the last point of the trend

    @property
    def known(self) -> bool:
        """Whether anything is known: that the limit is beyond the horizon is."""
        return self.reason is None or self.reason.code is ReasonCode.BEYOND_HORIZON


def judged(
    *, mounted: bool, ahead: Ahead, alerts: Sequence[OpenAlert], last_ns: int | None, refused: bool = False
) -> tuple[Urgency, tuple[Reason, ...]]:
    """Return how urgent a wheelset is, and why."""
    standing = [alert for alert in alerts if alert.condition in {Condition.ACTIVE, Condition.UNKNOWN}]
    found: list[tuple[Urgency, Reason]] = []
    if not mounted:
        found.append((Urgency.NOT_MOUNTED, Reason(ReasonCode.NOT_MOUNTED, "runs under no vehicle")))
    found += _of_limit(ahead, [alert for alert in standing if alert.kind in OF_LIMIT])
    found += [_of_alert(alert, last_ns, refused=refused) for alert in standing if alert.kind not in OF_LIMIT]
    exceeded = any(one.kind == ConicityLimitRule.kind and one.condition is Condition.ACTIVE for one in standing)
    if not ahead.known and ahead.reason is not None and not exceeded:
        found.append((Urgency.UNKNOWN, ahead.reason))
    if not mounted:
        return Urgency.NOT_MOUNTED, tuple(reason for _, reason in found)
    ordered = sorted(found, key=lambda pair: pair[0].rank)
    return ordered[0][0], tuple(reason for _, reason in ordered)


def _of_limit(ahead: Ahead, alerts: Sequence[OpenAlert]) -> list[tuple[Urgency, Reason]]:
    exceeded = next((alert for alert in alerts if alert.kind == ConicityLimitRule.kind), None)
    forecast = next((alert for alert in alerts if alert.kind == LimitForecastRule.kind), None)
    probability, distance = ahead.probability_over_limit, ahead.distance_km
    if exceeded is not None or (probability is not None and probability >= OF_WORKLIST.more_likely_than_not):
        return [(Urgency.OVER_LIMIT, Reason(ReasonCode.LIMIT_EXCEEDED, _exceeded(exceeded, probability)))]
    if forecast is not None or (distance.p10 is not None and distance.p10 <= OF_WORKLIST.due_within_km):
        text = _due(distance) if ahead.known else "the limit was forecast near when it could be assessed last"
        return [(Urgency.DUE, Reason(ReasonCode.LIMIT_AHEAD, text))]
    if not ahead.known:
        return []
    if distance.p10 is None:
        return [(Urgency.NOT_DUE, ahead.reason or Reason(ReasonCode.BEYOND_HORIZON, "not within the horizon"))]
    return [(Urgency.NOT_DUE, Reason(ReasonCode.LIMIT_AHEAD, _due(distance)))]


def _exceeded(alert: OpenAlert | None, probability: float | None) -> str:
    if alert is not None and alert.condition is Condition.UNKNOWN:
        return f"limit exceeded when it could be assessed last: {TURN}"
    if probability is None or probability < OF_WORKLIST.more_likely_than_not:
        return f"limit exceeded: {TURN}"
    return f"limit exceeded (probability {probability:.0%}): {TURN}"


def _due(distance: Forecast) -> str:
    if distance.p50 is not None and distance.p50 <= 0.0:
        return "due now"
    if distance.p50 is None:
        return "due beyond the horizon" + ("" if distance.p10 is None else f" (p10 {_km(distance.p10)})")
    return f"due in {_km(distance.p50)}" + ("" if distance.p10 is None else f" (p10 {_km(distance.p10)})")


def _km(distance_km: float) -> str:
    return f"{round(distance_km, -2) if distance_km >= 1000.0 else round(distance_km):,.0f} km"  # noqa: PLR2004


def _of_alert(alert: OpenAlert, last_ns: int | None, *, refused: bool) -> tuple[Urgency, Reason]:
    hides = HIDING.get(alert.kind)
    if alert.kind == NoDataRule.kind and hides is not None:
        since = "ever" if last_ns is None else f"since {utc_text(last_ns)[:10]}"
        text = f"no usable data {since}" if refused else f"no data {since}"
        return Urgency.UNKNOWN, Reason(hides.code, text)
    if hides is not None:
        return Urgency.UNKNOWN, hides
    urgency = URGENCY_OF.get(alert.severity, Urgency.NOT_DUE)
    text = ADVICE.get(alert.kind) or f"{alert.severity.value} alert: {alert.kind.replace('_', ' ')}"
    if alert.condition is Condition.UNKNOWN:
        text += ", not assessable any more"
    return urgency, Reason(ReasonCode.ALERT_OPEN, text)


NO_GEOMETRY = Reason(ReasonCode.NO_GEOMETRY, "there is no geometry yet")
REPROFILED = Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "there is no geometry since the last reprofiling")
WITHOUT_GEOMETRY = (NO_GEOMETRY.code, REPROFILED.code)
NO_TREND = Reason(ReasonCode.TOO_FEW_POINTS, "there is no trend since the last reprofiling yet")
NOT_FINITE = Reason(ReasonCode.NOT_FINITE, "the calculation gave no finite number")
BEYOND = Reason(ReasonCode.BEYOND_HORIZON, "not reached within the forecast horizon")
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
    conicity = _conicity(inputs)
    trend = inputs.trend
    if trend is not None and trend.baseline != len(inputs.wheelset.reprofilings):
        trend = None  # of a profile that the wheelset has no more
    ahead = _ahead(inputs, trend, conicity)
    worst_first = sorted(inputs.alerts, key=lambda alert: (-_SEVERITIES.index(alert.severity), alert.alert_id))
    ends = [inputs.last_window_ns, None if inputs.geometry is None else inputs.geometry.to_ns]
    last_data_ns = max((end for end in ends if end is not None), default=None)
    urgency, reasons = judged(
        mounted=inputs.wheelset.mounting is not None,
        ahead=ahead,
        alerts=worst_first,
        last_ns=last_data_ns,
        refused=bool(inputs.refused),
    )
    has_geometry = inputs.geometry is not None and code_of(conicity.reason) not in WITHOUT_GEOMETRY
    return WorklistState(
        status=conicity.status,
        conicity=conicity,
        measured_until_ns=inputs.geometry.to_ns if inputs.geometry is not None and has_geometry else None,
        slope_per_1000_km=Estimate.unknown(NO_TREND) if trend is None else _published(trend.trend.slope_per_1000_km),
        limit=None if trend is None else _finite(trend.trend.limit),
        probability_over_limit=ahead.probability_over_limit,
        distance_to_limit_km=ahead.distance_km,
        since_trend_km=ahead.since_trend_km,
        date_of_limit_ns=ahead.date_ns,
        forecast_reason=ahead.reason,
        mileage=inputs.mileage,
        last_data_ns=last_data_ns,
        alerts=tuple(worst_first),
        urgency=urgency,
        reasons=reasons,
    )


def _conicity(inputs: WorklistInputs) -> Estimate:
    geometry = inputs.geometry
    if inputs.failure is not None:
        return Estimate.unknown(inputs.failure, status=Status.INVALID)
    if geometry is None or not geometry.geometry.windows:
        return Estimate.unknown(_with_refusals(NO_GEOMETRY, inputs))
    if geometry.baseline != len(inputs.wheelset.reprofilings):
        return Estimate.unknown(_with_refusals(REPROFILED, inputs))
    return _published(conicity_at_limit_amplitude(geometry.geometry))


def _with_refusals(reason: Reason, inputs: WorklistInputs) -> Reason:
    named = list(inputs.refused.items())[:REFUSALS_NAMED]
    if not named:
        return reason
    refusals = ", ".join(f"{count} {code.value.replace('_', ' ')}" for code, count in named)
    rest = sum(inputs.refused.values()) - sum(count for _, count in named)
    return replace(reason, text=f"windows refused: {refusals}{f', {rest} other' if rest else ''}; {reason.text}")


def _ahead(inputs: WorklistInputs, trend: TrendRecord | None, conicity: Estimate) -> Ahead:
    unknown = _why_unknown(inputs, trend, conicity)
    if trend is None or unknown is not None:
        return Ahead(NOWHERE, None, unknown or NO_TREND)
    found, since = trend.trend, None
    if inputs.mileage is not None and len(found.mileage_km):
        since = max(0.0, inputs.mileage.mileage_km - float(found.mileage_km[-1]))
    distance = _each(found.distance_to_limit_km, since or 0.0)
    date = _each(found.date_of_limit_ns, 0.0)
    beyond = BEYOND if None in (distance.p10, distance.p50, distance.p90) else None
    return Ahead(distance, _finite(found.probability_over_limit), beyond, date, since)


def _why_unknown(inputs: WorklistInputs, trend: TrendRecord | None, conicity: Estimate) -> Reason | None:
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
    values = (_finite(value) for value in (forecast.p10, forecast.p50, forecast.p90))
    return Forecast(*(None if value is None else max(0.0, value - less) for value in values))


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _published(estimate: Estimate) -> Estimate:
    if None not in [_finite(value) for value in (estimate.value, estimate.std, estimate.low, estimate.high)]:
        return estimate
    status = Status.INVALID if estimate.status is Status.ESTIMATED else estimate.status
    return Estimate.unknown(estimate.reason or NOT_FINITE, _finite(estimate.count) or 0.0, status)


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
