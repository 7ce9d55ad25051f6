"""Rules replayed over what is stored: the rules in force give the alerts that are on file, others give theirs."""

from __future__ import annotations

from dataclasses import replace

import pytest
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, geometry_record, register, run_windows

from bench.put_values import put_geometry
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.alerts.rules.rule import AlertDelays
from estimation.alerts.rules.sensor_data import NoDataRule, SensorFaultRule
from estimation.jobs import evaluate_alerts, refresh_trends
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.rules_replay import Change, Difference, differences, history_of, replayed
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.alerts import Alert, Severity
from estimation.values.registry import Reprofiling
from estimation.values.runs import JobTrigger

REPROFILED_DAY, SILENT_FROM, SILENT_TO, FAULTY_FROM, LAST_DAY = 44, 56, 72, 80, 88
SPAN = (START_NS, START_NS + round((LAST_DAY + 0.5) * DAY_NS))
Shown = tuple[str, int, int | None]


def live(storage: Storage) -> None:
    """Let a wheelset wear to its limit, be turned, fall silent, and get a faulty sensor; the jobs run every 4 days."""
    register(storage, "W1", "W2")
    for day in range(4, LAST_DAY + 1, 4):
        if day == REPROFILED_DAY:
            with storage.write() as unit:
                at_ns = START_NS + round((day - 1) * DAY_NS)
                unit.registry.add_reprofiling(Reprofiling("W1", at_ns, 1000.0 * (day - 1), "turned"))
        if not SILENT_FROM <= day < SILENT_TO:
            _came_in(storage, day)
        context = JobContext(storage, SetClock(START_NS + round((day + 0.5) * DAY_NS)), "test", JobSettings())
        for job in (refresh_trends.JOB, evaluate_alerts.JOB):
            assert run_job(job, context, JobTrigger.CLI).error is None


def _came_in(storage: Storage, day: int) -> None:
    baseline = int(day >= REPROFILED_DAY)
    conicity = 0.15 if baseline else 0.25 + 0.0065 * day
    for serial in ("W1", "W2"):
        run_windows(storage, serial, day - 0.05, 20, faulty=serial == "W1" and day >= FAULTY_FROM)
    if day >= FAULTY_FROM:
        return
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W1", day, day, conicity, baseline=baseline))
        put_geometry(unit, geometry_record("W1", None, day, conicity, baseline=baseline, recorded_ns=day))


def on_file(storage: Storage, serial: str) -> list[Alert]:
    with storage.read() as unit:
        return list(history_of(unit, serial).raised)


def tried(storage: Storage, serial: str, book: RuleBook, span: tuple[int, int] = SPAN) -> list[Alert]:
    with storage.read() as unit:
        return replayed(history_of(unit, serial), book, span)


def shown(alerts: list[Alert]) -> list[Shown]:
    """Return kinds, times of opening, and days of closing: a job sees the first data that clear some windows later."""
    return [(one.kind, one.opened_ns, _day(one.closed_ns)) for one in sorted(alerts, key=lambda one: one.opened_ns)]


def _day(t_ns: int | None) -> int | None:
    return None if t_ns is None else round((t_ns - START_NS) / DAY_NS)


@pytest.fixture
def lived(storage: Storage) -> Storage:
    live(storage)
    return storage


@pytest.mark.slow
@on_sqlite
def test_a_replay_of_other_rules_shows_more_fewer_earlier_and_later_and_writes_nothing(lived: Storage) -> None:
    stored = on_file(lived, "W1")
    kinds = {one.kind for one in stored}
    assert kinds == {"conicity_limit", "measure", "limit_forecast", "no_data", "sensor_fault"}
    in_force = tried(lived, "W1", RuleBook())
    assert shown(in_force) == shown(stored)  # the rules in force give what is on file
    assert {one.change for one in differences(stored, in_force)} <= {Change.SAME, Change.SHORTER}
    assert shown(tried(lived, "W2", RuleBook())) == shown(on_file(lived, "W2"))

    def changes(book: RuleBook, kind: str) -> list[Change]:
        found = differences(in_force, tried(lived, "W1", book))
        return [one.change for one in found if kind == (one.after or one.before or stored[0]).kind]

    bands = (SpeedBand(0.35),)
    assert changes(RuleBook().with_rules(ConicityLimitRule(bands=bands)), "conicity_limit") == [Change.EARLIER]
    # the trend is held against the limit of the rules that are tried
    higher = RuleBook().with_rules(ConicityLimitRule(bands=(SpeedBand(0.6),)))
    assert changes(higher, "limit_forecast") == [Change.LATER]
    assert changes(higher, "conicity_limit") == [Change.FEWER]
    late = ConicityLimitRule(delays=AlertDelays(on_delay_km=6_000.0))
    assert changes(RuleBook().with_rules(late), "conicity_limit") == [Change.LATER]
    assert changes(RuleBook().with_rules(NoDataRule(days=20.0)), "no_data") == [Change.FEWER] * 2
    assert changes(RuleBook().with_rules(NoDataRule(days=3.0)), "no_data").count(Change.MORE) > 5  # every four days
    assert changes(RuleBook().with_rules(SensorFaultRule(enabled=False)), "sensor_fault") == [Change.FEWER]
    own = RuleBook().with_rules(NoDataRule(days=20.0))
    assert changes(replace(RuleBook(), scoped={("F", None): own}), "no_data") == [Change.FEWER] * 2
    assert on_file(lived, "W1") == stored
    after = (START_NS + 50 * DAY_NS, SPAN[1])
    later = [one for one in shown(stored) if one[2] is None or one[2] >= 50]
    assert shown(tried(lived, "W1", RuleBook(), after)) == later


def alert(opened: int, closed: int | None, kind: str = "a", severity: Severity = Severity.WARNING) -> Alert:
    base = Alert(0, "F", "W", kind, severity, None, opened, opened, 1, None, {}, "", None, None)  # type: ignore[arg-type]  # not compared
    return replace(base, closed_ns=closed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        (alert(1, 5), alert(1, 5), Change.SAME),
        (alert(2, 5), alert(1, 5), Change.EARLIER),
        (alert(2, 5), alert(5, None), Change.LATER),  # open at one time
        (alert(2, 5), alert(2, 4), Change.SHORTER),
        (alert(2, 5), alert(2, None), Change.LONGER),
        (alert(2, 5), alert(2, 5, severity=Severity.CRITICAL), Change.SEVERITY),
    ],
)
def test_two_alerts_that_were_open_at_one_time_are_one(before: Alert, after: Alert, change: Change) -> None:
    assert differences([before], [after]) == [Difference(change, before, after)]


@pytest.mark.slow
def test_alerts_apart_are_one_fewer_and_one_more() -> None:
    for other in (alert(6, 7), alert(1, 5, "b")):
        found = differences([alert(1, 5)], [other])
        assert {one.change for one in found} == {Change.FEWER, Change.MORE}
