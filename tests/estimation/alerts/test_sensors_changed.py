"""Where the sensors of an axle were exchanged or calibrated, what they were before says nothing of them now."""

from __future__ import annotations

from dataclasses import replace

import pytest
from wheelset_life import START_NS, window_record

from estimation.alerts.rule_book import RuleBook, superseded
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.sensor_data import SensorFaultRule
from estimation.values.alerts import Alert, CloseReason, Condition, Severity
from estimation.values.registry import Mounting, WheelsetRecord

WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, Mounting("W", "V", 1, START_NS, None, 0.0, 0.0))
FAULTY = [window_record("W", number, sensor_fault=True) for number in range(20)]
SOUND = [window_record("W", number, sensor_fault=False) for number in range(20, 25)]
FACTS = WheelsetFacts(wheelset=WHEELSET, vehicle=None, geometry=None, trend=None, windows=[*FAULTY, *SOUND])
OPENED_NS = FAULTY[5].start_ns
ALERT = Alert(
    alert_id=1,
    fleet="F",
    wheelset="W",
    kind="sensor_fault",
    severity=Severity.WARNING,
    condition=Condition.ACTIVE,
    opened_ns=OPENED_NS,
    last_seen_ns=FAULTY[-1].start_ns,
    occurrence_count=3,
    probability=1.0,
    evidence={},
    action="replace_sensor",
    raise_limit=0.5,
    clear_limit=0.1,
)


@pytest.mark.parametrize(("after_ns", "closed"), [(0, False), (1, True)])
def test_a_change_closes_the_alerts_on_the_sensor_that_were_open(after_ns: int, *, closed: bool) -> None:
    changed = replace(FACTS, sensors_changed_ns=OPENED_NS + after_ns)
    ended = [(one.kind, reason) for one, reason, _ in superseded(replace(changed, open_alerts=[ALERT]), RuleBook())]
    assert ended == [("sensor_fault", CloseReason.SENSOR_CHANGED)] * closed
    other = replace(ALERT, kind="no_data")
    assert superseded(replace(changed, open_alerts=[other]), RuleBook()) == []


@pytest.mark.parametrize(
    ("changed_ns", "breached"),
    [(None, True), (FAULTY[-3].start_ns, True), (FAULTY[-3].start_ns + 1, False), (SOUND[0].start_ns, False)],
)
def test_windows_from_before_count_for_none(changed_ns: int | None, breached: bool) -> None:  # noqa: FBT001 - pytest
    rule = SensorFaultRule(minimum_windows=3)
    windows = FAULTY if changed_ns is not None and changed_ns < SOUND[0].start_ns else [*FAULTY, *SOUND]
    found = rule.find(replace(FACTS, windows=windows, sensors_changed_ns=changed_ns), 0)
    assert found is not None
    assert bool(found.breached) is breached
