"""Worn rails in a scenario: true for the wheels that run on them, and not on file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from bench.rails_case import TEMPLATE
from estimation.errors import ScenarioError
from ingest.simulator.axle_motion import contact_of, rails_of, section_at, truth_of, wear_at, worn_contact
from ingest.simulator.campaign import scenario_track
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario

WORN = "[section.rail_wear]\ndepth_mm = 0.6\ndepth_right_mm = 0.2\ncentre_mm = 1\nhalf_width_mm = 24\n"


def scenario_of(folder: Path, *tables: str, tonnage: float | None = None) -> Scenario:
    path = folder / "scenario.toml"
    small = (
        SMALL if tonnage is None else SMALL.replace("number = 9\n", f"number = 9\ntonnage_mgt_per_year = {tonnage}\n")
    )
    path.write_text("\n".join([small, *tables]), encoding="utf-8")
    return read_scenario(path)


def test_each_rail_loses_what_the_scenario_says(tmp_path: Path) -> None:
    new, worn = scenario_of(tmp_path), scenario_of(tmp_path, WORN)
    before, after = rails_of(new.section)[:2], rails_of(worn.section)[:2]
    lost = [
        float(b.height(np.array([1e-3]))[0] - a.height(np.array([1e-3]))[0]) for a, b in zip(before, after, strict=True)
    ]
    assert lost == pytest.approx([0.6e-3, 0.2e-3], abs=1e-8)


def test_worn_rails_change_the_true_conicity_and_not_the_registry(tmp_path: Path) -> None:
    new, worn = scenario_of(tmp_path), scenario_of(tmp_path, WORN.replace("depth_right_mm = 0.2\n", ""))
    wheel = new.vehicles[0].wheelsets[0]
    conicities = [
        truth_of(worn_contact(wheel, wear_at(wheel, 0.0), one.section, np.array([0.0]), 8e-3)).equivalent_conicity
        for one in (new, worn)
    ]
    assert np.nanmax(np.abs(conicities[1] - conicities[0])) > 0.02
    files = [prepare(one, tmp_path / str(place)) for place, one in enumerate((new, worn))]
    known = [json.loads(file.read_text())["track_sections"] for file in files]
    assert known[0] == known[1]


def test_wear_of_rails_is_checked(tmp_path: Path) -> None:
    for key, text in (("depth_mm", "depth_mm = 5"), ("half_width_mm", "depth_mm = 1\nhalf_width_mm = 0")):
        with pytest.raises(ScenarioError, match=key):
            scenario_of(tmp_path, f"[section.rail_wear]\n{text}\n")


def test_rails_wear_with_the_traffic_since_the_first_campaign(tmp_path: Path) -> None:
    growing = scenario_of(tmp_path, WORN + "growth_mm_per_100_mgt = 1.5\n", tonnage=40.0)
    odometers = [growing.odometer(campaign) for campaign in (0, 1)]  # 100 days apart
    worn = [section_at(growing, at).rail_wear for at in odometers]
    depths = [wear.depths for wear in worn if wear is not None]
    gained = 1.5e-3 * 0.4 * 100.0 / 365.25
    assert depths == [pytest.approx((0.6e-3, 0.2e-3)), pytest.approx((0.6e-3 + gained, 0.2e-3 + gained))]
    plan, track = growing.vehicles[0].wheelsets[1], scenario_track(growing)
    tables = [contact_of(growing, track, plan, at).wheelset for at in odometers]
    lost = [float(table.left_rail.height(np.array([1e-3]))[0]) for table in tables]
    assert lost[1] - lost[0] == pytest.approx(gained, rel=1e-6)


def test_traffic_is_on_file_and_the_wear_is_not(tmp_path: Path) -> None:
    growing = scenario_of(tmp_path, WORN + "growth_mm_per_100_mgt = 1.5\n", tonnage=40.0)
    (known,) = json.loads(prepare(growing, tmp_path / "out").read_text())["track_sections"]
    assert known["tonnage_mgt_per_year"] == 40.0
    assert not {key for key in known if "wear" in key}


def test_wear_that_grows_is_checked(tmp_path: Path) -> None:
    growth = WORN + "growth_mm_per_100_mgt = {}\n"
    for text, tonnage, why in ((growth.format(1.5), None, "tonnage"), (growth.format(60), 40.0, "7.2 mm deep")):
        with pytest.raises(ScenarioError, match=why) as error:
            scenario_of(tmp_path, text, tonnage=tonnage)
        assert error.value.field == "section.rail_wear.growth_mm_per_100_mgt"
    drawn = TEMPLATE.read_text().replace("gauge_surveyed = true", f"tonnage_mgt_per_year = 9\n{growth.format(1)}")
    (tmp_path / "drawn.toml").write_text(drawn)
    with pytest.raises(ScenarioError, match="drawn fleet"):
        read_scenario(tmp_path / "drawn.toml")


def test_without_the_table_rails_are_new(tmp_path: Path) -> None:
    section = scenario_of(tmp_path).section
    assert section.rail_wear is None
