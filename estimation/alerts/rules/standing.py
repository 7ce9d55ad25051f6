"""Whether an alert stands: by all data in vehicle time, not by how often they were looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts
from estimation.values.alerts import Finding
from estimation.values.windows import WindowRecord

LOOK_BACK = 5  # times the windows that a rule looks at: what was earlier raises nothing any more


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
        """Return what it is after one more finding in order of vehicle time; one that decides nothing changes nothing.

        Args:
            delays: How long a run raises and clears.
        """
        if found.breached is None:
            return self
        if self.since_ns is None:
            run = self.run.and_one(found) if found.breached else NO_RUN
            return Standing(found.measured_ns) if run.raises(delays) else Standing(None, run)
        run = self.run.and_one(found) if found.cleared else NO_RUN
        return Standing() if run.clears(delays) else Standing(self.since_ns, run)


def raised_at(found: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert was raised that stands after the findings, ns UTC; None where none stands.

    Args:
        found: In order of vehicle time; those that decide nothing do not count.
        delays: How long a run raises and clears.
    """
    standing = Standing()
    for one in found:
        standing = standing.after(one, delays)
    return standing.since_ns


def latest_run(newest_first: Iterable[Finding], delays: AlertDelays) -> bool:
    """Return whether the latest run of findings that was long enough raised an alert; False where none was.

    That is where an alert ends that is raised by breaches on end, for its on-delay, and cleared by findings beyond the
    clear limit, for its off-delay. Going back from the newest, most wheelsets are decided by two.

    Args:
        newest_first: Findings that decide, in falling order of vehicle time; read as far as needed.
        delays: How long a run raises and clears.
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
    """Return when an alert that stands was raised, ns UTC, looking back to the last run that cleared.

    Args:
        newest_first: Findings that decide, in falling order of vehicle time; read as far as needed.
        delays: How long a run raises and clears.
    """
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
    """Return how many of the newest data count: at least ``count``, and those of the last kilometres.

    Args:
        mileages_km: In order of vehicle time; None where not known.
        count: How many count at least.
        reach: Kilometres; 0 where none count.
    """
    known = [at for at in mileages_km if at is not None]
    if reach <= 0.0 or not known:
        return min(count, len(mileages_km))
    first = next(i for i, at in enumerate(mileages_km) if at is not None and at >= known[-1] - reach)
    return min(len(mileages_km), max(count, len(mileages_km) - first))


def of_windows(
    find: Callable[[Sequence[WindowRecord]], Finding],
    facts: WheelsetFacts,
    suspect: Callable[[WindowRecord], bool],
    latest: int,
    delays: AlertDelays,
) -> Finding:
    """Return the finding of the latest windows, with whether an alert stands had it been evaluated at each of them.

    Args:
        find: Finding of at most ``latest`` windows, oldest first.
        facts: Windows in any order; the newest ``LOOK_BACK`` times ``latest`` of them count, with delays in kilometres
            also all of the last ``reach_km``.
        suspect: Whether a window can raise anything; without such windows nothing stands.
        delays: How long before it is raised and cleared.
    """
    now = find(facts.windows)
    if not any(suspect(window) for window in facts.windows):
        return replace(now, stands=False)
    ordered = sorted(facts.windows, key=lambda window: window.start_ns)
    ordered = ordered[-within_reach([_mileage(one) for one in ordered], LOOK_BACK * latest, reach_km(delays)) :]

    def after(end: int) -> Finding:
        return replace(find(ordered[max(0, end - latest) : end]), mileage_km=_mileage(ordered[end - 1]))

    since_ns = raised_at((after(end) for end in range(1, len(ordered) + 1)), delays)
    return replace(now, stands=since_ns is not None, since_ns=since_ns)


def _mileage(window: WindowRecord) -> float | None:
    return window.mileage_km if window.implausible is None else None
