"""Whether an alert stands: by all data in vehicle time, not by how often they were looked at."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from typing import Annotated

import numpy as np
from annotated_types import Interval
from scipy.special import betainc

from estimation.alerts.rules.rule import (
    AlertDelays,
    AlertRule,
    Evidence,
    Probability,
    Share,
    WheelsetFacts,
    WindowCount,
    measured_until,
    number_evidence,
)
from estimation.trend.extrapolation import conicity_points
from estimation.trend.trend import TrendParameters, refresh
from estimation.values.alerts import Finding, Severity
from estimation.values.geometry import GeometryRecord
from estimation.values.trend import TrendPoint, TrendRecord, WearTrend
from estimation.values.windows import WindowRecord

LOOK_BACK = 5  # times the windows that a rule looks at: what was earlier raises nothing any more
LOOK_BACK_INTERVALS = 24  # intervals of mileage: what was earlier raises nothing any more
KEPT_TRENDS = 10_000  # of earlier intervals, which do not change: a fit costs some 10 ms


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
        return self._as_long_as(delays.on_evaluations, delays.on_delay_km)

    def clears(self, delays: AlertDelays) -> bool:
        """Return whether findings on end beyond the clear limit clear an alert."""
        return self._as_long_as(delays.off_evaluations, delays.off_delay_km)

    def _as_long_as(self, evaluations: int, km: float) -> bool:
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


def raised_at(found: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert was raised that stands after findings in order of vehicle time, ns UTC; else None."""
    standing = Standing()
    for one in found:
        standing = standing.after(one, delays)
    return standing.since_ns


def latest_run(newest_first: Iterable[Finding], delays: AlertDelays) -> bool:
    """Return whether the latest run of findings that was long enough raised an alert; False where none was.

    That is where an alert ends that is raised by breaches on end, for its on-delay, and cleared by findings beyond the
    clear limit, for its off-delay. Going back from the newest, most wheelsets are decided by two.
    """
    raising = clearing = NO_RUN
    for found in newest_first:
        raising = raising.and_one(found) if found.breached else NO_RUN
        clearing = clearing.and_one(found) if found.cleared else NO_RUN
        if raising.raises(delays):
            return True
        if clearing.clears(delays):
            return False
    return False


def began(newest_first: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert that stands was raised, ns UTC, looking back from the newest to the last run that clears."""
    read: list[Finding] = []
    clearing = NO_RUN
    for found in newest_first:
        read.append(found)
        clearing = clearing.and_one(found) if found.cleared else NO_RUN
        if clearing.clears(delays):
            break
    return raised_at(reversed(read), delays)


def reach_km(delays: AlertDelays) -> float:
    """Return how far back findings count where a delay is in kilometres; 0 where none is."""
    return LOOK_BACK * max(delays.on_delay_km, delays.off_delay_km)


def within_reach(mileages_km: Sequence[float | None], count: int, reach: float) -> int:
    """Return how many of the newest data count: at least ``count``, and those of the last kilometres."""
    known = [at for at in mileages_km if at is not None]
    if reach <= 0.0 or not known:
        return min(count, len(mileages_km))
    first = next(i for i, at in enumerate(mileages_km) if at is not None and at >= known[-1] - reach)
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

        The newest ``LOOK_BACK`` times ``latest_windows`` show whether an alert stands, with delays in kilometres also
        all of the last ``reach_km``.
        """
        if facts.wheelset.mounting is None:
            return None
        from_ns, latest = self.counts_from_ns(facts), self.latest_windows
        counting = (one for one in facts.windows if from_ns is None or one.start_ns >= from_ns)
        ordered = sorted(counting, key=lambda window: window.start_ns)
        now = self.find_in(ordered[-latest:], facts)
        if not any(self.is_suspect(window, facts) for window in ordered):
            return replace(now, stands=False)
        mileages = [None if one.implausible is not None else one.mileage_km for one in ordered]
        first = len(ordered) - within_reach(mileages, LOOK_BACK * latest, reach_km(self.delays))

        def after(end: int) -> Finding:
            found = self.find_in(ordered[max(first, end - latest) : end], facts)
            return replace(found, mileage_km=mileages[end - 1])

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

    The newest ``LOOK_BACK_INTERVALS`` intervals count, with delays in kilometres also those of the last ``reach_km``.
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
        for record, one in zip(reversed(intervals), _newest_first(facts, intervals), strict=True):
            found = self.find_now(one)
            if found is not None and found.breached is not None:
                found = replace(found, mileage_km=record.mileage_km)
                read.append(found)
                yield found


def counting(facts: WheelsetFacts, delays: AlertDelays) -> Sequence[GeometryRecord]:
    """Return the newest intervals that count; delays in kilometres may reach further back."""
    mileages = [record.mileage_km for record in facts.intervals]
    return facts.intervals[-within_reach(mileages, LOOK_BACK_INTERVALS, reach_km(delays)) :]


def _newest_first(facts: WheelsetFacts, intervals: Sequence[GeometryRecord]) -> Iterator[WheelsetFacts]:
    """Yield the facts as they are, and as they were after each earlier interval, had all earlier data been there."""
    yield replace(facts, not_assessable_reason=None)
    shared_std: float | None = None
    for record in reversed(intervals[:-1]):
        trend = None
        if facts.current_trend is not None and facts.current_trend.trend.not_comparable is None:
            if shared_std is None:
                shared_std = conicity_points(facts.all_conicities).spread
            trend = _trend_up_to(facts.current_trend, record.mileage_km, shared_std, facts.trend_parameters)
        yield replace(facts, geometry=record, trend=trend, not_assessable_reason=None)


def _trend_up_to(record: TrendRecord, mileage_km: float, shared_std: float, parameters: TrendParameters) -> TrendRecord:
    now = record.trend
    until = int(np.searchsorted(now.mileage_km, mileage_km, side="right"))
    columns = (now.mileage_km, now.measured_ns, now.value, now.std)
    points = tuple(column[:until].tobytes() for column in columns)
    return replace(record, trend=_refitted(points, now.limit, now.quantity, shared_std, parameters))


@lru_cache(KEPT_TRENDS)
def _refitted(
    points: tuple[bytes, ...], limit: float, quantity: str, shared_std: float, parameters: TrendParameters
) -> WearTrend:
    kinds = (np.float64, np.int64, np.float64, np.float64)
    columns = [np.frombuffer(column, kind).tolist() for column, kind in zip(points, kinds, strict=True)]
    rows = [TrendPoint(*row) for row in zip(*columns, strict=True)]
    return refresh(rows, limit, parameters, quantity=quantity, shared_std=shared_std)
