"""An alert on the latest windows stands by all windows in vehicle time: how often it was evaluated does not matter."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace

import pytest
from wheelset_life import START_NS, window_record
from windows_finding import windows_finding

from estimation.alerts.life_cycle import transition
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts
from estimation.alerts.rules.sensor_data import SensorFaultRule, faulty
from estimation.values.alerts import Alert, Finding
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.windows import WindowRecord

RULE = SensorFaultRule()
WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, Mounting("W", "V", 1, START_NS, None, 0.0, 0.0))


def found(windows: Sequence[WindowRecord]) -> Finding:
    return windows_finding(RULE, windows, mounted_ns=START_NS)


def evaluated_now(windows: Sequence[WindowRecord], delays: AlertDelays | None = None) -> Finding:
    facts = WheelsetFacts(wheelset=WHEELSET, vehicle=None, geometry=None, trend=None, windows=windows)
    finding = replace(RULE, delays=delays or RULE.delays).find(facts, 0)
    assert finding is not None
    return finding


def standing(windows: Sequence[WindowRecord], delays: AlertDelays | None = None) -> bool:
    finding = evaluated_now(windows, delays)
    assert finding.stands is (finding.since_ns is not None)
    return finding.stands


def evaluated(alert: Alert | None, windows: Sequence[WindowRecord]) -> Alert | None:
    finding = evaluated_now(windows)
    change = transition(alert, finding, 0, fleet="F", delays=RULE.delays)
    after = alert if change is None else change.alert
    return None if after is None or after.closed_ns is not None else after


@pytest.mark.parametrize("last_faulty", [20, 14, 11, 8, 5, 0])
@pytest.mark.parametrize("seed", range(4))
def test_the_alert_is_open_or_not_whatever_was_evaluated_in_between(seed: int, last_faulty: int) -> None:
    windows = [window_record("W", number, sensor_fault=10 <= number < 30 + last_faulty) for number in range(50)]
    assert any(faulty(RULE, window) for window in windows)
    once = evaluated(None, windows)
    order = list(windows)
    random.Random(seed).shuffle(order)  # noqa: S311 - an order
    alert: Alert | None = None
    for count in (7, 15, 31, 40, 50):
        alert = evaluated(alert, sorted(order[:count], key=lambda window: window.start_ns))
    assert (alert is None) == (once is None)
    if alert is not None and once is not None:
        assert once.opened_ns == evaluated_now(windows).since_ns < windows[-1].start_ns
        assert (alert.condition, alert.severity, alert.probability) == (once.condition, once.severity, once.probability)


def test_between_the_limits_it_stands_once_it_was_raised() -> None:
    broken = [window_record("W", number, sensor_fault=number < 20) for number in range(31)]  # 9 of the last 20
    sound_before = [window_record("W", number, sensor_fault=11 <= number < 20) for number in range(31)]
    assert found(broken[-20:]).breached is found(sound_before[-20:]).breached is False
    assert standing(broken)
    assert not standing(sound_before)


def test_delays_count_windows_and_what_is_long_past_counts_no_more() -> None:
    windows = [window_record("W", number, sensor_fault=number >= 30) for number in range(50)]
    first = next(end for end in range(30, 50) if standing(windows[:end]))
    assert not standing(windows[:first], AlertDelays(on_evaluations=2))
    assert standing(windows[: first + 1], AlertDelays(on_evaluations=2))
    sound = FINDINGS.look_back_factor * RULE.latest_windows
    assert not standing([window_record("W", number, sensor_fault=number < 30) for number in range(30 + sound)])
