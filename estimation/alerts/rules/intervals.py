"""Whether an alert on estimates stands: by all intervals of mileage, not by how often it was evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain

import numpy as np

from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts
from estimation.alerts.rules.standing import began, latest_run, reach_km, within_reach
from estimation.trend.extrapolation import conicity_points
from estimation.trend.trend import TrendParameters, TrendPoint, refresh
from estimation.values.alerts import Finding
from estimation.values.geometry import GeometryRecord
from estimation.values.trend import TrendRecord, WearTrend

LOOK_BACK = 24  # intervals of mileage: what was earlier raises nothing any more
KEPT_TRENDS = 10_000  # of earlier intervals, which do not change: a fit costs some 10 ms


def with_standing(
    find: Callable[[WheelsetFacts], Finding | None], facts: WheelsetFacts, delays: AlertDelays
) -> Finding | None:
    """Return the present finding, with whether an alert stands had it been evaluated after each interval of mileage.

    What hides the present state (``not_assessable_reason``) does not undo what the data have shown. Severity and
    action are then those of the newest data that decide.

    Args:
        find: Finding of facts; None where the rule does not apply.
        facts: Of one wheelset; without ``intervals`` the finding leaves open whether an alert stands. The newest
            ``LOOK_BACK`` intervals count, with delays in kilometres also those of the last ``reach_km``.
        delays: How long before it is raised and cleared.
    """
    now = find(facts)
    if now is None:
        return None
    now = replace(now, mileage_km=None if facts.geometry is None else facts.geometry.mileage_km)
    if not facts.intervals:
        return now
    read: list[Finding] = []
    deciding = _deciding(find, facts, read, delays)
    standing = latest_run(deciding, delays)
    if not read:
        return now
    if standing and all(alert.kind != now.kind for alert in facts.open_alerts):  # it will be opened
        now = replace(now, since_ns=began(chain(read.copy(), deciding), delays))
    if now.breached is not None:
        return replace(now, stands=standing)
    return replace(now, stands=standing, severity=read[0].severity, action=read[0].action)


def _deciding(
    find: Callable[[WheelsetFacts], Finding | None],
    facts: WheelsetFacts,
    read: list[Finding],
    delays: AlertDelays,
) -> Iterator[Finding]:
    """Yield the findings that decide, newest first, each at the mileage of its interval, and keep what was read."""
    intervals = facts.intervals[-counting(facts, delays) :]
    for record, one in zip(reversed(intervals), _newest_first(facts, intervals), strict=True):
        found = find(one)
        if found is not None and found.breached is not None:
            found = replace(found, mileage_km=record.mileage_km)
            read.append(found)
            yield found


def counting(facts: WheelsetFacts, delays: AlertDelays) -> int:
    """Return how many of the newest intervals count.

    Args:
        delays: Those in kilometres may reach further back.
    """
    return within_reach([record.mileage_km for record in facts.intervals], LOOK_BACK, reach_km(delays))


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
