"""The class that is on file of a simulated fleet: shipped, of a file, and wrong ones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scenario_text import SMALL

from estimation.errors import ScenarioError
from estimation.vehicle.vehicle_class import Arrangement
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import load_scenario, read_scenario
from ingest.vehicle_class_schema import read_vehicle_class, shipped_path

STATED = 'kind = "mems"\nscale_error_std_percent = 1.0\n'
FOUR = SMALL.replace("[2.0, 4.5, 12.0]", "[2.0, 4.5, 20.0, 22.5]") + '\n[[vehicles.wheelsets]]\nserial = "D"\n'
FOUR += "wear_mm_per_100000_km = 0.5\n"


def registry(folder: Path, table: str) -> dict[str, list[dict[str, object]]]:
    path = folder / "scenario.toml"
    path.write_text(f"{FOUR}\n[class_on_file]\n{table}\n")
    content: dict[str, list[dict[str, object]]] = json.loads(prepare(read_scenario(path), folder / "out").read_text())
    return content


def test_a_shipped_class_is_on_file_with_its_code_and_radius(tmp_path: Path) -> None:
    content = registry(tmp_path, 'shipped = "coach"\nnominal_radius_mm = 460.0')
    assert content["vehicle_classes"] == [{"file": "coach.toml"}]
    assert read_vehicle_class(tmp_path / "out" / "coach.toml").code == "coach"
    assert content["vehicles"][0]["vehicle_class"] == "coach"
    assert {wheelset["nominal_radius_mm"] for wheelset in content["wheelsets"]} == {460.0}


def test_bogies_keep_their_middles_and_have_the_wheelbase_on_file(tmp_path: Path) -> None:
    text = shipped_path("coach").read_text().replace("wheelbase_m = 2.56", "wheelbase_m = 1.8")
    (tmp_path / "short.toml").write_text(text.replace('code = "coach"', 'code = "short"'))
    content = registry(tmp_path, 'file = "short.toml"')
    assert content["vehicles"][0]["axle_offsets_m"] == [2.35, 4.15, 20.35, 22.15]
    assert {wheelset["nominal_radius_mm"] for wheelset in content["wheelsets"]} == {450.0}


def test_single_wheelsets_stay_where_they_are(tmp_path: Path) -> None:
    content = registry(tmp_path, 'shipped = "paper"')
    assert content["vehicles"][0]["axle_offsets_m"] == [2.0, 4.5, 20.0, 22.5]


def test_the_demo_has_vibrating_bogies_that_differ_from_their_class_within_its_stds() -> None:
    demo = load_scenario("demo")
    assert demo.class_on_file is not None
    on_file = demo.class_on_file.vehicle_class
    assert on_file.arrangement is Arrangement.BOGIE
    for name in ("yaw_stiffness", "longitudinal_creep_coefficient", "lateral_creep_coefficient"):
        off = getattr(demo.parameters, name) / getattr(on_file.parameters, name) - 1.0
        assert 0.02 < abs(off) < on_file.std_of(name)
    assert demo.sensors.errors.vibration is not None
    assert min(demo.sensors.errors.vibration.of_channels[:3]) >= 1.0
    assert not demo.section.surveyed
    assert demo.position is not None
    assert demo.position.offset >= 20.0


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("nominal_radius_mm = 460.0", "either 'file' or 'shipped'"),
        ('shipped = "tram"', "'tram' is none of coach"),
        ('file = "none.toml"', "none.toml"),
    ],
)
def test_what_cannot_be_on_file_is_refused(tmp_path: Path, table: str, reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        registry(tmp_path, table)


@pytest.mark.parametrize(
    ("key", "stated"), [("", 0.01), ("stated_scale_std_percent = 0.5", 0.005), ("stated_scale_std_percent = 0.0", 0.0)]
)
def test_a_class_states_the_scales_as_they_are_or_as_it_is_told(tmp_path: Path, key: str, stated: float) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SMALL.replace('kind = "mems"', f"{STATED}{key}"))
    (entry,) = json.loads(prepare(read_scenario(path), tmp_path / "out").read_text())["vehicle_classes"]
    assert {entry["sensors"][name]["scale_std"] for name in ("lateral", "yaw", "roll", "mass_lateral")} == {stated}
