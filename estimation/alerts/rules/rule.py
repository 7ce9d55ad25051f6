"""What an alert rule is: limits and delays that the operator sets, and what they make of the facts of a wheelset."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from typing import Annotated, ClassVar

from annotated_types import Interval
from scipy.special import betainc

from estimation.alerts.identity import IdentityEvent
from estimation.alerts.parameters import FINDINGS
from estimation.trend.trend import TrendParameters, trend_up_to
from estimation.values.alerts import Alert, Evidence, Finding, MileageNow, Severity, number_evidence
from estimation.values.geometry import GeometryRecord, IntervalConicities, interval_conicities
from estimation.values.opinions import GearDamper
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import StepSurroundings, SuspensionShown, TrendRecord
from estimation.values.windows import WindowRecord, WindowState

# ranges of what a rules file may set; a number without one is from 0 to 1e9
Probability = Annotated[float, Interval(ge=0.5, le=0.9999)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Days = Annotated[float, Interval(ge=0.01, le=3650.0)]
Evaluations = Annotated[int, Interval(ge=1, le=1000)]
WindowCount = Annotated[int, Interval(ge=1, le=1_000_000)]
Kilometres = Annotated[float, Interval(ge=0.0, le=100_000.0)]


@dataclass(frozen=True, slots=True)
class AlertDelays:
    """How long something must be so before an alert follows it.

    An evaluation is one in vehicle time: after a window, or after an interval of mileage for what rests on geometries.
    How often the job ran does not count. Only where nothing is kept of earlier data (geometries without intervals) runs
    count, each with newer data than the last one.

    A delay in kilometres stands in place of that in evaluations: from the first finding that breaches (or is beyond the
    clear limit) to the last, none between them saying otherwise, the wheelset has run as far. 0 counts evaluations.
    """

    on_evaluations: Evaluations = 1
    off_evaluations: Evaluations = 2
    acknowledgement_days: Days = 90.0  # after which an acknowledgement ends by itself
    on_delay_km: Kilometres = 0.0
    off_delay_km: Kilometres = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelsetFacts:
    """What is stored of one wheelset, as the rules need it."""

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None  # that it is mounted in
    geometry: GeometryRecord | None  # current
    trend: TrendRecord | None  # latest
    windows: Sequence[WindowRecord]  # of the mounting in service, the newest that any rule looks at
    intervals: Sequence[GeometryRecord] = ()  # that hold, of the profile in this mounting, oldest first: the newest
    conicities: Sequence[IntervalConicities] = ()  # of all of them; empty where ``intervals`` are all
    mileage: MileageNow | None = None  # newest that is believed; None is that of the geometry
    open_alerts: Sequence[Alert] = ()
    identity: IdentityEvent | None = None  # since the last identity change
    suspension: SuspensionShown | None = None  # of its vehicle, where its alert stands at this wheelset
    step_surroundings: StepSurroundings = field(default_factory=StepSurroundings)  # of the step of its trend
    damper: GearDamper | None = None  # of the running gear whose first axle it is at
    trend_parameters: TrendParameters = field(default_factory=TrendParameters)  # of the trend
    rejected_recordings: Mapping[str, int] = field(default_factory=dict)  # of its vehicle, by code, as the one before
    limit_rule: AlertRule | None = None  # that of the conicity limit, of the same book
    profiles_measured_km: float | None = None  # mileage at which its profiles were last measured, since reprofiling
    sensors_changed_ns: int | None = None  # when the sensors of its axle were last exchanged or calibrated
    hunted: frozenset[int] = frozenset()  # starts of windows in which a wheelset of its vehicle hunts
    not_assessable_reason: Reason | None = None  # why the data do not show how the wheelset is now

    @property
    def all_conicities(self) -> Sequence[IntervalConicities]:
        """Those of all intervals that hold, of the profile in this mounting, oldest first."""
        return self.conicities or [interval_conicities(record) for record in self.intervals]

    @property
    def last_usable_ns(self) -> int | None:
        """End of the newest data that were estimated or wait for it."""
        ends = [w.start_ns + w.length_ns for w in self.windows if w.state is not WindowState.REFUSED]
        if self.geometry is not None:
            ends.append(self.geometry.to_ns)
        return max(ends, default=None)

    @property
    def current_trend(self) -> TrendRecord | None:
        """The latest trend, where it is of the profile that the current geometry is of."""
        if self.trend is None or self.geometry is None or self.trend.baseline != self.geometry.baseline:
            return None
        return self.trend


@dataclass(frozen=True, slots=True)
class AlertRule(ABC):
    """An alert rule; its fields are what the operator sets."""

    kind: ClassVar[str]  # its name in rules files and of its alerts, at most 32 letters
    limit_unit: ClassVar[str]  # of its alerts
    of_wear: ClassVar[bool] = False  # judges the profile: its alerts end with a reprofiling; may not be assessable
    of_sensors: ClassVar[bool] = False  # judges the sensors: its alerts end where they are exchanged or calibrated
    hides_wear: ClassVar[Reason | None] = None  # why the profile cannot be judged while it is breached
    advice: ClassVar[str] = ""  # what to do, in the words of the worklist; empty where the worklist has its own
    counts_km: ClassVar[bool] = False  # its findings have a mileage, so that its delays may be in kilometres
    relations: ClassVar[Sequence[tuple[str, str, str]]] = ()  # (field, "<=" or ">=", the field that limits it)
    evidence: ClassVar[type[Evidence] | None] = None  # what its alerts keep and the API answers

    enabled: bool = True
    delays: AlertDelays = field(default_factory=AlertDelays)

    @abstractmethod
    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return what the rule finds, at our time in ns UTC; None where it does not apply."""


def measured_until(windows: Sequence[WindowRecord], facts: WheelsetFacts) -> int:
    """Return the end of the last window, ns UTC; the begin of the mounting where there is none."""
    mounting = facts.wheelset.mounting
    ends = (window.start_ns + window.length_ns for window in windows)
    return max(ends, default=0 if mounting is None else mounting.from_ns)


def too_few_windows(windows: int, needed: int) -> Reason | None:
    """Return that there are fewer windows than a rule needs; None where there are enough."""
    if windows >= needed:
        return None
    return Reason(ReasonCode.TOO_FEW_WINDOWS, f"{windows} windows, {needed} needed")


@dataclass(frozen=True, slots=True)
class Run:
    """Findings on end that say the same; in rising or falling order of vehicle time."""

    count: int = 0
    least_km: float | None = None
    most_km: float | None = None

    def and_one(self, found: Finding) -> Run:
        """Return the run with one more."""
        at = found.mileage_km
        if at is None:
            return replace(self, count=self.count + 1)
        least = at if self.least_km is None else min(at, self.least_km)
        most = at if self.most_km is None else max(at, self.most_km)
        return Run(self.count + 1, least, most)

    def raises(self, delays: AlertDelays) -> bool:
        """Return whether breaches on end raise an alert."""
        return self._lasts(delays.on_evaluations, delays.on_delay_km)

    def clears(self, delays: AlertDelays) -> bool:
        """Return whether findings on end beyond the clear limit clear an alert."""
        return self._lasts(delays.off_evaluations, delays.off_delay_km)

    def _lasts(self, evaluations: int, km: float) -> bool:
        if km <= 0.0:
            return self.count >= evaluations
        return self.least_km is not None and self.most_km is not None and self.most_km - self.least_km >= km


NO_RUN = Run()


@dataclass(frozen=True, slots=True)
class Standing:
    """Whether an alert stands after some findings, and since when; ``run`` is towards its other state."""

    since_ns: int | None = None
    run: Run = NO_RUN

    def after(self, found: Finding, delays: AlertDelays) -> Standing:
        """Return what it is after one more finding in order of vehicle time; an undecided one changes nothing."""
        if found.breached is None:
            return self
        if self.since_ns is None:
            run = self.run.and_one(found) if found.breached else NO_RUN
            return Standing(found.measured_ns) if run.raises(delays) else Standing(None, run)
        run = self.run.and_one(found) if found.cleared else NO_RUN
        return Standing() if run.clears(delays) else Standing(self.since_ns, run)


def raised_at(findings: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert was raised that stands after findings in order of vehicle time, ns UTC; else None."""
    standing = Standing()
    for finding in findings:
        standing = standing.after(finding, delays)
    return standing.since_ns


def latest_run(newest_first: Iterable[Finding], delays: AlertDelays) -> bool:
    """Return whether the latest run of findings that was long enough raised an alert; False where none was."""
    # That is where an alert ends that is raised by breaches on end, for its on-delay, and cleared by findings beyond
    # the clear limit, for its off-delay. Going back from the newest, most wheelsets are decided by two.
    raising = clearing = NO_RUN
    for finding in newest_first:
        raising = raising.and_one(finding) if finding.breached else NO_RUN
        clearing = clearing.and_one(finding) if finding.cleared else NO_RUN
        if raising.raises(delays):
            return True
        if clearing.clears(delays):
            return False
    return False


def began(newest_first: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert that stands was raised, ns UTC, looking back from the newest to the last run that clears."""
    read: list[Finding] = []
    clearing = NO_RUN
    for finding in newest_first:
        read.append(finding)
        clearing = clearing.and_one(finding) if finding.cleared else NO_RUN
        if clearing.clears(delays):
            break
    return raised_at(reversed(read), delays)


def reach_km(delays: AlertDelays) -> float:
    """Return how far back findings count where a delay is in kilometres; 0 where none is."""
    return FINDINGS.look_back_factor * max(delays.on_delay_km, delays.off_delay_km)


def within_reach(mileages_km: Sequence[float | None], count: int, reach: float) -> int:
    """Return how many of the newest data count: at least ``count``, and those of the last kilometres."""
    believed = [at for at in mileages_km if at is not None]
    if reach <= 0.0 or not believed:
        return min(count, len(mileages_km))
    first = next(i for i, at in enumerate(mileages_km) if at is not None and at >= believed[-1] - reach)
    return min(len(mileages_km), max(count, len(mileages_km) - first))


@dataclass(frozen=True, slots=True)
class WindowsRule(AlertRule):
    """A rule on the latest windows: an alert stands as if it had been evaluated at each of them."""

    counts_km = True

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 20

    @abstractmethod
    def find_in(self, windows: Sequence[WindowRecord], facts: WheelsetFacts) -> Finding:
        """Return the finding of the latest windows, oldest first."""

    @abstractmethod
    def is_suspect(self, window: WindowRecord, facts: WheelsetFacts) -> bool:
        """Return whether a window can raise anything; without such windows nothing stands."""

    def counts_from_ns(self, facts: WheelsetFacts) -> int | None:  # noqa: ARG002 - of those that override it
        """Return the start of the first window that counts, ns UTC; None where all of the mounting count."""
        return None

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the latest windows of the mounting.

        The newest ``look_back_factor`` times ``latest_windows`` show whether an alert stands, with delays in kilometres
        also all of the last ``reach_km``.
        """
        if facts.wheelset.mounting is None:
            return None
        from_ns, latest = self.counts_from_ns(facts), self.latest_windows
        counting = (window for window in facts.windows if from_ns is None or window.start_ns >= from_ns)
        ordered = sorted(counting, key=lambda window: window.start_ns)
        now = self.find_in(ordered[-latest:], facts)
        if not any(self.is_suspect(window, facts) for window in ordered):
            return replace(now, stands=False)
        mileages = [None if window.implausible is not None else window.mileage_km for window in ordered]
        first = len(ordered) - within_reach(mileages, FINDINGS.look_back_factor * latest, reach_km(self.delays))

        def after(end: int) -> Finding:
            finding = self.find_in(ordered[max(first, end - latest) : end], facts)
            return replace(finding, mileage_km=mileages[end - 1])

        since_ns = raised_at((after(end) for end in range(first + 1, len(ordered) + 1)), self.delays)
        return replace(now, stands=since_ns is not None, since_ns=since_ns)


@dataclass(frozen=True, slots=True)
class WindowShareRule(WindowsRule):
    """A rule on the share of the latest windows that show something.

    With k of n windows, the probability that the share exceeds a limit is that of a Beta(k + 1, n - k + 1), the
    posterior of a flat prior.
    """

    relations = (("clear_share", "<=", "raise_share"), ("minimum_windows", "<=", "latest_windows"))

    minimum_windows: WindowCount = 3
    raise_share: Share = 0.5
    clear_share: Share = 0.1
    raise_probability: Probability = 0.8
    clear_probability: Probability = 0.8

    def share_finding(
        self,
        windows: Sequence[WindowRecord],
        showing: int,
        facts: WheelsetFacts,
        evidence: Evidence,
        action: str,
        severity: Severity = Severity.WARNING,
    ) -> Finding:
        """Return the finding of the latest windows of which some show it; too few of them decide nothing."""
        known, shape = len(windows) >= self.minimum_windows, (showing + 1, len(windows) - showing + 1)
        over, below_clear = float(1.0 - betainc(*shape, self.raise_share)), float(betainc(*shape, self.clear_share))
        return Finding(
            wheelset=facts.wheelset.serial,
            kind=self.kind,
            breached=over >= self.raise_probability if known else None,
            cleared=below_clear >= self.clear_probability if known else None,
            severity=severity,
            probability=number_evidence(over, 3) if known else None,
            evidence=evidence.stored(),
            action=action,
            raise_limit=self.raise_share,
            clear_limit=self.clear_share,
            measured_ns=measured_until(windows, facts),
        )


@dataclass(frozen=True, slots=True)
class IntervalsRule(AlertRule):
    """A rule on the profile: an alert stands as if it had been evaluated after each interval of mileage.

    The newest ``look_back_intervals`` count, with delays in kilometres also those of the last ``reach_km``.
    """

    counts_km = True
    of_wear = True

    @abstractmethod
    def find_now(self, facts: WheelsetFacts) -> Finding | None:
        """Return what the facts show without those before; None where the rule does not apply."""

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the present finding; without intervals it leaves open whether an alert stands.

        What hides the present state (``not_assessable_reason``) does not undo what the data have shown. Severity and
        action are then those of the newest data that decide.
        """
        now = self.find_now(facts)
        if now is None:
            return None
        now = replace(now, mileage_km=None if facts.geometry is None else facts.geometry.mileage_km)
        if not facts.intervals:
            return now
        read: list[Finding] = []
        deciding = self._deciding(facts, read)
        standing = latest_run(deciding, self.delays)
        if not read:
            return now
        if standing and all(alert.kind != now.kind for alert in facts.open_alerts):  # it will be opened
            now = replace(now, since_ns=began(chain(read.copy(), deciding), self.delays))
        if now.breached is not None:
            return replace(now, stands=standing)
        return replace(now, stands=standing, severity=read[0].severity, action=read[0].action)

    def _deciding(self, facts: WheelsetFacts, read: list[Finding]) -> Iterator[Finding]:
        """Yield the findings that decide, newest first, each at the mileage of its interval, and keep what was read."""
        intervals = counting(facts, self.delays)
        for record, then in zip(reversed(intervals), _newest_first(facts, intervals), strict=True):
            finding = self.find_now(then)
            if finding is not None and finding.breached is not None:
                finding = replace(finding, mileage_km=record.mileage_km)
                read.append(finding)
                yield finding


def counting(facts: WheelsetFacts, delays: AlertDelays) -> Sequence[GeometryRecord]:
    """Return the newest intervals that count; delays in kilometres may reach further back."""
    mileages = [record.mileage_km for record in facts.intervals]
    return facts.intervals[-within_reach(mileages, FINDINGS.look_back_intervals, reach_km(delays)) :]


def _newest_first(facts: WheelsetFacts, intervals: Sequence[GeometryRecord]) -> Iterator[WheelsetFacts]:
    """Yield the facts as they are, and as they were after each earlier interval, had all earlier data been there."""
    yield replace(facts, not_assessable_reason=None)
    for record, following in reversed(list(pairwise(intervals))):
        trend = None
        if facts.current_trend is not None and facts.current_trend.trend.not_comparable is None:
            trend = trend_up_to(facts.current_trend, record.mileage_km, facts.trend_parameters)
        # until the next interval it has run as far as that one
        mileage = MileageNow(following.mileage_km, following.to_ns)
        yield replace(facts, geometry=record, trend=trend, mileage=mileage, not_assessable_reason=None)
