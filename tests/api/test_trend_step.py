"""A trend that begins behind a sudden change says where that is, and how large."""

from __future__ import annotations

from dataclasses import replace

from alert_evidence_cases import AT, ESTIMATE, STEP, TREND, UNEXPLAINED

from api.schemas.trend import trend
from api.times import to_rfc3339
from estimation.values.trend import LevelCalibration, TrendPoint, TrendRecord


def test_a_step_is_served_with_its_place_size_and_probability() -> None:
    record = TrendRecord("W", 0, replace(TREND, step=STEP), "d", "v", AT)
    found = trend(record, None, None).model_dump(mode="json")["step"]
    assert found == {
        "before_km": 41_000.0,
        "after_km": 42_000.0,
        "before_at": to_rfc3339(AT - 10**9),
        "after_at": to_rfc3339(AT),
        "size_1": {
            **ESTIMATE,
            **UNEXPLAINED,
            "value": -0.2,
            "std": 0.01,
            "interval_95": [-0.22, -0.18],
            "n_windows": 4.0,
        },
        "level_before_1": 0.3,
        "amplitude_mm": 2.5,
        "probability_1": 0.99,
        "intervals_before": 30,
        "intervals_behind": 4,
    }


def test_a_trend_that_begins_with_its_profile_has_none() -> None:
    assert trend(TrendRecord("W", 0, TREND, "d", "v", AT), None, None).step is None


def test_what_measured_profiles_say_of_its_level_is_served() -> None:
    said = LevelCalibration(2, 1, -0.02, 0.006, (TrendPoint(1.0, AT, 0.3, 0.006),))
    record = TrendRecord("W", 0, replace(TREND, calibration=said), "d", "v", AT)
    shown = trend(record, None, None).model_dump(mode="json")
    assert shown["calibration"] == {"profiles": 2, "contradicting": 1, "shift_1": -0.02, "std_1": 0.006}
    assert "calibration" not in shown["points"]
    assert trend(replace(record, trend=TREND), None, None).calibration is None
