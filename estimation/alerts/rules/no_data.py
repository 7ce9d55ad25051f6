"""Rule: a wheelset in service of which nothing could be estimated for some days."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

from estimation.alerts.rules.evidence import Evidence
from estimation.alerts.rules.rule import AlertDelays, AlertRule, Days, WheelsetFacts, newest_windows
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import JsonValue, Served
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord

DAY_NS = 86_400_000_000_000
LATEST = 20  # windows whose reasons are told


@dataclass(frozen=True, slots=True, kw_only=True)
class NoDataEvidence(Evidence):
    """Evidence of `no_data`: how long nothing usable has come."""

    last_usable_ns: Annotated[int | None, Served("End of the newest usable window; null where there is none.")]
    in_service_since_ns: Annotated[int, Served("When the wheelset was mounted.", "in_service_since")]
    limit_days: Annotated[float, Served("Limit in days that the silence has passed.")]
    refused_windows: Annotated[int | None, Served("Windows since then, of the latest, that cannot be used.")] = None
    reasons: Annotated[Mapping[str, int], Served("These windows by reason code.")] = field(default_factory=dict)
    reason: Annotated[str | None, Served("Why the newest of the most frequent reason cannot be used.")] = None


@dataclass(frozen=True, slots=True)
class NoDataRule(AlertRule):
    """No window that could be estimated for some days."""

    kind: ClassVar[str] = "no_data"
    limit_unit: ClassVar[str] = "days"
    evidence: ClassVar[type[Evidence] | None] = NoDataEvidence
    hides_wear: ClassVar[Reason | None] = Reason(ReasonCode.NO_RECENT_DATA, "no usable data for too long")
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (("critical_days", ">=", "days"),)

    delays: AlertDelays = field(default_factory=lambda: AlertDelays(off_evaluations=1))
    days: Days = 7.0
    critical_days: float = 28.0

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return whether the wheelset has fallen silent."""
        mounting = facts.wheelset.mounting
        if mounting is None:
            return None
        found = no_data_finding(self, facts.wheelset.serial, facts.last_usable_ns, mounting.from_ns, now_ns)
        since_ns = silent_since_ns(facts.last_usable_ns, mounting.from_ns)
        return _with_refused(found, newest_windows(facts.windows, LATEST), since_ns)


def no_data_finding(
    rule: NoDataRule, wheelset: str, last_usable_ns: int | None, in_service_since_ns: int, now_ns: int
) -> Finding:
    """Return whether the wheelset has fallen silent.

    Args:
        last_usable_ns: End of the newest window that was estimated or waits for it; None where there is none.

    Returns:
        Finding: Its ``measured_ns`` is when the silence began to count, not the time of the evaluation, so that another
            evaluation says the same.
    """
    since = silent_since_ns(last_usable_ns, in_service_since_ns)
    silent_days = (now_ns - since) / DAY_NS
    breached = silent_days > rule.days
    critical = silent_days > rule.critical_days
    raised_ns, critical_ns = (since + round(days * DAY_NS) for days in (rule.days, rule.critical_days))
    return Finding(
        wheelset=wheelset,
        kind=NoDataRule.kind,
        breached=breached,
        cleared=not breached,
        severity=Severity.CRITICAL if critical else Severity.WARNING,
        probability=1.0 if breached else 0.0,
        evidence=NoDataEvidence(
            last_usable_ns=last_usable_ns,
            in_service_since_ns=in_service_since_ns,
            limit_days=rule.critical_days if critical else rule.days,
        ).stored(),
        action="check_sensor_and_connection",
        raise_limit=rule.days,
        clear_limit=rule.days,
        measured_ns=(critical_ns if critical else raised_ns) if breached else since,
        since_ns=raised_ns if breached else None,
    )


def _with_refused(found: Finding, windows: Sequence[WindowRecord], since_ns: int) -> Finding:
    """Return the finding with what arrives all the same, and for which reason most of it cannot be used."""
    refused = [one.reason for one in windows if one.reason is not None and one.start_ns >= since_ns]
    codes = Counter(reason.code for reason in refused)
    usual = codes.most_common(1)[0][0] if codes else None
    evidence: dict[str, JsonValue] = {
        **found.evidence,
        "refused_windows": len(refused),
        "reasons": {code.value: codes[code] for code in sorted(codes)},
        "reason": next((reason.text for reason in reversed(refused) if reason.code is usual), None),
    }
    return replace(found, evidence=evidence, action="check_refused_windows" if refused else found.action)


def silent_since_ns(last_usable_ns: int | None, in_service_since_ns: int) -> int:
    """Return from when silence counts.

    Args:
        last_usable_ns: End of the newest window that was estimated or waits for it; None where there is none.
    """
    return max(in_service_since_ns, last_usable_ns if last_usable_ns is not None else in_service_since_ns)
