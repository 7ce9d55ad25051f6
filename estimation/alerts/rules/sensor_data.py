"""Rules on what a sensor sends: data that contradict themselves or the registry, a faulty sensor, and silence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated

from annotated_types import Interval

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Mistake
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import (
    AlertDelays,
    AlertRule,
    Days,
    Share,
    WheelsetFacts,
    WindowCount,
    WindowShareRule,
    WindowsRule,
    measured_until,
    too_few_windows,
)
from estimation.values.alerts import (
    Alert,
    DecidingEvidence,
    Evidence,
    Finding,
    Severity,
    number_evidence,
    restated,
    unknown_evidence,
)
from estimation.values.fields import JsonValue, Served
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.trend import IDENTITY
from estimation.values.units import DAY_NS
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQualityEvidence(DecidingEvidence):
    """Evidence of `data_quality`: the data contradict themselves or the registry."""

    implausible_windows: Annotated[int, Served("Implausible ones of the latest windows.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    reasons: Annotated[Mapping[str, int], Served("Implausible windows by reason code.")]
    rejected_recordings: Annotated[int | None, Served("Rejected recordings of the vehicle.")] = 0
    rejected_reasons: Annotated[Mapping[str, int], Served("Rejected recordings by reason code.")] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True)
class DataQualityRule(WindowsRule):
    """What the vehicle sent contradicts itself or the registry: several of the newest windows, or a whole recording."""

    kind = "data_quality"
    limit_unit = "windows"
    evidence = DataQualityEvidence
    advice = "its mileage or recordings cannot be believed: check odometer and recordings"
    relations = (("raise_windows", "<=", "latest_windows"), ("minimum_windows", "<=", "latest_windows"))

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 10
    raise_windows: WindowCount = 2
    minimum_windows: WindowCount = 3  # behind "the data are good again"

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return the finding of the newest windows; a rejected recording stands until it is decoded or set aside."""
        found, rejected = WindowsRule.find(self, facts, now_ns), facts.rejected_recordings
        if found is None or not rejected:
            return found
        evidence: dict[str, JsonValue] = {
            **found.evidence,
            "rejected_recordings": sum(rejected.values()),
            "rejected_reasons": {code: rejected[code] for code in sorted(rejected)},
            **unknown_evidence(None),
        }
        return replace(found, breached=True, cleared=False, evidence=evidence, action="check_recordings", stands=True)

    def find_in(self, windows: Sequence[WindowRecord], facts: WheelsetFacts) -> Finding:
        """Return the finding on what is implausible."""
        reasons = Counter(window.implausible.code.value for window in windows if window.implausible is not None)
        implausible = reasons.total()
        unknown = None if implausible else too_few_windows(len(windows), self.minimum_windows)
        of_place = set(reasons) == {ReasonCode.PLACE_IMPLAUSIBLE.value}
        return Finding(
            wheelset=facts.wheelset.serial,
            kind=self.kind,
            breached=None if unknown else implausible >= self.raise_windows,
            cleared=None if unknown else not implausible,
            evidence=DataQualityEvidence(
                implausible_windows=implausible, windows=len(windows), reasons=reasons, unknown=unknown
            ).stored(),
            action="check_section_number" if of_place else "check_odometer",
            raise_limit=float(self.raise_windows),
            clear_limit=0.0,
            measured_ns=measured_until(windows, facts),
        )

    def is_suspect(self, window: WindowRecord, facts: WheelsetFacts) -> bool:  # noqa: ARG002 - the window alone decides
        """Return whether a window is implausible."""
        return window.implausible is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFaultEvidence(DecidingEvidence):
    """Evidence of `sensor_fault`: too many of the latest windows are of a faulty sensor."""

    faulty_windows: Annotated[int, Served("Faulty ones of the latest windows.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    reasons: Annotated[
        Mapping[str, int],
        Served("Faulty windows by what is wrong: `self_test_or_emergency`, `clipping`, `invalid_values`."),
    ]


@dataclass(frozen=True, slots=True)
class SensorFaultRule(WindowShareRule):
    """Too many of the latest windows have a sensor that failed, clips or marks its values invalid."""

    kind = "sensor_fault"
    of_sensors = True
    limit_unit = "1"
    evidence = SensorFaultEvidence
    hides_wear = Reason(ReasonCode.SENSOR_FAULTY, "the sensor is faulty")

    clipped_share: Share = 0.05  # of a window's samples that makes it faulty
    invalid_share: Share = 0.2

    def find_in(self, windows: Sequence[WindowRecord], facts: WheelsetFacts) -> Finding:
        """Return the finding on the sensor."""
        reasons = Counter(fault for window in windows if (fault := faulty(self, window, facts.hunted)))
        unknown = too_few_windows(len(windows), self.minimum_windows)
        evidence = SensorFaultEvidence(
            faulty_windows=reasons.total(), windows=len(windows), reasons=reasons, unknown=unknown
        )
        return self.share_finding(windows, reasons.total(), facts, evidence, "replace_sensor")

    def is_suspect(self, window: WindowRecord, facts: WheelsetFacts) -> bool:
        """Return whether the sensor is faulty in a window."""
        return bool(faulty(self, window, facts.hunted))

    def counts_from_ns(self, facts: WheelsetFacts) -> int | None:
        """Return when the sensors were last changed: what was before is of others."""
        return facts.sensors_changed_ns


def faulty(rule: SensorFaultRule, window: WindowRecord, hunted: frozenset[int] = frozenset()) -> str:
    """Return what is wrong with the sensor in this window; empty where nothing is."""
    # a sensor that clips because its wheelset hunts, or another one that shakes its vehicle, is sound; so is one that a
    # wheel with a flat strikes
    quality = window.quality
    if quality.sensor_fault:
        return "self_test_or_emergency"
    explained = quality.hunting.sustained or quality.blows.sustained or window.start_ns in hunted
    if quality.clipped > rule.clipped_share and not explained:
        return "clipping"
    if quality.invalid > rule.invalid_share:
        return "invalid_values"
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoDataEvidence(Evidence):
    """Evidence of `no_data`: how long nothing usable has come."""

    last_usable_ns: Annotated[int | None, Served("End of the newest usable window; null where there is none.")]
    in_service_since_ns: Annotated[int, Served("When the wheelset was mounted.", "in_service_since")]
    limit_days: Annotated[float, Served("Limit in days that the silence has passed.")]
    refused_windows: Annotated[int | None, Served("Windows since then, of the latest, that cannot be used.")] = None
    reasons: Annotated[Mapping[str, int], Served("These windows by reason code.")] = field(default_factory=dict)
    reason: Annotated[str | None, Served("Why the newest of the most frequent reason cannot be used.")] = None


AT_ONCE_OFF = AlertDelays(off_evaluations=1)


@dataclass(frozen=True, slots=True)
class NoDataRule(AlertRule):
    """No window that could be estimated for some days."""

    kind = "no_data"
    limit_unit = "days"
    evidence = NoDataEvidence
    hides_wear = Reason(ReasonCode.NO_RECENT_DATA, "no usable data for too long")
    relations = (("critical_days", ">=", "days"),)

    delays: AlertDelays = AT_ONCE_OFF
    days: Days = 7.0
    critical_days: float = 28.0

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return whether the wheelset has fallen silent.

        ``measured_ns`` is when the silence began to count, so that another evaluation says the same.
        """
        mounting, since_ns = facts.wheelset.mounting, silent_since_ns(facts)
        if mounting is None or since_ns is None:
            return None
        silent_days = (now_ns - since_ns) / DAY_NS
        breached, critical = silent_days > self.days, silent_days > self.critical_days
        raised_ns, critical_ns = (since_ns + round(days * DAY_NS) for days in (self.days, self.critical_days))
        newest = sorted(facts.windows, key=lambda window: window.start_ns)[-FINDINGS.reasons_from_windows :]
        refused = [one.reason for one in newest if one.reason is not None and one.start_ns >= since_ns]
        codes = Counter(reason.code for reason in refused)
        usual = codes.most_common(1)[0][0] if codes else None
        return Finding(
            wheelset=facts.wheelset.serial,
            kind=self.kind,
            breached=breached,
            cleared=not breached,
            severity=Severity.CRITICAL if critical else Severity.WARNING,
            probability=1.0 if breached else 0.0,
            evidence=NoDataEvidence(
                last_usable_ns=facts.last_usable_ns,
                in_service_since_ns=mounting.from_ns,
                limit_days=self.critical_days if critical else self.days,
                refused_windows=len(refused),
                reasons={code.value: count for code, count in codes.items()},
                reason=next((reason.text for reason in reversed(refused) if reason.code is usual), None),
            ).stored(),
            action="check_refused_windows" if refused else "check_sensor_and_connection",
            raise_limit=self.days,
            clear_limit=self.days,
            measured_ns=(critical_ns if critical else raised_ns) if breached else since_ns,
            since_ns=raised_ns if breached else None,
        )


def silent_since_ns(facts: WheelsetFacts) -> int | None:
    """Return from when silence counts, ns UTC: the end of the newest usable data; None for a wheelset in no vehicle."""
    if facts.wheelset.mounting is None:
        return None
    from_ns = facts.wheelset.mounting.from_ns
    return from_ns if facts.last_usable_ns is None else max(from_ns, facts.last_usable_ns)


MOUNTED = "mounted"
_EXPLANATIONS = {
    Mistake.REVERSED: "the geometry has become its own mirror image: it runs the other way round than on file",
    Mistake.SWAPPED: "the geometry has become that of another wheelset, and the other's has become this one's",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MountedAs:
    """How a wheelset is mounted on file."""

    vehicle: Annotated[str, Served("Code of the vehicle.")]
    axle: Annotated[int, Served("Number of the axle, from 1.")]
    from_ns: Annotated[int, Served("Since when.", "mounted_from")]
    reversed: Annotated[bool, Served("The left wheel runs on the right-hand side.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentityEvidence(Evidence):
    """Evidence of `identity`: the wheelset that runs is not the one on file, or not the way round."""

    mistake: Annotated[Mistake, Served("The mistake that explains the jump.")]
    partner: Annotated[str | None, Served("The other wheelset of a swap.")]
    before_ns: Annotated[int, Served("End of the last data before it happened.", "last_data_before_at")]
    after_ns: Annotated[int, Served("Begin of the first data after it.", "first_data_after_at")]
    jump: Annotated[float | None, Served("Standard deviations between the geometries before and after.", "jump_1")]
    left: Annotated[float | None, Served("Standard deviations that the explanation leaves.", "left_1")]
    reason: Annotated[str, Served("The explanation, as a sentence.")]
    mounted: Annotated[MountedAs, Served("The mounting that it was raised on.")]


@dataclass(frozen=True, slots=True)
class IdentityRule(AlertRule):
    """A wheelset is not the one on file, or not the way round; its alert stands until its mounting is corrected."""

    kind = IDENTITY
    limit_unit = "1"
    evidence = IdentityEvidence
    hides_wear = Reason(
        ReasonCode.IDENTITY_DOUBTFUL, "the wheelset is not the recorded one, or is mounted the other way round"
    )

    parameters: IdentityParameters = field(default_factory=IdentityParameters)

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return what stands against the wheelset's identity, unless the mounting has been corrected since."""
        mounting = facts.wheelset.mounting
        if mounting is None or not self.enabled:
            return None
        standing = next((alert for alert in facts.open_alerts if alert.kind == self.kind), None)
        if standing is not None and (mounting_corrected(standing, mounting) or mounting.from_ns > standing.opened_ns):
            standing = None
        return identity_finding(facts.identity, mounting, standing)


def identity_finding(event: IdentityEvent | None, mounting: Mounting, standing: Alert | None) -> Finding | None:
    """Return the finding on a wheelset's identity; None where the geometries agree with it."""
    if event is None:
        return None if standing is None else restated(standing, breached=True, cleared=False)
    details = IdentityEvidence(
        mistake=event.mistake,
        partner=event.partner,
        before_ns=event.before_ns,
        after_ns=event.after_ns,
        jump=number_evidence(event.jump, 3),
        left=number_evidence(event.left, 3),
        reason=_EXPLANATIONS[event.mistake],
        mounted=MountedAs(
            vehicle=mounting.vehicle, axle=mounting.axle, from_ns=mounting.from_ns, reversed=mounting.reversed
        ),
    )
    return Finding(
        wheelset=event.wheelset,
        kind=IDENTITY,
        breached=True,
        cleared=False,
        evidence=details.stored(),
        action="check_mounting",
        measured_ns=event.measured_ns,
    )


def mounting_corrected(alert: Alert, mounting: Mounting) -> bool:
    """Whether the mounting on file is another than the alert was raised on."""
    mounted = alert.evidence.get(MOUNTED)
    if alert.kind != IDENTITY or not isinstance(mounted, Mapping):
        return alert.kind == IDENTITY
    return any(mounted.get(field.name) != getattr(mounting, field.name) for field in fields(MountedAs))
