"""The section of a scenario: recorded tracks, surveys that are wrong, wheelsets that climb, and bad entries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from bench.wheelset_motion import wheelset_motion
from estimation.errors import ScenarioError
from ingest.registry_file import read_registry
from ingest.simulator.axle_motion import contact_of, displacement_limit, gauge_grid
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.fleet import prepare, surveyed
from ingest.simulator.irregularity import IsolatedKind
from ingest.simulator.scenario import PositionErrors, Scenario
from ingest.simulator.scenario_file import read_scenario

LONG = SMALL.replace("survey_alignment_std_mm = 0.1\nsurvey_gauge_std_mm = 0.2\n", "").replace("700.0", "1500.0")


def scenario_of(folder: Path, *tables: str, small: str = LONG) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text("\n".join([small, *tables]), encoding="utf-8")
    return read_scenario(path)


def recorded_text(begin: float = 12_000.0, wide: float = 0.0, length: float = 1500.0) -> str:
    s = np.arange(0.0, length + 0.1, 0.5)
    alignment, gauge = 3.0 * np.sin(s / 11.0) + 12.0 * np.sin(s / 200.0), wide * np.sin(s / 90.0) ** 2
    rows = [f"{begin + a:.2f},{d:.4f},{e:.4f}" for a, d, e in zip(s, alignment, gauge, strict=True)]
    return "\n".join(["s_m,alignment_mm,gauge_deviation_mm", *rows])


RECIPE = "length_m = 1500.0\nalignment_std_mm = 1.5\ngauge_std_mm = 0.5\n"


def on_recorded(folder: Path, text: str, *tables: str) -> Scenario:
    (folder / "line.csv").write_text(text)
    assert RECIPE in LONG
    return scenario_of(folder, *tables, small=LONG.replace(RECIPE, 'file = "line.csv"\n'))


def test_the_tables_of_a_track_become_its_recipe(tmp_path: Path) -> None:
    scenario = scenario_of(
        tmp_path,
        "[section.long_gauge]\nstd_mm = 2\nlongest_wavelength_m = 800",
        "[[section.defects]]\nat_m = [300, 400]\nalignment_mm = 4",
        "[[section.switches]]\nat_m = [600]",
        "[[section.joints]]\nper_km = 5",
    )
    recipe = scenario.section.recipe
    assert recipe is not None
    assert recipe.long_gauge is not None
    assert recipe.long_gauge.wavelengths == (100.0, 800.0)
    assert recipe.long_alignment is None
    assert [item.kind for item in recipe.isolated] == [IsolatedKind.DEFECT, IsolatedKind.SWITCH, IsolatedKind.JOINT]
    assert recipe.isolated[0].at == (300.0, 400.0)
    assert recipe.isolated[2].per_metre == pytest.approx(0.005)
    assert scenario_track(scenario).gauge_deviation.std() == pytest.approx(2e-3, rel=0.2)
    straight = recipe.without_irregularities()
    assert (straight.plain, recipe.plain) == (True, False)


BAD = [
    ("alignment_std_mm = 1.5", "alignment_std_mm = -1.5", "", "section.alignment_std_mm", "outside the range"),
    ("gauge_std_mm = 0.5", "gauge_kurtosis = 2.0", "", "section.gauge_kurtosis", "at least 3"),
    ("gauge_std_mm = 0.5", "alignment_kurtosis = 40", "", "section.alignment_kurtosis", "at most 15"),
    ("", "", "[section.long_gauge]\nstd_mm = -2", "section.long_gauge.std_mm", "outside the range"),
    ("", "", "[section.long_gauge]\nlowest = 2", "section.long_gauge.std_mm", "missing"),
    (
        "",
        "",
        "[section.long_gauge]\nstd_mm = 2\nlongest_wavelength_m = 2000",
        "section.long_gauge.longest_wavelength_m",
        "the section has 1500 m",
    ),
    (
        "",
        "",
        "[section.long_alignment]\nstd_mm = 2\nlongest_wavelength_m = 50",
        "section.long_alignment.longest_wavelength_m",
        "greater than 100 m",
    ),
    ("", "", "[[section.defects]]\nat_m = [9]", "section.defects[0].alignment_mm", "changes nothing"),
    ("", "", "[[section.joints]]\ngauge_mm = 1", "section.joints[0].at_m", "'per_km'"),
    ("", "", "[[section.joints]]\nat_m = [1600]", "section.joints[0].at_m", "the section has 1500 m"),
    ("", "", "[[section.joints]]\nat_m = [5]\nlength_m = 1", "section.joints[0].length_m", "8 intervals"),
    ("", "", "[[section.switches]]\nat_m = [5]\nkind = 1", "section.switches[0].kind", "unknown"),
    ("", "", '[section.survey]\nfile = "other.csv"', "section.survey.file", "other_section"),
    (
        "",
        "",
        "[section.survey]\ngauge = false\ngauge_other_section = true",
        "section.survey.gauge_other_section",
        "gauge is false",
    ),
    ("", "", "[section.survey]\nalignment_factor = nan", "section.survey.alignment_factor", "finite"),
    ("", "", "[section.survey]\nstated_gauge_std_mm = -1", "section.survey.stated_gauge_std_mm", "outside"),
    ("", "", "[position]\noffset_std_m = -1", "position.offset_std_m", "outside"),
]


@pytest.mark.parametrize(("old", "new", "table", "field", "words"), BAD)
def test_a_bad_entry_is_refused_by_file_and_key(
    tmp_path: Path, old: str, new: str, table: str, field: str, words: str
) -> None:
    with pytest.raises(ScenarioError, match=words) as refused:
        scenario_of(tmp_path, table, small=LONG.replace(old, new))
    assert refused.value.field == field
    assert refused.value.file == str(tmp_path / "scenario.toml")
    assert refused.value.line is not None


def test_a_recorded_track_counts_from_its_first_row(tmp_path: Path) -> None:
    scenario = on_recorded(tmp_path, recorded_text())
    track = scenario_track(scenario)
    assert (track.s[0], track.length) == (0.0, 1500.0)
    np.testing.assert_allclose(track.alignment[22], 1e-3 * (3.0 * np.sin(1.0) + 12.0 * np.sin(0.055)), atol=1e-6)
    (known,) = read_registry(prepare(scenario, tmp_path / "out")).alignments
    np.testing.assert_allclose(known.alignment, track.alignment, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        (recorded_text().replace("12700.50,", "12700.00,"), "s_m", "does not increase"),
        ("\n".join(recorded_text().splitlines()[:900] + recorded_text().splitlines()[910:]), "s_m", "nothing between"),
        (recorded_text().replace("gauge_dev", "dev"), "gauge_deviation_mm", "no such column"),
        (recorded_text(wide=90.0), "gauge_deviation_mm", "another unit"),
        (recorded_text(wide=0.004), "gauge_deviation_mm", "is this in metres"),
    ],
)
def test_a_recorded_track_that_cannot_be_right_is_refused(tmp_path: Path, text: str, field: str, words: str) -> None:
    scenario = on_recorded(tmp_path, text)
    with pytest.raises(ScenarioError, match=words) as refused:
        scenario_track(scenario)
    assert (refused.value.file, refused.value.field) == (str(tmp_path / "line.csv"), field)


def test_a_recipe_beside_a_recorded_track_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be given beside 'file'"):
        on_recorded(tmp_path, recorded_text(), "[[section.joints]]\nper_km = 1")


def test_the_contact_table_is_as_wide_as_the_widest_gauge_needs(tmp_path: Path) -> None:
    scenario = on_recorded(tmp_path, recorded_text(wide=14.9))
    track = scenario_track(scenario)
    assert gauge_grid(track)[-1] == pytest.approx(15e-3)
    assert displacement_limit(scenario, track) == pytest.approx(22.5e-3)
    vehicle = scenario.vehicles[0]
    motion = wheelset_motion(scenario, track, vehicle_run(scenario, track, vehicle, 0), 0)
    assert motion.gauge_deviation.max() > 12e-3
    assert motion.outside == 0


def test_a_wheelset_that_climbs_is_reported_with_its_place(tmp_path: Path) -> None:
    scenario = on_recorded(tmp_path, recorded_text(wide=-17.0))
    track = scenario_track(scenario)
    vehicle = scenario.vehicles[0]
    s1002 = replace(vehicle.wheelsets[0], wheel_profile="S1002")
    vehicle = replace(vehicle, wheelsets=(s1002, *vehicle.wheelsets[1:]))
    rough = replace(scenario, vehicles=(vehicle,))
    table = contact_of(rough, track, s1002, 0.0).table
    assert not table.exists.all()
    run = vehicle_run(rough, track, vehicle, 0)
    shaken = replace(track, alignment=4.0 * track.alignment)
    with pytest.raises(ScenarioError, match=r"A derails in campaign 1: at \d+\.\d m of the section a wheel climbs"):
        wheelset_motion(rough, shaken, run, 0, table)


def test_a_survey_may_be_shifted_scaled_turned_and_without_gauge(tmp_path: Path) -> None:
    scenario = scenario_of(
        tmp_path,
        "[section.survey]\nshift_m = 10.0\nalignment_factor = -1.2\ngauge = false\nstated_alignment_std_mm = 0.3",
    )
    track = scenario_track(scenario)
    survey = surveyed(scenario, track)
    np.testing.assert_allclose(survey.alignment[100:], -1.2 * track.alignment[60:-40], atol=1e-12)
    assert not survey.gauge_deviation.any()
    (known,) = read_registry(prepare(scenario, tmp_path / "out")).alignments
    np.testing.assert_allclose(known.alignment_std, 0.3e-3)
    np.testing.assert_allclose(known.alignment, survey.alignment, atol=1e-9)


def test_a_survey_may_be_that_of_another_section(tmp_path: Path) -> None:
    drawn = scenario_of(tmp_path, "[section.survey]\nother_section = true")
    track = scenario_track(drawn)
    other = surveyed(drawn, track)
    assert abs(np.corrcoef(other.alignment, track.alignment)[0, 1]) < 0.3
    assert other.alignment.std() == pytest.approx(track.alignment.std())
    (tmp_path / "other.csv").write_text(recorded_text(begin=50_000.0, wide=5.0))
    recorded = on_recorded(
        tmp_path, recorded_text(), '[section.survey]\nother_section = true\nfile = "other.csv"\ngauge_factor = 2.0'
    )
    wide = surveyed(recorded, scenario_track(recorded))
    assert wide.gauge_deviation.max() == pytest.approx(10e-3, rel=1e-3)


def test_the_gauge_alone_may_be_that_of_another_section(tmp_path: Path) -> None:
    drawn = scenario_of(tmp_path, "[section.survey]\ngauge_other_section = true\ngauge_factor = 1.5")
    whole = scenario_of(tmp_path, "[section.survey]\nother_section = true\ngauge_factor = 1.5")
    track = scenario_track(drawn)
    found = surveyed(drawn, track)
    np.testing.assert_array_equal(found.alignment, track.alignment)
    np.testing.assert_array_equal(found.gauge_deviation, surveyed(whole, track).gauge_deviation)
    (tmp_path / "other.csv").write_text(recorded_text(begin=50_000.0, wide=5.0))
    recorded = on_recorded(
        tmp_path, recorded_text(), '[section.survey]\ngauge_other_section = true\nfile = "other.csv"'
    )
    line = scenario_track(recorded)
    np.testing.assert_array_equal(surveyed(recorded, line).alignment, line.alignment)
    assert surveyed(recorded, line).gauge_deviation.max() == pytest.approx(5e-3, rel=1e-3)


@pytest.mark.parametrize("key", ["other_section", "gauge_other_section"])
def test_a_survey_of_another_section_that_is_too_short_or_missing_is_refused(tmp_path: Path, key: str) -> None:
    with pytest.raises(ScenarioError, match="cannot be drawn beside a recorded track"):
        on_recorded(tmp_path, recorded_text(), f"[section.survey]\n{key} = true")
    (tmp_path / "other.csv").write_text(recorded_text(length=900.0))
    short = on_recorded(tmp_path, recorded_text(), f'[section.survey]\n{key} = true\nfile = "other.csv"')
    with pytest.raises(ScenarioError, match=r"other\.csv.*has 900 m of track"):
        surveyed(short, scenario_track(short))


def test_normal_errors_of_the_position_have_their_standard_deviation(tmp_path: Path) -> None:
    scenario = scenario_of(tmp_path)
    errors = replace(scenario, position=PositionErrors(0.0, 0.0, offset_std=5.0, scale_std=1e-3))
    track, vehicle = scenario_track(errors), errors.vehicles[0]
    runs = [vehicle_run(errors, track, vehicle, campaign) for campaign in range(150)]
    offsets = [float(run.reported[0] - run.distance[0]) for run in runs]
    assert np.std(offsets) == pytest.approx(5.0, rel=0.2)
    assert np.abs(offsets).max() <= 15.0
    assert min(float(run.reported.min()) for run in runs) >= 0.0
    scales = [np.ptp(run.reported) / np.ptp(run.distance) - 1.0 for run in runs]
    assert np.std(scales) == pytest.approx(1e-3, rel=0.2)
