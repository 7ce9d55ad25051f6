"""How many windows of hunting raise and clear an alert, and that a sensor which clips for it is sound."""

from __future__ import annotations

from dataclasses import replace

import pytest
from wheelset_life import window_record
from windows_finding import windows_finding

from estimation.alerts.rules.running_gear import HuntingRule
from estimation.alerts.rules.sensor_data import SensorFaultRule, faulty
from estimation.values.alerts import Finding, Severity
from estimation.values.windows import Hunting, WindowRecord

RULE = HuntingRule()


def window(number: int, share: float = 1.0, clipped: float = 0.0) -> WindowRecord:
    record = window_record("W", number, clipped=clipped)
    return replace(record, quality=replace(record.quality, hunting=Hunting(share, 3.5, 0.006)))


def of_windows(hunting: int, calm: int, share: float = 1.0) -> Finding:
    windows = [window(n, share if n < hunting else 0.0) for n in range(hunting + calm)]
    return windows_finding(RULE, list(reversed(windows)))


@pytest.mark.parametrize(
    ("hunting", "calm", "breached", "cleared", "severity"),
    [
        (2, 18, False, False, Severity.WARNING),
        (3, 17, True, False, Severity.WARNING),
        (3, 18, False, False, Severity.WARNING),  # one of them is not among the latest 20
        (9, 11, True, False, Severity.WARNING),
        (10, 10, True, False, Severity.CRITICAL),
        (0, 2, None, None, Severity.WARNING),
        (0, 3, False, True, Severity.WARNING),
        (3, 0, True, False, Severity.WARNING),
        (1, 0, False, False, Severity.WARNING),
    ],
)
def test_windows_of_hunting_raise_and_their_absence_clears(
    hunting: int,
    calm: int,
    breached: bool | None,  # noqa: FBT001 - of the table
    cleared: bool | None,  # noqa: FBT001 - of the table
    severity: Severity,
) -> None:
    found = of_windows(hunting, calm)
    assert (found.breached, found.cleared, found.severity) == (breached, cleared, severity)


def test_a_window_hunts_from_half_of_its_time_on() -> None:
    assert of_windows(3, 0, share=0.5).breached is True
    assert of_windows(3, 0, share=0.49).breached is False
    some = replace(RULE, hunting_share=0.0)
    assert windows_finding(some, [window(n, 0.0) for n in range(3)]).breached is False


def test_the_evidence_names_the_oscillation() -> None:
    found = of_windows(4, 2)
    assert found.evidence["hunting_windows"] == 4
    assert found.evidence["frequency_hz"] == 3.5
    assert found.evidence["wavelength_m"] == 5.0  # at 15 to 20 m/s
    assert (found.evidence["amplitude_mm"], found.evidence["speed_max_km_h"]) == (6.0, 72.0)
    assert of_windows(0, 3).evidence["frequency_hz"] is None
    assert windows_finding(RULE, []).measured_ns == 5


def test_a_sensor_that_clips_because_its_wheelset_hunts_is_sound() -> None:
    rule = SensorFaultRule()
    assert faulty(rule, window(0, 0.0, clipped=0.3)) == "clipping"
    assert faulty(rule, window(0, 0.5, clipped=0.3)) == ""
    assert faulty(rule, window(0, 0.49, clipped=0.3)) == "clipping"
