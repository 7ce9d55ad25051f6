"""Worn rails in a scenario: true for the wheels that run on them, and not on file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.errors import ScenarioError
from ingest.simulator.fleet import prepare
from ingest.simulator.profile_files import rails_of
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario
from ingest.simulator.wear import truth_of, wear_at, worn_contact

WORN = "[section.rail_wear]\ndepth_mm = 0.6\ndepth_right_mm = 0.2\ncentre_mm = 1\nhalf_width_mm = 24\n"


def scenario_of(folder: Path, *tables: str) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text("\n".join([SMALL, *tables]), encoding="utf-8")
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


def test_without_the_table_rails_are_new(tmp_path: Path) -> None:
    section = scenario_of(tmp_path).section
    assert section.rail_wear == (None, None)
