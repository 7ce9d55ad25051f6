"""The alert on windows whose mileage cannot be believed: raised by two of ten, cleared by good ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from windows_finding import windows_finding

from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.sensor_data import DataQualityRule
from estimation.values.alerts import Finding
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.windows import WindowQuality, WindowRecord, WindowState

GOOD = WindowRecord(
    wheelset="WS-1", start_ns=0, length_ns=60, vehicle="V-1", axle=1, track_section="S", mileage_km=1.0,
    quality=WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 10.0, 20.0, 1.0, sensor_fault=False),
    state=WindowState.ESTIMATED, reason=None, content_digest="a" * 64, recorded_ns=1,
)  # fmt: skip
BAD = replace(GOOD, implausible=Reason(ReasonCode.ODOMETER_IMPLAUSIBLE, "it fell"))


@pytest.mark.parametrize(
    ("windows", "breached", "cleared"),
    [
        ("", None, None),
        ("gg", None, None),
        ("ggg", False, True),
        ("b", False, False),
        ("ggggggggb", False, False),
        ("ggggggggbb", True, False),
        ("bbgggggggg", True, False),
        ("bggggggggg", False, False),
        ("bbgggggggggg", False, True),  # the newest ten are good
    ],
)
def test_two_implausible_windows_of_the_newest_ten_raise_and_none_clears(
    windows: str, *, breached: bool | None, cleared: bool | None
) -> None:
    records = [replace(GOOD if kind == "g" else BAD, start_ns=60 * at) for at, kind in enumerate(windows)]
    found = windows_finding(DataQualityRule(), records[::-1], mounted_ns=7)
    assert (found.breached, found.cleared) == (breached, cleared)
    reasons = {"odometer_implausible": windows[-10:].count("b")} if "b" in windows[-10:] else {}
    assert found.evidence["reasons"] == reasons
    assert found.measured_ns == (60 * len(windows) if windows else 7)


def found_of(windows: str, rejected: Mapping[str, int]) -> Finding:
    records = [replace(GOOD if kind == "g" else BAD, start_ns=60 * at) for at, kind in enumerate(windows)]
    wheelset = WheelsetRecord("WS-1", "F", "P8", 0.45, Mounting("WS-1", "V-1", 1, 0, None, 0.0, 0.0))
    facts = WheelsetFacts(
        wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=records, rejected_recordings=rejected
    )
    found = DataQualityRule().find(facts, 0)
    assert found is not None
    return found


@pytest.mark.parametrize("windows", ["", "g", "gggg", "b"])
def test_one_rejected_recording_raises_at_once_whatever_the_windows_show(windows: str) -> None:
    found = found_of(windows, {"log_damaged": 2, "other": 1})
    assert (found.breached, found.cleared, found.stands) == (True, False, True)
    assert found.evidence["rejected_recordings"] == 3
    assert found.evidence["rejected_reasons"] == {"log_damaged": 2, "other": 1}
    assert found.action == "check_recordings"


@pytest.mark.parametrize(
    ("windows", "stands"), [("", False), ("g", False), ("gggg", False), ("b", False), ("bb", True)]
)
def test_what_stands_without_rejected_recordings_is_of_windows(windows: str, *, stands: bool) -> None:
    found = found_of(windows, {})
    assert found.stands is stands
    assert found.evidence["rejected_recordings"] == 0
    assert found.action == "check_odometer"


@pytest.mark.parametrize(
    ("codes", "action"),
    [
        ([ReasonCode.PLACE_IMPLAUSIBLE] * 2, "check_section_number"),
        ([ReasonCode.PLACE_IMPLAUSIBLE, ReasonCode.ODOMETER_IMPLAUSIBLE], "check_odometer"),
    ],
)
def test_a_place_that_is_not_believed_has_its_own_action(codes: list[ReasonCode], action: str) -> None:
    records = [replace(GOOD, start_ns=60 * at, implausible=Reason(code, "")) for at, code in enumerate(codes)]
    assert windows_finding(DataQualityRule(), records, mounted_ns=7).action == action
