"""Rule files: what is left out keeps its default, what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from api.rules_file import load_rules
from estimation.alerts.rules.book import AlarmFloodRule, RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.alerts.rules.no_data import NoDataRule
from estimation.alerts.rules.sensor_fault import SensorFaultRule
from estimation.errors import InputError


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "rules.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_an_empty_file_is_the_shipped_rules(tmp_path: Path) -> None:
    assert load_rules(written(tmp_path, "")) == RuleBook()


def test_what_is_written_counts_and_the_rest_stays(tmp_path: Path) -> None:
    book = load_rules(
        written(
            tmp_path,
            """
            [conicity_limit]
            raise_probability = 0.8
            delays = { on_evaluations = 3 }
            [[conicity_limit.bands]]
            vehicle_class = "freight"
            up_to_km_h = 100
            limit = 0.45
            [[conicity_limit.bands]]
            limit = 0.6
            per_km_h = -0.001
            [no_data]
            enabled = false
            days = 3
            [alarm_flood]
            more_than = 12
            """,
        )
    )
    conicity, shipped = book.rule(ConicityLimitRule), ConicityLimitRule()
    assert conicity.raise_probability == 0.8
    assert conicity.clear_margin == shipped.clear_margin
    assert conicity.delays.on_evaluations == 3
    assert conicity.delays.off_evaluations == shipped.delays.off_evaluations
    assert conicity.bands == (
        SpeedBand(0.45, 100.0, 0.0, "freight"),
        SpeedBand(0.6, per_km_h=-0.001),
    )
    assert (book.rule(NoDataRule).enabled, book.rule(NoDataRule).days) == (False, 3.0)
    assert book.rule(SensorFaultRule) == SensorFaultRule()
    assert book.alarm_flood == AlarmFloodRule(more_than=12, within_hours=24.0)


@pytest.mark.parametrize(
    ("text", "field", "reason"),
    [
        ("[conicity]\n", "conicity", "unknown key"),
        ("conicity_limit = 3\n", "conicity_limit", "table"),
        ("[no_data]\ndayz = 3\n", "no_data.dayz", "unknown key"),
        ("[no_data]\ndays = '3'\n", "no_data.days", "number"),
        ("[no_data]\ndays = true\n", "no_data.days", "number"),
        ("[no_data]\ndays = -1\n", "no_data.days", "outside"),
        ("[no_data]\ndays = nan\n", "no_data.days", "finite"),
        ("[no_data]\nenabled = 1\n", "no_data.enabled", "true nor false"),
        ("[no_data]\ndays = 90\n", "no_data.critical_days", "below"),
        ("[sensor_fault]\nlatest_windows = 2.5\n", "sensor_fault.latest_windows", "whole"),
        ("[sensor_fault]\nlatest_windows = inf\n", "sensor_fault.latest_windows", "outside|whole"),
        ("[sensor_fault]\nclear_share = 0.7\n", "sensor_fault.clear_share", "above"),
        ("[alarm_flood]\nmore_than = 0\n", "alarm_flood.more_than", "outside"),
        ("[alarm_flood]\nmore_than = 2.5\n", "alarm_flood.more_than", "whole"),
        ("[alarm_flood]\nwithin_hours = 0\n", "alarm_flood.within_hours", "outside"),
        ("[alarm_flood]\nwithin_hours = '1'\n", "alarm_flood.within_hours", "number"),
        ("[alarm_flood]\ndelays = {}\n", "alarm_flood.delays", "unknown key"),
        ("[conicity_limit]\nraise_probability = 0.2\n", "conicity_limit.raise_probability", "outside"),
        ("[conicity_limit]\ndelays = { off = 1 }\n", "conicity_limit.delays.off", "unknown key"),
        ("[conicity_limit]\nbands = []\n", "conicity_limit.bands", "at least 1 entries"),
        ("[[conicity_limit.bands]]\nup_to_km_h = 3\n", "conicity_limit.bands[0].limit", "is missing"),
        ("[[conicity_limit.bands]]\nlimit = 30\n", "conicity_limit.bands[0].limit", "outside"),
        (
            "[[conicity_limit.bands]]\nlimit = 0.3\nvehicle_class = 3\n",
            "conicity_limit.bands[0].vehicle_class",
            "not a text",
        ),
    ],
)
def test_what_is_wrong_is_named_with_file_and_field(tmp_path: Path, text: str, field: str, reason: str) -> None:
    file = written(tmp_path, text)
    with pytest.raises(InputError, match=reason) as caught:
        load_rules(file)
    assert caught.value.file == str(file)
    assert caught.value.field == field
    assert caught.value.line is not None


def test_a_file_that_is_missing_or_no_toml_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_rules(tmp_path / "none.toml")
    with pytest.raises(InputError, match="no TOML"):
        load_rules(written(tmp_path, "[no_data\n"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="no text file"):
        load_rules(tmp_path / "bytes.toml")
