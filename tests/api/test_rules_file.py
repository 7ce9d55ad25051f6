"""Rule files: what is left out keeps its default, what is wrong is named."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from in_process_command import Run

from api.rules_file import load_rules
from estimation.alerts.rule_book import AlarmFloodRule, RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.alerts.rules.sensor_data import NoDataRule, SensorFaultRule
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
        ("[rules]\n", "rules", "unknown key"),
        ("[[class]]\n", "class[0].class", "missing"),
        ("[[class]]\nclass = 'c'\n[class.alarm_flood]\n", "class[0].alarm_flood", "unknown key"),
        ("[[fleet]]\nfleet = 'f'\nname = 'x'\n", "fleet[0].name", "unknown key"),
        (
            "[[fleet]]\nfleet = 'f'\nclass = 'c'\n[fleet.alarm_flood]\nmore_than = 3\n",
            "fleet[0].alarm_flood",
            "whole fleet",
        ),
        ("[[class]]\nclass = 'c'\n[[class]]\nclass = 'c'\n", "class[1]", "twice"),
        (
            "[[class]]\nclass = 'c'\n[class.identity.parameters]\nreach = 1.0\n",
            "class[0].identity.parameters",
            "unknown key",
        ),
        (
            "[[fleet]]\nfleet = 'f'\n[fleet.sensor_fault]\nclear_share = 0.7\n",
            "fleet[0].sensor_fault.clear_share",
            "is above raise_share .*fleet f",
        ),
        (  # each by itself is possible, both together are not
            (
                "[[class]]\nclass = 'c'\n[class.no_data]\ncritical_days = 10\n"
                "[[fleet]]\nfleet = 'f'\n[fleet.no_data]\ndays = 11\n"
            ),
            "fleet[0].no_data.critical_days",
            "is below days",
        ),
        (
            "[hunting]\ndelays = { on_evaluations = 2, on_delay_km = 5 }\n",
            "hunting.delays.on_delay_km",
            "leave on_evaluations out",
        ),
        ("[no_data]\ndelays = { on_delay_km = 5 }\n", "no_data.delays.on_delay_km", "no mileage"),
        ("[identity]\ndelays = { off_delay_km = 5 }\n", "identity.delays.off_delay_km", "no mileage"),
        ("[hunting]\ndelays = { on_delay_km = -1 }\n", "hunting.delays.on_delay_km", "outside"),
        ("[hunting]\ndelays = { on_delay_km = 100001 }\n", "hunting.delays.on_delay_km", "outside"),
        ("[hunting]\nlatest_windows = 12\nminimum_windows = 13\n", "hunting.minimum_windows", "above"),
        ("[[conicity_limit.bands]]\nlimit = 0.02\n", "conicity_limit.bands[0].limit", "clear"),
        (
            "[[conicity_limit.bands]]\nlimit = 0.4\n[[conicity_limit.bands]]\nlimit = 0.3\n",
            "conicity_limit.bands[1]",
            "twice",
        ),
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


PAGE = Path(__file__).parents[2] / "docs" / "alert-rules.md"
SCOPED = """
name = "plan 2027-01"
[no_data]
days = 6
[hunting]
delays = { on_delay_km = 500, off_delay_km = 900 }
[[fleet]]
fleet = "north"
class = "freight"
[fleet.no_data]
days = 5
[[fleet]]
fleet = "north"
[fleet.no_data]
days = 3
[fleet.alarm_flood]
more_than = 9
[fleet.hunting]
delays = { on_evaluations = 4 }
[[class]]
class = "freight"
[class.no_data]
days = 14
critical_days = 40
"""


@pytest.mark.parametrize(
    ("fleet", "vehicle_class", "days", "critical_days"),
    [
        ("south", "coach", 6.0, 28.0),
        ("south", "freight", 14.0, 40.0),
        ("north", "coach", 3.0, 28.0),
        ("north", "freight", 5.0, 40.0),
        ("north", None, 3.0, 28.0),
    ],
)
def test_a_fleet_goes_before_a_class_and_both_before_either(
    tmp_path: Path, fleet: str, vehicle_class: str | None, days: float, critical_days: float
) -> None:
    rule = load_rules(written(tmp_path, SCOPED)).of(fleet, vehicle_class).rule(NoDataRule)
    assert (rule.days, rule.critical_days) == (days, critical_days)


def test_a_delay_takes_the_place_of_the_one_in_the_other_unit(tmp_path: Path) -> None:
    book = load_rules(written(tmp_path, SCOPED))
    everywhere, north = book.delays_of("hunting"), book.of("north", None).delays_of("hunting")
    assert (everywhere.on_delay_km, everywhere.off_delay_km) == (500.0, 900.0)
    assert (north.on_evaluations, north.on_delay_km, north.off_delay_km) == (4, 0.0, 900.0)
    assert (book.alarm_flood.more_than, book.of("north", "freight").alarm_flood.more_than) == (5, 9)


def test_the_version_names_the_rules_and_changes_with_every_setting(tmp_path: Path) -> None:
    assert RuleBook().version.split(" ")[0] == "shipped"
    book = load_rules(written(tmp_path, SCOPED))
    assert re.fullmatch("plan 2027-01 [0-9a-f]{12}", book.version)
    assert load_rules(written(tmp_path, SCOPED)).version == book.version
    others = [SCOPED.replace("days = 14", "days = 15"), SCOPED.replace("more_than = 9", "more_than = 8")]
    versions = {load_rules(written(tmp_path, text)).version for text in others}
    assert len({*versions, book.version}) == 3
    unnamed = load_rules(written(tmp_path, "[no_data]\ndays = 3\n")).version
    assert unnamed.split(" ")[0] == "unnamed"


def test_check_prints_the_rules_by_fleet_and_class_and_refuses_in_one_line(tmp_path: Path, treadwatch: Run) -> None:
    file = written(tmp_path, SCOPED)
    checked = treadwatch("rules", "check", file)
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.startswith("version: plan 2027-01 ")
    scopes = [line.split(":")[0] for line in checked.stdout.splitlines() if line.endswith("of the above but")]
    assert scopes == ["class freight", "fleet north", "fleet north, class freight"]
    refused = treadwatch("rules", "check", written(tmp_path, "[sensor_fault]\nclear_share = 0.7\n"))
    assert refused.returncode == 2
    (line,) = refused.stderr.splitlines()
    assert line.endswith("rules.toml:2, field 'sensor_fault.clear_share': 0.7 is above raise_share (0.5)")


def test_the_example_of_the_page_can_be_used(tmp_path: Path) -> None:
    example = re.search(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    book = load_rules(written(tmp_path, example[1]))
    days = [book.of(*scope).rule(NoDataRule).days for scope in (("s", "c"), ("s", "freight"), ("north", "c"))]
    assert (days, book.of("north", "freight").rule(NoDataRule).days) == ([7.0, 14.0, 3.0], 5.0)
