"""How urgent a wheelset is: in which class of ``Urgency``, where within it, and the reasons in words.

What is not known is never taken for good: a wheelset without a number to trust comes before all that are known to last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from estimation.alerts.rules.book import ALERT_RULES
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.limit_forecast import LimitForecastRule
from estimation.alerts.rules.no_data import NoDataRule
from estimation.values.alerts import Condition, Severity
from estimation.values.quantities import Forecast
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.worklist import OpenAlert, Urgency, WorklistState

DUE_WITHIN_KM = 30_000.0
"""A wheelset is due where the limit is reached within this distance with a probability of 10 %. It is the distance
beyond which the shipped rule on the forecast lets its alert go."""

TURN = "turn the wheelset, or measure its profiles"
MORE_LIKELY_THAN_NOT = 0.5
FAR_KM = 1e9  # stands for a distance that is not known, behind all that are
BAND_KM = 1e10  # from one class of urgency to the next
ADVICE = {rule.kind: rule.advice for rule in ALERT_RULES if rule.advice}
HIDING = {rule.kind: rule.hides_wear for rule in ALERT_RULES if rule.hides_wear is not None}
OF_LIMIT = (ConicityLimitRule.kind, LimitForecastRule.kind)


@dataclass(frozen=True, slots=True)
class Ahead:
    """What is known of the limit: quantiles of the distance, whether it is exceeded, and what is missing."""

    distance_km: Forecast
    probability_over_limit: float | None
    reason: Reason | None

    @property
    def known(self) -> bool:
        """Whether anything is known: that the limit is beyond the horizon is."""
        return self.reason is None or self.reason.code is ReasonCode.BEYOND_HORIZON


@dataclass(frozen=True, slots=True)
class Verdict:
    """How urgent, and why."""

    urgency: Urgency
    reasons: tuple[Reason, ...]


def judged(
    *, mounted: bool, ahead: Ahead, alerts: Sequence[OpenAlert], last_ns: int | None, refused: bool = False
) -> Verdict:
    """Return how urgent a wheelset is.

    Args:
        ahead: What is known of its limit.
        last_ns: End of its newest usable data, ns UTC; None where there are none.
    """
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
        return Verdict(Urgency.NOT_MOUNTED, tuple(reason for _, reason in found))
    ordered = sorted(found, key=lambda pair: pair[0].rank)
    return Verdict(ordered[0][0], tuple(reason for _, reason in ordered))


def urgency_key(state: WorklistState) -> float:
    """Return the number that orders wheelsets by urgency, the most urgent first.

    Within a class the one comes first whose limit may be reached first (p10); over the limit, the most certain one.
    """
    within = FAR_KM if state.distance_to_limit_km.p10 is None else state.distance_to_limit_km.p10
    if state.urgency is Urgency.OVER_LIMIT:
        within = 1.0 - (state.probability_over_limit or 0.0)
    return state.urgency.rank * BAND_KM + min(within, FAR_KM)


def distance_key(state: WorklistState) -> float | None:
    """Return the number that orders wheelsets by their distance to the limit: its median; None where it is not known.

    A median beyond the horizon comes behind all others, those first whose limit may be reached within it (p10).
    """
    distance = state.distance_to_limit_km
    if distance.p50 is not None:
        return distance.p50
    if distance.p10 is not None:
        return FAR_KM + distance.p10
    beyond = state.forecast_reason is not None and state.forecast_reason.code is ReasonCode.BEYOND_HORIZON
    return 2.0 * FAR_KM if beyond else None


def _of_limit(ahead: Ahead, alerts: Sequence[OpenAlert]) -> list[tuple[Urgency, Reason]]:
    """Return what the limit makes urgent, one reason."""
    exceeded = next((alert for alert in alerts if alert.kind == ConicityLimitRule.kind), None)
    forecast = next((alert for alert in alerts if alert.kind == LimitForecastRule.kind), None)
    probability, distance = ahead.probability_over_limit, ahead.distance_km
    if exceeded is not None or (probability is not None and probability >= MORE_LIKELY_THAN_NOT):
        return [(Urgency.OVER_LIMIT, Reason(ReasonCode.LIMIT_EXCEEDED, _exceeded(exceeded, probability)))]
    if forecast is not None or (distance.p10 is not None and distance.p10 <= DUE_WITHIN_KM):
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
    if probability is None or probability < MORE_LIKELY_THAN_NOT:
        return f"limit exceeded: {TURN}"
    return f"limit exceeded (probability {probability:.0%}): {TURN}"


def _due(distance: Forecast) -> str:
    if distance.p50 is not None and distance.p50 <= 0.0:
        return "due now"
    if distance.p50 is None:
        return "due beyond the horizon" + ("" if distance.p10 is None else f" (p10 {_km(distance.p10)})")
    return f"due in {_km(distance.p50)}" + ("" if distance.p10 is None else f" (p10 {_km(distance.p10)})")


def _km(distance_km: float) -> str:
    """Return a distance in words, to 100 km from 1,000 km on."""
    return f"{round(distance_km, -2) if distance_km >= 1000.0 else round(distance_km):,.0f} km"  # noqa: PLR2004


def _of_alert(alert: OpenAlert, last_ns: int | None, *, refused: bool) -> tuple[Urgency, Reason]:
    hides = HIDING.get(alert.kind)
    if alert.kind == NoDataRule.kind and hides is not None:
        since = "ever" if last_ns is None else f"since {_day(last_ns)}"
        text = f"no usable data {since}" if refused else f"no data {since}"
        return Urgency.UNKNOWN, Reason(hides.code, text)
    if hides is not None:
        return Urgency.UNKNOWN, hides
    urgency = {Severity.CRITICAL: Urgency.CRITICAL_ALERT, Severity.WARNING: Urgency.WARNING_ALERT}.get(
        alert.severity, Urgency.NOT_DUE
    )
    text = ADVICE.get(alert.kind) or f"{alert.severity.value} alert: {alert.kind.replace('_', ' ')}"
    if alert.condition is Condition.UNKNOWN:
        text += ", not assessable any more"
    return urgency, Reason(ReasonCode.ALERT_OPEN, text)


def _day(t_ns: int) -> str:
    return f"{datetime.fromtimestamp(t_ns // 1_000_000_000, UTC):%Y-%m-%d}"
