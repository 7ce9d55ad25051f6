"""A step that nobody registered: raised with place and size, the trend begins behind it, registering explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from believed_now import ahead_of
from due_geometries import due_geometries
from one_database import on_sqlite
from test_wear_jobs import feed, open_alert, run_jobs
from wheelset_life import DAY_NS, START_NS, geometry_of, geometry_record, register, run_windows

from api.schemas.trend import trend as served_trend
from bench.put_values import put_geometry
from estimation.alerts.rules.trend import LimitForecastRule, UnregisteredChangeRule, limit_forecast_finding
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.assumptions import last_break
from estimation.jobs.steps.wheelset_facts import facts_of
from estimation.storage import Storage
from estimation.values.alerts import CloseReason, Severity
from estimation.values.quantities import Forecast
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.registry import Reprofiling
from estimation.values.trend import TrendRecord, WearTrend

KIND = "unregistered_change"
STEP_DAY = 21  # the first day behind it


def stored(storage: Storage, conicities: Sequence[float], *, baseline: int = 0, first: int = 1) -> None:
    """Store an interval a day, the last also as the current geometry."""
    with storage.write() as unit:
        for day, conicity in enumerate(conicities, start=first):
            record = geometry_record("W1", day, day, conicity, baseline=baseline)
            put_geometry(unit, replace(record, geometry=geometry_of(conicity=conicity, std=0.03)))
        last = first + len(conicities) - 1
        put_geometry(unit, geometry_record("W1", None, last, conicities[-1], baseline=baseline, recorded_ns=last))
    run_windows(storage, "W1", last - 0.5, 20)


def life(size: float, behind: int, *, level: float = 0.3) -> list[float]:
    rng = np.random.default_rng(2)
    values = level + 0.001 * np.arange(STEP_DAY - 1 + behind) + 0.003 * rng.standard_normal(STEP_DAY - 1 + behind)
    values[STEP_DAY - 1 :] += size
    return [float(value) for value in values]


def trend(storage: Storage) -> WearTrend:
    with storage.read() as unit:
        record = unit.trends.latest("W1")
    assert record is not None
    return record.trend


def kinds_open(storage: Storage) -> set[str]:
    with storage.read() as unit:
        return {alert.kind for alert in unit.alerts.all_open("W1")}


@on_sqlite
def test_a_fall_is_raised_with_its_place_and_size_and_the_trend_begins_behind_it(storage: Storage) -> None:
    register(storage, "W1")
    stored(storage, life(-0.2, 2))
    run_jobs(storage, 22.2)
    assert KIND not in kinds_open(storage)
    assert trend(storage).step is None
    stored(storage, life(-0.2, 3))
    run_jobs(storage, 23.2)
    alert, step = open_alert(storage, "W1", KIND), trend(storage).step
    assert step is not None
    assert (alert.severity, alert.action) == (Severity.WARNING, "register_event")
    assert alert.opened_ns == step.found_ns == START_NS + 23 * DAY_NS
    assert (alert.evidence["before_km"], alert.evidence["after_km"]) == (20_000.0, 21_000.0)
    assert step.size.value == pytest.approx(-0.2, abs=0.02)
    assert "fallen by 0.20 at 21,000 km" in str(alert.evidence["reason"])
    now = trend(storage)
    assert now.mileage_km.tolist() == [21_000.0, 22_000.0, 23_000.0]
    assert now.fitted.value == pytest.approx(0.12, abs=0.02)
    assert code_of(now.fitted.reason) is code_of(now.slope_per_1000_km.reason) is ReasonCode.BEHIND_STEP
    assert code_of(now.reason) is code_of(now.few_behind) is ReasonCode.BEHIND_STEP
    assert now.distance_to_limit_km == now.date_of_limit_ns == Forecast(None, None, None)
    ahead = ahead_of(geometry_of(conicity=0.12), now)
    served = served_trend(TrendRecord("W1", 0, now, "d", "v", 1), None, ahead)
    assert served.distance_to_limit_km.reason_code is ReasonCode.BEHIND_STEP
    finding = limit_forecast_finding(LimitForecastRule(), "W1", now, ahead, 1)
    assert (finding.breached, finding.evidence["unknown_because_code"]) == (None, "behind_step")
    with storage.read() as unit:
        change = last_break(unit, unit.registry.wheelset("W1"))
        assert "W1" in due_geometries(unit)  # the current geometry begins again behind the step
    assert change is not None
    assert (change.before_ns, change.after_ns) == (step.before_ns, step.after_ns)
    before = feed(storage)
    run_jobs(storage, 23.4)
    assert feed(storage) == before


@on_sqlite
def test_a_rise_over_the_limit_is_critical_and_the_limit_is_held_behind_it(storage: Storage) -> None:
    register(storage, "W1")
    stored(storage, life(0.25, 5))
    run_jobs(storage, 25.2)
    alert = open_alert(storage, "W1", KIND)
    assert (alert.severity, alert.action) == (Severity.CRITICAL, "measure_wheel_profiles")
    assert "conicity_limit" in kinds_open(storage)
    now = trend(storage)
    assert now.fitted.value == pytest.approx(0.57, abs=0.03)
    assert now.fitted.reason is now.few_behind is None  # five intervals behind it are enough


@on_sqlite
@pytest.mark.parametrize(
    ("size", "severity"), [(-0.05, Severity.INFO), (-0.13, Severity.WARNING), (0.13, Severity.WARNING)]
)
def test_severity_is_by_direction_and_size(storage: Storage, size: float, severity: Severity) -> None:
    register(storage, "W1")
    stored(storage, life(size, 8, level=0.2))
    run_jobs(storage, 28.2)
    assert open_alert(storage, "W1", KIND).severity is severity


@on_sqlite
def test_a_reprofiling_that_is_registered_later_explains_it(storage: Storage) -> None:
    register(storage, "W1")
    stored(storage, life(-0.2, 5))
    run_jobs(storage, 25.2)
    number = open_alert(storage, "W1", KIND).alert_id
    with storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W1", START_NS + 20 * DAY_NS + 1, 20_000.0))
    stored(storage, life(-0.2, 5)[STEP_DAY - 1 :], baseline=1, first=STEP_DAY)
    run_jobs(storage, 25.4)
    with storage.read() as unit:
        alert = unit.alerts.get(number)
    assert alert.close_reason is CloseReason.REPROFILED
    assert KIND not in kinds_open(storage)
    assert trend(storage).step is None
    assert trend(storage).mileage_km.tolist() == [1000.0 * day for day in range(21, 26)]


@on_sqlite
def test_sensors_that_were_exchanged_then_explain_it_and_no_other_time_does(storage: Storage) -> None:
    register(storage, "W1")
    stored(storage, life(0.12, 5))
    run_jobs(storage, 25.2)
    with storage.read() as unit:
        facts = facts_of(unit, ["W1"], JobSettings())["W1"]
    rule, step = UnregisteredChangeRule(), trend(storage).step
    assert step is not None
    for at_ns, raised in (
        (step.before_ns - DAY_NS, False),
        (step.before_ns - DAY_NS - 1, True),
        (step.after_ns + DAY_NS, False),
        (step.after_ns + DAY_NS + 1, True),
    ):
        found = rule.find(replace(facts, sensors_changed_ns=at_ns), 0)
        assert found is not None
        assert (found.breached, found.stands) == (raised, raised)
    mounting = facts.wheelset.mounting
    assert mounting is not None
    for from_ns, raised in ((step.before_ns, True), (step.before_ns + 1, False)):
        wheelset = replace(facts.wheelset, mounting=replace(mounting, from_ns=from_ns))
        found = rule.find(replace(facts, wheelset=wheelset, open_alerts=()), 0)
        assert (found is not None) is raised


@on_sqlite
def test_what_came_back_clears_the_alert_by_itself(storage: Storage) -> None:
    register(storage, "W1")
    stored(storage, life(-0.2, 3))
    run_jobs(storage, 23.2)
    number = open_alert(storage, "W1", KIND).alert_id
    values = life(0.0, 20)
    values[STEP_DAY - 1 : STEP_DAY + 2] = [one - 0.2 for one in values[STEP_DAY - 1 : STEP_DAY + 2]]
    stored(storage, values)
    run_jobs(storage, 40.2)
    with storage.read() as unit:
        alert = unit.alerts.get(number)
    assert alert.close_reason is CloseReason.CLEARED
    assert len(trend(storage).value) == 40
