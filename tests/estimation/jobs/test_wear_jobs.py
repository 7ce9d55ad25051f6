"""Geometries become trends become alerts, on both databases; what is repeated changes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, geometry_of, geometry_record, register, run_windows, wear

from bench.put_values import put_geometry
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair, wheel_contact
from estimation.alerts.life_cycle import acknowledge
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.jobs import evaluate_alerts, refresh_trends
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.alerts import Alert, AlertEvent, AlertEventKind, CloseReason, Condition
from estimation.values.error_parts import ErrorSource
from estimation.values.quantities import Status
from estimation.values.registry import Mounting, Reprofiling, SensorChange, SensorWork
from estimation.values.runs import JobRun, JobTrigger
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import SuspensionFinding
from estimation.values.windows import Hunting
from fleet_db.records import Decision
from fleet_db.storage import SqlStorage

RAISED, UPDATED, CLEARED, CLOSED = (
    AlertEventKind.RAISED,
    AlertEventKind.UPDATED,
    AlertEventKind.CLEARED,
    AlertEventKind.CLOSED,
)


def at_day(storage: Storage, day: float, rules: RuleBook | None = None) -> JobContext:
    return JobContext(storage, SetClock(START_NS + round(day * DAY_NS)), "test", JobSettings(rules=rules or RuleBook()))


def run_jobs(storage: Storage, day: float, rules: RuleBook | None = None) -> tuple[JobRun, JobRun]:
    context = at_day(storage, day, rules)
    runs = run_job(refresh_trends.JOB, context, JobTrigger.CLI), run_job(evaluate_alerts.JOB, context, JobTrigger.CLI)
    assert [run.outcome for run in runs] == ["succeeded", "succeeded"], runs
    return runs


def feed(storage: Storage) -> Sequence[AlertEvent]:
    with storage.read() as unit:
        return unit.alerts.feed(0, 1000)


def feed_of(storage: Storage) -> list[tuple[AlertEventKind, str]]:
    return [(event.kind, event.alert.kind) for event in feed(storage)]


def open_alert(storage: Storage, wheelset: str, kind: str) -> Alert:
    with storage.read() as unit:
        alert = next((one for one in unit.alerts.all_open(wheelset) if one.kind == kind), None)
    assert alert is not None
    return alert


@on_sqlite
def test_geometries_become_trends_and_a_repeat_changes_nothing(storage: Storage) -> None:
    register(storage, "W1", "W2")
    wear(storage, "W1", 40)
    first, _ = run_jobs(storage, 40.5)
    assert first.counts == {"wheelsets": 2, "refreshed": 2, "unchanged": 0, "without_limit": 0, "quarantined": 0}
    with storage.read() as unit:
        worn, unseen = unit.trends.latest("W1"), unit.trends.latest("W2")
    assert worn is not None
    assert unseen is not None
    assert worn.trend.limit == 0.4
    slope = worn.trend.slope_per_1000_km
    assert slope.low is not None
    assert slope.high is not None
    assert slope.low < 0.003 < slope.high
    assert unseen.trend.status is Status.UNESTIMATED
    again, _ = run_jobs(storage, 40.6)
    assert again.counts["unchanged"] == 2
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W1", 41, 41, 0.27))
    third, _ = run_jobs(storage, 41.5)
    assert (third.counts["refreshed"], third.counts["unchanged"]) == (1, 1)


@on_sqlite
def test_intervals_that_were_followed_by_empty_ones_are_as_if_they_had_never_been(storage: Storage) -> None:
    register(storage, "W1")
    wear(storage, "W1", 40)
    run_jobs(storage, 40.5)
    wrong = geometry_record("W1", 41, 41, 0.9)
    gone = replace(wrong, geometry=replace(wrong.geometry, windows=0), input_digest="none", recorded_ns=2)
    digests = []
    for record in (None, wrong, gone):
        with storage.write() as unit:
            if record is not None:
                put_geometry(unit, record)
        run_jobs(storage, 41.5)
        with storage.read() as unit:
            latest = unit.trends.latest("W1")
        assert latest is not None
        digests.append(latest.input_digest)
    assert digests[1] != digests[0] == digests[2]


def with_common_error(storage: Storage, conicity: float) -> None:
    """Store intervals of 40 days of W1, whose errors are common for the most part."""
    sources, effects = (ErrorSource.SAMPLING, ErrorSource.JUMP_PLACE), np.outer([0.004, 0.03], np.ones(3))
    with storage.write() as unit:
        for day in range(1, 41, 3):
            record = geometry_record("W1", day, day, conicity)
            geometry = geometry_of(conicity=conicity, std=0.0303)
            geometry = replace(geometry, error_sources=sources, error_effects=effects)
            put_geometry(unit, replace(record, geometry=geometry))


@on_sqlite
@pytest.mark.parametrize(
    ("day", "before", "count"),
    [
        (20, "", (1, 0)),
        (20, "mounted", None),
        (20, "sensor", None),
        (20, "turned", None),
        (20, "far off", (0, 1)),
        (60, "", None),
    ],
)
def test_a_measured_profile_moves_the_trend_of_the_same_wheels_in_the_same_place(
    storage: SqlStorage, day: int, before: str, count: tuple[int, int] | None
) -> None:
    register(storage, "W1")
    wheel = wheel_profile("P8")
    section = TrackSectionRecord("S", 1, "", "60E1", 0.05, 1.435, 2000.0)
    contact = wheel_contact(WheelPair(wheel, wheel, 0.45, 2e-4), [RailShare.of(section)])
    assert isinstance(contact, WheelContact)
    truth = contact.conicity[2].value or 0.0
    with_common_error(storage, truth + (0.2 if before == "far off" else 0.03))
    at_ns, later = START_NS + (day - 1) * DAY_NS, START_NS + 25 * DAY_NS
    with storage.write() as unit:
        unit.tracks.add_section(section)
        unit.registry.add_measured_profiles(MeasuredProfiles("W1", at_ns, 1000.0 * day, wheel, wheel, 2e-4))
        if before == "mounted":
            unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS, later, 0.0, 0.0))
            unit.registry.add_mounting(Mounting("W1", "V1", 2, later, None, 0.0, 0.0))
        if before == "sensor":
            unit.sensor_changes.add(SensorChange("V1", 1, later, SensorWork.SWAP), 4, Decision())
        if before == "turned":
            unit.registry.add_reprofiling(Reprofiling("W1", later, 25_000.0))
    run_jobs(storage, 41.0)
    with storage.read() as unit:
        latest = unit.trends.latest("W1")
    assert latest is not None
    said = latest.trend.calibration
    assert (None if said is None else (said.profiles, said.contradicting)) == count
    if count == (1, 0):
        assert said is not None
        assert -0.03 <= said.shift < -0.02
        assert said.std < 0.015
        assert latest.trend.fitted.value == pytest.approx(truth, abs=0.01)


def test_worn_wheels_raise_alerts_once(storage: Storage) -> None:
    register(storage, "W1", "W2")
    wear(storage, "W1", 100)  # 0.45 at the end, over 0.40
    wear(storage, "W2", 72)  # 0.36, 13,000 km before it
    for serial, day in (("W1", 100), ("W2", 72)):
        run_windows(storage, serial, day - 0.5, 20)
    run_jobs(storage, 73.0)
    before = feed(storage)
    assert {(e.alert.wheelset, e.alert.kind) for e in before} == {
        ("W1", "conicity_limit"),
        ("W1", "limit_forecast"),
        ("W2", "limit_forecast"),
    }
    assert {e.kind for e in before} == {RAISED}
    alert = open_alert(storage, "W1", "conicity_limit")
    assert (alert.opened_ns, alert.last_seen_ns) == (START_NS + 85 * DAY_NS, START_NS + 100 * DAY_NS)
    assert alert.raise_limit == 0.4
    assert alert.probability is not None
    assert alert.probability > 0.99
    assert alert.evidence["windows"] == 8
    _, again = run_jobs(storage, 74.0)
    assert set(again.counts.values()) == {0, 2}  # two wheelsets evaluated, nothing to report
    assert feed(storage) == before


@on_sqlite
def test_a_dead_sensor_makes_wear_unknown_and_is_reported_itself(storage: Storage) -> None:
    register(storage, "W1")
    wear(storage, "W1", 100)
    run_windows(storage, "W1", 99.5, 20)
    run_jobs(storage, 100.5)
    assert open_alert(storage, "W1", "conicity_limit").condition is Condition.ACTIVE
    run_windows(storage, "W1", 101, 20, faulty=True)
    run_jobs(storage, 101.5)
    assert open_alert(storage, "W1", "sensor_fault").condition is Condition.ACTIVE
    for day in (102.0, 109.0, 140.0):
        run_jobs(storage, day)
        alert = open_alert(storage, "W1", "conicity_limit")
        assert alert.condition is Condition.UNKNOWN
        assert alert.evidence["unknown_because"]
    assert open_alert(storage, "W1", "no_data").condition is Condition.ACTIVE
    assert not {CLEARED, CLOSED} & {kind for kind, _ in feed_of(storage)}
    run_windows(storage, "W1", 141, 20)
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W1", None, 141.1, 0.46, recorded_ns=99))
    run_jobs(storage, 141.2)
    assert open_alert(storage, "W1", "conicity_limit").condition is Condition.ACTIVE
    assert (CLEARED, "no_data") in feed_of(storage)


@on_sqlite
def test_silence_is_found_once_and_reported_once(storage: Storage) -> None:
    register(storage, "W1")
    run_windows(storage, "W1", 1, 20)
    for day in (5.0, 8.5, 9.0, 20.0):
        run_jobs(storage, day)
    assert feed_of(storage) == [(RAISED, "no_data")]
    run_jobs(storage, 40.0)
    assert feed_of(storage)[1:] == [(UPDATED, "no_data")]  # critical by now
    run_windows(storage, "W1", 41, 20)
    run_jobs(storage, 41.5)
    assert feed_of(storage)[2:] == [(CLEARED, "no_data"), (CLOSED, "no_data")]


@on_sqlite
def test_reprofiling_closes_wear_alerts_and_begins_again(storage: Storage) -> None:
    register(storage, "W1")
    wear(storage, "W1", 100)
    run_windows(storage, "W1", 99.5, 20)
    run_jobs(storage, 100.5)
    with storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W1", START_NS + 101 * DAY_NS, 101_000.0))
    run_jobs(storage, 101.5)
    closed = [event.alert for event in feed(storage) if event.kind is CLOSED]
    assert {alert.close_reason for alert in closed} == {CloseReason.REPROFILED}
    assert {alert.closed_ns for alert in closed} == {START_NS + 101 * DAY_NS}
    with storage.read() as unit:
        assert unit.alerts.all_open("W1") == []
        latest = unit.trends.latest("W1")
    assert latest is not None
    assert (latest.baseline, latest.trend.status) == (1, Status.UNESTIMATED)
    wear(storage, "W1", 5, baseline=1, first=102)
    run_windows(storage, "W1", 105.5, 20)
    run_jobs(storage, 106.5)
    with storage.read() as unit:
        assert unit.alerts.all_open("W1") == []
        latest = unit.trends.latest("W1")
    assert latest is not None
    assert len(latest.trend.value) == 2


@on_sqlite
def test_an_exchange_closes_and_the_wheelset_is_judged_again_where_it_runs(storage: Storage) -> None:
    register(storage, "W1")
    wear(storage, "W1", 100)
    run_windows(storage, "W1", 99.5, 20)
    run_jobs(storage, 100.5)
    left, back = START_NS + 101 * DAY_NS, START_NS + 103 * DAY_NS
    with storage.write() as unit:
        unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS, left, 0.0, 0.0))
    run_jobs(storage, 102.0)
    closed = [event.alert for event in feed(storage) if event.kind is CLOSED]
    assert {alert.close_reason for alert in closed} == {CloseReason.OUT_OF_SERVICE}
    with storage.write() as unit:
        unit.registry.add_mounting(Mounting("W1", "V1", 2, back, None, 101_000.0, 101_000.0))
    run_jobs(storage, 103.5)
    with storage.read() as unit:
        assert unit.alerts.all_open("W1") == []  # nothing measured since it came back
    run_windows(storage, "W1", 104, 20)
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W1", None, 104.1, 0.46, recorded_ns=99))
    run_jobs(storage, 104.5)
    assert open_alert(storage, "W1", "conicity_limit").opened_ns == START_NS + round(104.1 * DAY_NS)


@on_sqlite
def test_rules_come_from_the_settings_and_one_switched_off_closes_its_alerts(storage: Storage) -> None:
    register(storage, "W1")
    run_jobs(storage, 6.0, RuleBook().with_rules(NoDataRule(days=5.0)))
    assert feed_of(storage) == [(RAISED, "no_data")]
    run_jobs(storage, 6.5, RuleBook().with_rules(NoDataRule(enabled=False)))
    assert [e.alert.close_reason for e in feed(storage) if e.kind is CLOSED] == [CloseReason.RULE_DISABLED]
    run_jobs(storage, 90.0, RuleBook().with_rules(NoDataRule(enabled=False)))
    assert len(feed(storage)) == 2


def test_what_people_did_survives_the_next_evaluation(storage: Storage) -> None:
    register(storage, "W1")
    run_jobs(storage, 8.0)
    with storage.write() as unit:
        alert = next((one for one in unit.alerts.all_open("W1") if one.kind == "no_data"), None)
        assert alert is not None
        change = acknowledge(alert, "ann", START_NS + 8 * DAY_NS)
        unit.alerts.save(change.alert, change.events, START_NS + 8 * DAY_NS, actor="ann")
    run_jobs(storage, 9.0)
    assert open_alert(storage, "W1", "no_data").acknowledged_by == "ann"
    assert [kind for kind, _ in feed_of(storage)] == [RAISED, AlertEventKind.ACKNOWLEDGED]


@pytest.mark.parametrize("order", [("W1", "W2"), ("W2", "W1")])
def test_the_order_of_wheelsets_does_not_change_their_alerts(sqlite_storage: Storage, order: tuple[str, str]) -> None:
    register(sqlite_storage, *order)
    for serial in order:
        wear(sqlite_storage, serial, 90)
        run_windows(sqlite_storage, serial, 89.5, 20)
    run_jobs(sqlite_storage, 90.5)
    alerts = {serial: open_alert(sqlite_storage, serial, "limit_forecast") for serial in order}
    assert alerts["W1"].evidence == alerts["W2"].evidence


@on_sqlite
def test_hunting_and_a_softened_suspension_become_alerts(storage: Storage) -> None:
    register(storage, "W1", "W2")
    hunting = Hunting(1.0, 4.0, 0.006)
    run_windows(storage, "W1", 1, 4, hunting=hunting)
    with storage.write() as unit:
        unit.tracks.add_section(TrackSectionRecord("S", 1, "", "56E1", 0.05, 1.435, 5000.0))
        for day in range(8):
            span = START_NS + day * DAY_NS, START_NS + (day + 1) * DAY_NS
            ratio = 1.0 if day < 5 else 0.5
            unit.suspensions.put(SuspensionFinding("V1", "S", *span, ratio, 0.03, 0.34, "v", 1))
    run_jobs(storage, 8.0)
    assert sorted((alert.wheelset, alert.kind) for alert in opened(storage)) == [
        ("W1", "hunting"),
        ("W1", "suspension_change"),  # of its vehicle, at its first axle
        ("W2", "no_data"),
    ]
    assert open_alert(storage, "W1", "suspension_change").evidence["vehicle"] == "V1"
    before = len(feed(storage))
    run_jobs(storage, 8.0)
    assert len(feed(storage)) == before
    for day in (8.1, 8.3):
        run_windows(storage, "W1", day, 20)
        run_jobs(storage, day + 0.1)
    assert (CLEARED, "hunting") in feed_of(storage)


def opened(storage: Storage) -> Sequence[Alert]:
    with storage.read() as unit:
        return unit.alerts.all_open()
