"""A lateral damper that is found weak becomes an alert, and its end, on both databases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, register, run_windows

from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.running_gear import WeakDamperRule, weak_damper_finding
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.jobs import evaluate_alerts, refresh_adhesion
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import made_from
from estimation.storage import Storage, UnitOfWork
from estimation.values.alerts import Alert, Condition
from estimation.values.opinions import CREEP, GEAR_DAMPERS, GearDamper, WindowDamper, part_of_gear
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.runs import JobTrigger, Result, SubjectKind

RULE = WeakDamperRule()


def damper(share: float | None, day: float, windows: int = 9, std: float = 0.03) -> GearDamper:
    """Return the damper of V1, of which a share is left, by windows up to a day."""
    to_ns = START_NS + round(day * DAY_NS)
    found = Estimate.unknown(Reason(ReasonCode.DIVERGED, "another class"), 9.0)
    if share is not None:
        found = with_interval(share, 0.0, std, 12, float(windows))
    return GearDamper("V1", 1, found, None, None, windows, 0, 0, START_NS, to_ns, 0.0, 100.0 * day)


def put_damper(unit: UnitOfWork, found: GearDamper) -> None:
    digest = made_from(found)
    unit.results.put_all(GEAR_DAMPERS, [Result("V1", digest, "test", 1, found, part_of_gear(found.first_axle))])


def evaluated(storage: Storage, found: GearDamper | None, day: float, rule: WeakDamperRule = RULE) -> list[str]:
    """Store a damper and evaluate the rules a minute later; return the events of its alerts so far."""
    if found is not None:
        with storage.write() as unit:
            put_damper(unit, found)
    settings = JobSettings(rules=RuleBook().with_rules(NoDataRule(enabled=False), rule))
    context = JobContext(storage, SetClock(START_NS + round(day * DAY_NS) + 60 * 10**9), "test", settings)
    assert run_job(evaluate_alerts.JOB, context, JobTrigger.CLI).error is None
    with storage.read() as unit:
        return [str(event.kind) for event in unit.alerts.feed(0, 100) if event.alert.kind == RULE.kind]


def opened(storage: Storage) -> Sequence[Alert]:
    with storage.read() as unit:
        return [one for one in unit.alerts.all_open() if one.kind == RULE.kind]


def test_a_weak_damper_is_in_the_feed_after_one_run_and_ends_when_it_is_whole_again(storage: Storage) -> None:
    register(storage, "W1", "W2")
    assert evaluated(storage, damper(0.95, 1), 1) == []
    assert evaluated(storage, damper(0.2, 2), 2) == ["raised"]
    (alert,) = opened(storage)
    assert (alert.wheelset, alert.action, alert.opened_ns) == ("W1", "check_lateral_damper", START_NS + 2 * DAY_NS)
    assert alert.evidence["vehicle"] == "V1"
    assert evaluated(storage, damper(0.2, 2), 2.5) == ["raised"]
    between = evaluated(storage, damper(0.55, 3), 3)
    assert [event for event in between if event != "updated"] == ["raised"], "neither weak nor whole: it stays"
    assert "cleared" not in evaluated(storage, damper(0.95, 4), 4), "one finding is not enough"
    assert "cleared" not in evaluated(storage, damper(0.95, 4), 4.5), "the same again is none"
    assert evaluated(storage, damper(0.96, 5), 5)[-2:] == ["cleared", "closed"]
    assert opened(storage) == []
    assert evaluated(storage, damper(0.2, 6), 6)[-1] == "raised"


@on_sqlite
def test_what_windows_say_is_news_of_the_wheelset_that_the_alert_stands_at(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    register(storage, "W1")
    run_windows(storage, "W1", 2, 2)
    assert evaluated(storage, None, 2) == []
    monkeypatch.setattr(refresh_adhesion, "gear_damper", lambda *_: damper(0.2, 2))
    with storage.write() as unit:
        (*_, record) = unit.windows.list("W1")
        why = Reason(ReasonCode.DAMPER_NOT_EXCITED, "too little")
        said = WindowDamper("V1", 1, "W1", record.start_ns, 1.0, record.content_digest, "c" * 64, 0.02, reason=why)
        unit.dampers.put_all([said])
        unit.subjects.raised(SubjectKind.VEHICLE, "V1", CREEP)
    run(refresh_adhesion.OF_VEHICLES, JobContext(storage, SetClock(START_NS + 2 * DAY_NS), "test", JobSettings()))
    assert evaluated(storage, None, 2) == ["raised"]


@on_sqlite
def test_a_damper_that_is_not_known_any_more_is_not_healthy(storage: Storage) -> None:
    register(storage, "W1")
    assert evaluated(storage, damper(0.2, 2), 2) == ["raised"]
    evaluated(storage, damper(None, 3), 3)
    (alert,) = opened(storage)
    assert alert.condition is Condition.UNKNOWN
    assert alert.evidence["unknown_because_code"] == "diverged"


@on_sqlite
@pytest.mark.parametrize(
    "found",
    [
        damper(0.2, 2, windows=5),
        damper(0.47, 2),
        damper(None, 2),
        replace(damper(0.2, 2), first_axle=3),
    ],
    ids=["too few windows", "not sure", "unknown", "no wheelset at its first axle"],
)
def test_what_raises_nothing(storage: Storage, found: GearDamper) -> None:
    register(storage, "W1", "W2")
    assert evaluated(storage, found, 2) == []
    assert not opened(storage)


@on_sqlite
def test_delays_and_limits_are_the_operators(storage: Storage) -> None:
    register(storage, "W1")
    late = replace(RULE, delays=replace(RULE.delays, on_evaluations=2), raise_share=0.7, clear_share=0.8)
    assert evaluated(storage, damper(0.55, 2), 2, late) == []
    assert evaluated(storage, damper(0.55, 3), 3, late) == ["raised"]
    assert evaluated(storage, None, 4, replace(late, enabled=False))[-1] == "closed"


@on_sqlite
def test_what_was_measured_before_a_wheelset_was_mounted_raises_nothing_at_it(storage: Storage) -> None:
    register(storage, "W1")
    assert evaluated(storage, damper(0.2, 2), 2) == ["raised"]
    exchanged_ns = START_NS + 3 * DAY_NS
    with storage.write() as unit:
        unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS, exchanged_ns, 0.0, 0.0))
        unit.registry.add_mounting(Mounting("W1", "V1", 1, exchanged_ns, None, 3000.0, 3000.0))
    assert evaluated(storage, None, 3.5)[-1] == "closed"
    assert evaluated(storage, None, 4)[-1] == "closed"
    assert evaluated(storage, damper(0.2, 4), 4.5)[-1] == "raised"


@pytest.mark.parametrize("share", [0.3, 0.4, 0.44, 0.47, 0.6])
def test_the_shipped_limits_are_those_of_the_finding(share: float) -> None:
    """What REST calls weak is what raises the alert."""
    found = damper(share, 1, std=0.04)
    assert found.share.high is not None
    std = (found.share.high - share) / 1.959964
    assert weak_damper_finding(RULE, "W1", found).breached == (share + 1.281552 * std <= 0.5)
