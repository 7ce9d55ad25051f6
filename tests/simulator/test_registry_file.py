"""The registry file into a real store, twice, and files that must be refused whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.arrays import same_values
from estimation.errors import InputError
from estimation.types import Status
from fleet_db.storage import SqlStorage
from ingest.registry_file import load_registry, read_registry
from ingest.simulator.campaign import scenario_track
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario

Content = dict[str, Any]


@pytest.fixture
def registry(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(SMALL)
    return prepare(read_scenario(tmp_path / "small.toml"), tmp_path / "out")


def load(storage: SqlStorage, path: Path) -> None:
    with storage.write() as unit:
        load_registry(path, unit)


def test_a_simulated_registry_lands_in_the_store(storage: SqlStorage, registry: Path) -> None:
    load(storage, registry)
    scenario = read_scenario(registry.parent.parent / "small.toml")
    truth = scenario_track(scenario)
    with storage.read() as unit:
        vehicle = unit.registry.vehicle("V-1")
        assert (vehicle.axles, vehicle.axle_offsets_m) == (3, (2.0, 4.5, 12.0))
        assert vehicle.max_speed_m_s == pytest.approx(100.0 / 3.6)
        wheelset = unit.registry.wheelset("A")
        assert wheelset.nominal_radius_m == pytest.approx(0.45)
        assert wheelset.mounting is not None
        assert (wheelset.mounting.vehicle, wheelset.mounting.axle) == ("V-1", 1)
        assert [item.mileage_km for item in wheelset.reprofilings] == [30_000.0]
        second = unit.registry.mounting_at("V-1", 2, scenario.sessions.start_ns)
        assert second is not None
        assert (second.wheelset, second.wheelset_mileage_km - second.vehicle_odometer_km) == ("B", 80_000.0)
        alignment = unit.tracks.alignment("S-9")
        assert unit.tracks.section("S-9").number == 9
    assert alignment is not None
    assert alignment.status is Status.ESTIMATED
    error = alignment.alignment - truth.alignment
    assert error.std() == pytest.approx(0.1e-3, rel=0.2)  # what the survey is said to be wrong by
    np.testing.assert_allclose(alignment.alignment_std, 0.1e-3)
    np.testing.assert_allclose(alignment.s, truth.s, atol=1e-3)


def test_the_same_file_again_changes_nothing(sqlite_storage: SqlStorage, registry: Path) -> None:
    load(sqlite_storage, registry)
    with sqlite_storage.read() as unit:
        before = (unit.registry.wheelsets(), unit.registry.vehicles(), unit.tracks.alignment("S-9"))
    load(sqlite_storage, registry)
    with sqlite_storage.read() as unit:
        after = (unit.registry.wheelsets(), unit.registry.vehicles(), unit.tracks.alignment("S-9"))
    assert before[:2] == after[:2]
    assert same_values(before[2], after[2])


def change(path: Path, edit: Callable[[Content], object]) -> None:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


BAD: list[tuple[Callable[[Content], object], str, str]] = [
    (lambda c: c.update(format="other"), "format", "treadwatch-registry-1"),
    (lambda c: c.update(colour="red"), "colour", "unknown"),
    (lambda c: c["fleets"][0].pop("name"), "fleets[0].name", "missing"),
    (lambda c: c["vehicles"][0].update(axles=9), "vehicles[0].axles", "within 1 to 8"),
    (lambda c: c["vehicles"][0].update(axles=2), "vehicles[0].axle_offsets_m", "3 offsets for 2 axles"),
    (lambda c: c["vehicles"][0].update(max_speed_km_h="fast"), "vehicles[0].max_speed_km_h", "number"),
    (lambda c: c["vehicles"][0].update(axle_offsets_m=[1, None, 2]), "vehicles[0].axle_offsets_m", "numbers"),
    (lambda c: c["wheelsets"][2].update(serial=""), "wheelsets[2].serial", "text"),
    (lambda c: c["wheelsets"][2].update(nominal_radius_mm=0.45), "wheelsets[2].nominal_radius_mm", "within"),
    (lambda c: c["mountings"][0].update({"from": "2024-01-08"}), "mountings[0].from", "offset"),
    (lambda c: c["mountings"][0].update({"to": "2020-01-01T00:00:00Z"}), "mountings[0].to", "later"),
    (lambda c: c["mountings"][1].update(reversed="no"), "mountings[1].reversed", "true nor false"),
    (lambda c: c["mountings"][1].update(wheelset="Z"), "mountings[1]", "Z"),
    (lambda c: c["reprofilings"][0].update(wheelset="Z"), "reprofilings[0]", "Z"),
    (lambda c: c["wheelsets"][0].update(fleet="Z"), "wheelsets[0]", "Z"),
    (lambda c: c["track_sections"][0].update(number=0), "track_sections[0].number", "within"),
    (lambda c: c["track_sections"][0].update(alignment=3), "track_sections[0].alignment", "object"),
    (lambda c: c.update(vehicles={}), "vehicles", "list"),
    (lambda c: c.update(vehicles=[1]), "vehicles[0]", "object"),
]


@pytest.mark.parametrize(("edit", "field", "words"), BAD)
def test_a_bad_field_is_named_and_nothing_is_stored(
    sqlite_storage: SqlStorage, registry: Path, edit: Callable[[Content], object], field: str, words: str
) -> None:
    change(registry, edit)
    with pytest.raises(InputError) as refused:
        load(sqlite_storage, registry)
    assert (refused.value.file, refused.value.field) == (str(registry), field)
    assert words in str(refused.value)
    with sqlite_storage.read() as unit:
        assert not unit.registry.fleets()
        assert not unit.registry.wheelsets()
        assert not unit.tracks.sections()


@pytest.mark.parametrize(("content", "words"), [("{", "no JSON"), ("[]", "one object"), ("{}", "missing")])
def test_a_file_that_is_no_registry_is_refused(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "registry.json"
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        read_registry(path)


def test_a_broken_track_file_is_named_by_line(registry: Path) -> None:
    track = registry.parent / "s-9.csv"
    lines = track.read_text().splitlines()
    lines[41] = lines[41].replace(",", ",x", 1)
    track.write_text("\n".join(lines))
    with pytest.raises(InputError) as refused:
        read_registry(registry)
    assert (refused.value.file, refused.value.line, refused.value.field) == (str(track), 42, "alignment_mm")


def test_an_uneven_track_file_is_refused(registry: Path) -> None:
    track = registry.parent / "s-9.csv"
    lines = track.read_text().splitlines()
    track.write_text("\n".join(lines[:50] + lines[52:]))
    with pytest.raises(InputError, match="evenly spaced"):
        read_registry(registry)
