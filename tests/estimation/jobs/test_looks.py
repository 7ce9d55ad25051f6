"""Trends and alerts of a wheelset are looked at where something has changed or time has come, and only there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import pytest
from executed_statements import executed_statements
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, geometry_record, register, run_windows, wear

from bench.put_values import put_geometry
from estimation.alerts.life_cycle import acknowledge
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.jobs import evaluate_alerts, refresh_trends
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage, UnitOfWork
from estimation.trend.trend import TrendParameters
from estimation.values.registry import Reprofiling
from estimation.values.runs import JobTrigger

WHEELSETS = ("W1", "W2", "W3")
DAY = 100.5


@dataclass
class Seen:
    """Which wheelsets a run evaluated, and which statements it needed."""

    serials: list[str] = field(default_factory=list)
    statements: list[str] = field(default_factory=list)


@contextmanager
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Seen]:
    seen, facts_of, identity_changes = Seen(), evaluate_alerts.facts_of, refresh_trends.identity_changes

    def facts(unit: UnitOfWork, serials: Sequence[str], settings: JobSettings) -> object:
        seen.serials.extend(serials)
        return facts_of(unit, serials, settings)

    def changes(unit: UnitOfWork, serials: Sequence[str]) -> object:
        seen.serials.extend(serials)
        return identity_changes(unit, serials)

    monkeypatch.setattr(evaluate_alerts, "facts_of", facts)
    monkeypatch.setattr(refresh_trends, "identity_changes", changes)
    try:
        with executed_statements() as seen.statements:
            yield seen
    finally:
        monkeypatch.undo()


def run(storage: Storage, job: Job, day: float = DAY, settings: JobSettings | None = None) -> None:
    clock = SetClock(START_NS + round(day * DAY_NS))
    done = run_job(job, JobContext(storage, clock, "test", settings or JobSettings()), JobTrigger.CLI)
    assert done.outcome == "succeeded", done.error


def at_rest(storage: Storage, wheelsets: tuple[str, ...] = WHEELSETS) -> None:
    register(storage, *wheelsets)
    for number, serial in enumerate(wheelsets):
        wear(storage, serial, 100, rate=0.003 - 0.001 * (number % 3))
        run_windows(storage, serial, 99.5, 20)
    for _ in range(3):
        run(storage, refresh_trends.JOB)
        run(storage, evaluate_alerts.JOB)


@pytest.mark.parametrize("job", [refresh_trends.JOB, evaluate_alerts.JOB], ids=lambda job: job.name)
@pytest.mark.parametrize("count", [2, 4])
@on_sqlite
def test_where_nothing_has_changed_no_wheelset_is_read(
    storage: Storage, monkeypatch: pytest.MonkeyPatch, job: Job, count: int
) -> None:
    at_rest(storage, tuple(f"W{number}" for number in range(1, count + 1)))
    with watched(monkeypatch) as seen:
        run(storage, job)
    assert seen.serials == []
    assert len(seen.statements) <= {"refresh_trends": 15, "evaluate_alerts": 26}[job.name]  # of all wheelsets together


def a_geometry(storage: Storage) -> None:
    with storage.write() as unit:
        put_geometry(unit, geometry_record("W2", 101, 101, 0.27, recorded_ns=2))


def a_geometry_again(storage: Storage) -> None:
    with storage.write() as unit:
        put_geometry(unit, replace(geometry_record("W2", 97, 97, 0.28), input_digest="another", recorded_ns=2))


def a_window(storage: Storage) -> None:
    run_windows(storage, "W2", 100.2, 3, faulty=True)


def a_reprofiling(storage: Storage) -> None:
    with storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W2", START_NS + 100 * DAY_NS, 100_000.0))


def an_action(storage: Storage) -> None:
    with storage.write() as unit:
        alert = unit.alerts.all_open("W1")[0]
        change = acknowledge(alert, "someone", START_NS + round(DAY * DAY_NS))
        unit.alerts.save(change.alert, change.events, START_NS + round(DAY * DAY_NS))


CURVES = [(a_geometry, ["W2"]), (a_geometry_again, ["W2"]), (a_reprofiling, ["W2"])]
OF_ALERTS = [*CURVES, (a_window, ["W2"]), (an_action, ["W1"])]


@pytest.mark.parametrize(
    ("job", "change", "expected"),
    [
        *((refresh_trends.JOB, *one) for one in CURVES),
        *((evaluate_alerts.JOB, *one) for one in OF_ALERTS),
    ],
)
@on_sqlite
def test_what_has_changed_of_a_wheelset_is_noticed(
    storage: Storage,
    monkeypatch: pytest.MonkeyPatch,
    job: Job,
    change: Callable[[Storage], None],
    expected: list[str],
) -> None:
    at_rest(storage)
    change(storage)
    with watched(monkeypatch) as seen:
        run(storage, job)
    assert seen.serials == expected
    run(storage, job)
    with watched(monkeypatch) as seen:
        run(storage, job)
    assert seen.serials == []


@pytest.mark.parametrize("job", [refresh_trends.JOB, evaluate_alerts.JOB], ids=lambda job: job.name)
@on_sqlite
def test_other_settings_concern_all_wheelsets(storage: Storage, monkeypatch: pytest.MonkeyPatch, job: Job) -> None:
    at_rest(storage)
    for settings in (
        JobSettings(trend=replace(TrendParameters(), horizon_km=99_000.0)),
        JobSettings(rules=RuleBook().with_rules(ConicityLimitRule(bands=(SpeedBand(0.3),)))),
    ):
        with watched(monkeypatch) as seen:
            run(storage, job, settings=settings)
        assert sorted(seen.serials) == sorted(WHEELSETS)


@on_sqlite
def test_time_alone_is_noticed_where_it_counts(storage: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    at_rest(storage)
    with watched(monkeypatch) as seen:
        run(storage, evaluate_alerts.JOB, 101.0)  # nothing is silent for as long as it may be
    assert seen.serials == []
    with watched(monkeypatch) as seen:
        run(storage, evaluate_alerts.JOB, 140.0)
    assert sorted(seen.serials) == sorted(WHEELSETS)
    with storage.read() as unit:
        assert {alert.wheelset for alert in unit.alerts.all_open() if alert.kind == "no_data"} == set(WHEELSETS)
