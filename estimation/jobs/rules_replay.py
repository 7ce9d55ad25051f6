"""What alert rules would have raised over the stored history of a wheelset. Reads; nothing is written.

The rules are evaluated at the end of every day with windows, after every interval of mileage, when a silence has become
too long, and at every reprofiling and mounting: each time on the data up to then, as they are known now. Corrections
therefore count from the beginning, and two rule books differ by nothing but the rules. What compares wheelsets or
vehicles with each other is not evaluated again: ``identity`` is taken as it was raised, ``suspension_change`` and
rejected recordings are left out, and nothing is grouped into fleet alerts.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

from estimation.adhesion.friction import section_adhesion
from estimation.alerts.life_cycle import close, transition
from estimation.alerts.rule_book import RuleBook, findings, section_changes, superseded
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.rule import WheelsetFacts, within_reach
from estimation.alerts.rules.running_gear import LowAdhesionRule, SuspensionChangeRule, WeakDamperRule
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.jobs.refresh_trends import beforehand, trend_of, turned_km
from estimation.jobs.steps.assumptions import identity_change
from estimation.jobs.steps.wheelset_facts import hunted_beside, newest_mileage, windows_wanted
from estimation.jobs.steps.window_creep import friction_parameters, pool_ends, pooled_ns
from estimation.storage import UnitOfWork
from estimation.trend.trend import TrendParameters, behind_step
from estimation.values.alerts import Alert, Condition, Transition
from estimation.values.geometry import GeometryRecord, IntervalConicities, interval_conicities
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.trend import IDENTITY, FleetWear, IdentityChange, TrendRecord, WearTrend, since_change
from estimation.values.units import DAY_NS
from estimation.values.windows import WindowRecord, WindowState

NOT_REPLAYED = (IDENTITY, SuspensionChangeRule.kind, WeakDamperRule.kind)
_Trends = Callable[[Sequence[IntervalConicities], float], WearTrend]


@dataclass(frozen=True, slots=True)
class History:
    """What is stored of one wheelset, as it is known now; windows by start, geometries by their end."""

    wheelset: WheelsetRecord
    mountings: Sequence[Mounting]
    vehicles: Mapping[str, VehicleRecord]
    windows: Sequence[WindowRecord]
    intervals: Sequence[GeometryRecord]  # of all baselines, with windows
    current: GeometryRecord | None
    change: IdentityChange | None
    raised: Sequence[Alert]  # all alerts of the wheelset, open and closed
    window_ends: Sequence[int]
    interval_ends: Sequence[int]
    conicities: Sequence[IntervalConicities]
    hunted: Mapping[str, frozenset[int]]  # by vehicle, starts of windows
    fleet: FleetWear  # what is known of its wear beforehand


def history_of(unit: UnitOfWork, serial: str) -> History:
    """Return what is stored of a wheelset."""
    mountings = sorted(unit.registry.mountings(serial), key=lambda mounting: mounting.from_ns)
    windows = sorted(unit.windows.list(serial), key=lambda window: window.start_ns)
    stored = (record for record in unit.geometries.intervals(serial) if record.geometry.windows)
    intervals = sorted(stored, key=lambda interval: (interval.to_ns, interval.baseline))
    return History(
        wheelset=unit.registry.wheelset(serial),
        mountings=mountings,
        vehicles={mounting.vehicle: unit.registry.vehicle(mounting.vehicle) for mounting in mountings},
        windows=windows,
        intervals=intervals,
        current=unit.geometries.current(serial),
        change=identity_change(unit, serial),
        raised=unit.alerts.of_wheelset(serial),
        window_ends=[window.start_ns + window.length_ns for window in windows],
        interval_ends=[interval.to_ns for interval in intervals],
        conicities=[interval_conicities(interval) for interval in intervals],
        hunted={mounting.vehicle: hunted_beside(unit, mounting.vehicle, windows) for mounting in mountings},
        fleet=beforehand(unit, [serial])[serial],
    )


def replayed(history: History, book: RuleBook, span: tuple[int, int]) -> list[Alert]:
    """Return the alerts that rules would have raised and that were open within a span of time, ns UTC, by opening."""
    kept: dict[tuple[int, int, float], WearTrend] = {}

    def trends(records: Sequence[IntervalConicities], limit: float) -> WearTrend:
        key = (records[-1].baseline, len(records), limit)
        if key not in kept:
            kept[key] = trend_of(
                records, limit, TrendParameters(), history.fleet, turned_km(history.wheelset, records[-1].baseline)
            )
        return kept[key]

    standing: dict[str, Alert] = {}
    closed: list[Alert] = []
    for at_ns in _instants(history, book, span):
        _evaluate(history, book, at_ns, standing, closed, trends)
    published = [alert for alert in (*closed, *standing.values()) if alert.condition is not Condition.PENDING]
    within = [alert for alert in published if alert.closed_ns is None or alert.closed_ns >= span[0]]
    return sorted(within, key=lambda alert: (alert.opened_ns, alert.kind))


def _evaluate(
    history: History, book: RuleBook, at_ns: int, standing: dict[str, Alert], closed: list[Alert], trends: _Trends
) -> None:
    """Bring the alerts that stand up to a time; those that end go to ``closed``."""
    wheelset, vehicle = _then(history, at_ns)
    rules = book.of(wheelset.fleet, None if vehicle is None else vehicle.vehicle_class)
    facts = _facts(history, rules, wheelset, vehicle, at_ns, trends)
    facts = replace(facts, open_alerts=(*facts.open_alerts, *standing.values()))
    for alert, reason, ended_ns in superseded(facts, rules):
        if standing.pop(alert.kind, None) is not None:
            closed.append(close(alert, reason, ended_ns).alert)
    for finding in findings(facts, rules, at_ns):
        if finding.kind in NOT_REPLAYED:
            continue
        change = transition(
            standing.get(finding.kind), finding, at_ns, fleet=wheelset.fleet, delays=rules.delays_of(finding.kind)
        )
        _follow(change, finding.kind, standing, closed)


def _follow(change: Transition | None, key: str, standing: dict[str, Alert], closed: list[Alert]) -> None:
    if change is None:
        return
    if change.alert.closed_ns is None:
        standing[key] = change.alert
    else:
        standing.pop(key, None)
        if change.events:  # one that was never raised leaves nothing
            closed.append(change.alert)


def _then(history: History, at_ns: int) -> tuple[WheelsetRecord, VehicleRecord | None]:
    """Return the wheelset and its vehicle as the records had them at a time."""
    mounted = [mounting for mounting in history.mountings if mounting.covers(at_ns)]
    mounting = replace(mounted[-1], to_ns=None) if mounted else None
    done = tuple(reprofiling for reprofiling in history.wheelset.reprofilings if reprofiling.at_ns <= at_ns)
    wheelset = replace(history.wheelset, mounting=mounting, reprofilings=done)
    return wheelset, None if mounting is None else history.vehicles[mounting.vehicle]


def _facts(
    history: History,
    book: RuleBook,
    wheelset: WheelsetRecord,
    vehicle: VehicleRecord | None,
    at_ns: int,
    trends: _Trends,
) -> WheelsetFacts:
    """Return the facts of a time, without the alerts that the replay has raised."""
    mounting = wheelset.mounting
    if mounting is None or vehicle is None:
        return WheelsetFacts(wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=())
    intervals = history.intervals[: bisect_right(history.interval_ends, at_ns)]
    change = history.change if history.change is not None and history.change.after_ns <= at_ns else None
    baseline = len(wheelset.reprofilings)
    of_profile = [interval for interval in since_change(intervals, change) if interval.baseline == baseline]
    light = since_change(history.conicities[: len(intervals)], change)
    conicities = [interval for interval in light if interval.baseline == baseline]
    geometry = max(intervals, key=lambda interval: (interval.baseline, interval.to_ns), default=None)
    current = history.current
    if current is not None and current.to_ns <= at_ns and (geometry is None or current.baseline >= geometry.baseline):
        geometry = current
    limit = book.rule(ConicityLimitRule).limit_for(vehicle)
    trend = None
    if of_profile and limit is not None:
        fitted = trends(conicities, limit)
        trend = TrendRecord(wheelset.serial, of_profile[-1].baseline, fitted, "", "", at_ns)
        conicities = behind_step(conicities, fitted.step)
        if fitted.step is not None:
            of_profile = [interval for interval in of_profile if interval.from_ns >= fitted.step.after_ns]
    windows = _windows(history, mounting.from_ns, at_ns, book)
    return WheelsetFacts(
        wheelset=wheelset,
        vehicle=vehicle,
        geometry=geometry,
        trend=trend,
        windows=windows,
        mileage=newest_mileage(windows),
        intervals=[interval for interval in of_profile if interval.to_ns > mounting.from_ns],
        conicities=[conicity for conicity in conicities if conicity.to_ns > mounting.from_ns],
        open_alerts=[alert for alert in history.raised if alert.kind == IDENTITY and _open_at(alert, at_ns)],
        hunted=history.hunted.get(mounting.vehicle, frozenset()),
    )


def _open_at(alert: Alert, at_ns: int) -> bool:
    return alert.opened_ns <= at_ns and (alert.closed_ns is None or at_ns < alert.closed_ns)


def _windows(history: History, since_ns: int, at_ns: int, book: RuleBook) -> Sequence[WindowRecord]:
    wanted, far_km = windows_wanted(book)
    last = bisect_right(history.window_ends, at_ns)
    first = 0 if far_km > 0.0 else max(0, last - wanted)
    windows = [window for window in history.windows[first:last] if window.start_ns >= since_ns]
    mileages = [None if window.implausible else window.mileage_km for window in windows]
    return windows[-within_reach(mileages, wanted, far_km) :] if windows else ()


def _instants(history: History, book: RuleBook, span: tuple[int, int]) -> list[int]:
    """Return when the rules are evaluated: within the span, and once before it."""
    last_of_day = {end // DAY_NS: end for end in history.window_ends}
    times = {*last_of_day.values(), *history.interval_ends, *_silences(history, book, span[1])}
    if history.current is not None:
        times.add(history.current.to_ns)
    times |= {reprofiling.at_ns for reprofiling in history.wheelset.reprofilings}
    times |= {m.from_ns for m in history.mountings} | {m.to_ns for m in history.mountings if m.to_ns}
    ordered = sorted(time for time in times if time <= span[1])
    return [*ordered[max(0, bisect_right(ordered, span[0] - 1) - 1) :], span[1]]


def _silences(history: History, book: RuleBook, to_ns: int) -> set[int]:
    """Return when silences between usable data became too long."""
    ends = zip(history.windows, history.window_ends, strict=True)
    usable = {end for window, end in ends if window.state is not WindowState.REFUSED} | {*history.interval_ends}
    if history.current is not None:
        usable.add(history.current.to_ns)
    times: set[int] = set()
    for mounting in history.mountings:
        vehicle = history.vehicles[mounting.vehicle]
        rule = book.of(history.wheelset.fleet, vehicle.vehicle_class).rule(NoDataRule)
        ended = to_ns if mounting.to_ns is None else min(mounting.to_ns, to_ns)
        ends_of_data = [mounting.from_ns, *sorted(end for end in usable if mounting.from_ns < end <= ended), ended]
        for begin, end in pairwise(ends_of_data):
            late = (begin + round(days * DAY_NS) + 1 for days in (rule.days, rule.critical_days))
            times |= {time for time in late if time <= end}
    return times


class Change(StrEnum):
    """What becomes of an alert by other rules."""

    MORE = "more"  # only the other rules raise it
    FEWER = "fewer"  # only the rules in force raise it
    EARLIER = "earlier"  # opened earlier by the other rules
    LATER = "later"
    SHORTER = "shorter"  # opened at the same time, closed earlier
    LONGER = "longer"
    SEVERITY = "severity"  # the same times, another severity
    SAME = "same"


@dataclass(frozen=True, slots=True)
class Difference:
    """One alert by the rules in force and by the other rules; None where these do not raise it."""

    change: Change
    before: Alert | None
    after: Alert | None


def differences(before: Sequence[Alert], after: Sequence[Alert]) -> list[Difference]:
    """Return how the alerts of one wheelset differ; two of a kind that were open at one time are the same alert."""
    left = sorted(before, key=lambda alert: alert.opened_ns)
    listed: list[Difference] = []
    for alert in sorted(after, key=lambda alert: alert.opened_ns):
        same = next((other for other in left if other.kind == alert.kind and _meet(other, alert)), None)
        if same is None:
            listed.append(Difference(Change.MORE, None, alert))
        else:
            left.remove(same)
            listed.append(Difference(_change(same, alert), same, alert))
    listed += [Difference(Change.FEWER, alert, None) for alert in left]
    return sorted(listed, key=lambda item: min(alert.opened_ns for alert in (item.before, item.after) if alert))


def _meet(alert: Alert, other: Alert) -> bool:
    """Return whether two alerts were open at one time."""
    return _ends(alert) >= other.opened_ns and _ends(other) >= alert.opened_ns


def _ends(alert: Alert) -> float:
    return float("inf") if alert.closed_ns is None else alert.closed_ns


def _change(before: Alert, after: Alert) -> Change:
    if after.opened_ns != before.opened_ns:
        return Change.EARLIER if after.opened_ns < before.opened_ns else Change.LATER
    if _ends(after) != _ends(before):
        return Change.SHORTER if _ends(after) < _ends(before) else Change.LONGER
    return Change.SAME if after.severity is before.severity else Change.SEVERITY


def section_replayed(unit: UnitOfWork, section: str, book: RuleBook, span: tuple[int, int]) -> list[Alert]:
    """Return the alerts of low adhesion that rules would have raised about a section within a span, ns, by opening."""
    rule = book.rule(LowAdhesionRule)
    # one that is not on file any more has no places
    length = next((on_file.length_m for on_file in unit.tracks.sections() if on_file.code == section), 0.0)
    pooled = pooled_ns(rule)
    standing: dict[str, Alert] = {}
    closed: list[Alert] = []
    for to_ns in pool_ends(unit.adhesion.starts_with_sums(section, *span), pooled):
        passes = unit.adhesion.of_section(section, to_ns - pooled, to_ns)
        friction = section_adhesion(section, passes, friction_parameters(rule, unit, passes), length)
        if friction is not None:
            fleets = {unit.registry.vehicle(code).fleet for code in {window_pass.vehicle for window_pass in passes}}
            for change in section_changes(book, friction, fleets, dict(standing), friction.to_ns):
                _follow(change, change.alert.fleet, standing, closed)
    published = [alert for alert in (*closed, *standing.values()) if alert.condition is not Condition.PENDING]
    return sorted(published, key=lambda alert: (alert.opened_ns, alert.fleet))
