"""What rules on windows, and on their absence, find of a wheelset that was mounted at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimation.alerts.rules.rule import AlertRule, WheelsetFacts
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.values.alerts import Finding
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.windows import WindowQuality, WindowRecord, WindowState

WINDOW = WindowRecord(
    wheelset="W", start_ns=0, length_ns=60, vehicle="V1", axle=1, track_section="S", mileage_km=1.0,
    quality=WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 10.0, 20.0, 1.0, sensor_fault=False),
    state=WindowState.ESTIMATED, reason=None, content_digest="a" * 64, recorded_ns=1,
)  # fmt: skip


def windows_finding(
    rule: AlertRule, windows: Sequence[WindowRecord] = (), *, mounted_ns: int = 5, reversed_: bool = False
) -> Finding:
    """Return the finding, wheels of 0.45 m radius; ``reversed_`` where the left wheel runs on the right-hand side."""
    mounting = Mounting("W", "V1", 1, mounted_ns, None, 0.0, 0.0, reversed=reversed_)
    wheelset = WheelsetRecord("W", "F", "P8", 0.45, mounting)
    facts = WheelsetFacts(wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=windows)
    found = rule.find(facts, 0)
    assert found is not None
    return found


def silence_finding(rule: NoDataRule, last_usable_ns: int | None, mounted_ns: int, now_ns: int) -> Finding:
    """Return the finding on a wheelset whose last usable window ended at a time; None where there is none."""
    mounting = Mounting("W", "V1", 1, mounted_ns, None, 0.0, 0.0)
    wheelset = WheelsetRecord("W", "F", "P8", 0.45, mounting)
    ends = [] if last_usable_ns is None else [last_usable_ns]
    windows = [replace(WINDOW, start_ns=end - WINDOW.length_ns) for end in ends]
    found = rule.find(
        WheelsetFacts(wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=windows), now_ns
    )
    assert found is not None
    return found
