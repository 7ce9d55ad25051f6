"""The alert on windows whose mileage cannot be believed: raised by two of ten, cleared by good ones."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimation.alerts.rules.data_quality import DataQualityRule, data_quality_finding
from estimation.values.reasons import Reason, ReasonCode
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
    found = data_quality_finding(DataQualityRule(), "WS-1", records[::-1], 7)
    assert (found.breached, found.cleared) == (breached, cleared)
    reasons = {"odometer_implausible": windows[-10:].count("b")} if "b" in windows[-10:] else {}
    assert found.evidence["reasons"] == reasons
    assert found.measured_ns == (60 * len(windows) if windows else 7)


@pytest.mark.parametrize("windows", ["", "g", "gggg", "b"])
def test_one_rejected_recording_raises_at_once_whatever_the_windows_show(windows: str) -> None:
    records = [replace(GOOD if kind == "g" else BAD, start_ns=60 * at) for at, kind in enumerate(windows)]
    found = data_quality_finding(DataQualityRule(), "WS-1", records, 7, rejected={"log_damaged": 2, "other": 1})
    assert (found.breached, found.cleared, found.stands) == (True, False, True)
    assert found.evidence["rejected_recordings"] == 3
    assert found.evidence["rejected_reasons"] == {"log_damaged": 2, "other": 1}
    assert found.action == "check_recordings"


@pytest.mark.parametrize(("windows", "stands"), [("", False), ("g", False), ("gggg", False), ("b", None), ("bb", None)])
def test_an_alert_of_recordings_alone_ends_with_them(windows: str, *, stands: bool | None) -> None:
    records = [replace(GOOD if kind == "g" else BAD, start_ns=60 * at) for at, kind in enumerate(windows)]
    found = data_quality_finding(DataQualityRule(), "WS-1", records, 7, of_recordings_alone=True)
    assert found.stands is stands
    assert found.action == "check_odometer"
