"""Vehicle classes in a registry file: inline or in files of their own, and vehicles that do not belong to theirs."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
from in_process_command import Run

from api.terminal.registry import registry_lines
from estimation.errors import InputError
from fleet_db.storage import SqlStorage
from ingest.registry_entry.contents import LoadedRegistry
from ingest.registry_file import load_registry
from ingest.vehicle_class_schema import class_of_package, shipped_class, shipped_path

Content = dict[str, Any]
COACH = {key: value for key, value in tomllib.loads(shipped_path("coach").read_text()).items() if key != "format"}
WHEELBASE = COACH["bogie"]["wheelbase_m"]
RADIUS = COACH["wheelset"]["nominal_radius_mm"]


def registry(**changes: object) -> Content:
    """Return a registry of one coach of two bogies with one wheelset."""
    vehicle = {
        "code": "V1",
        "fleet": "F",
        "vehicle_class": "coach",
        "axles": 4,
        "max_speed_km_h": 160.0,
        "axle_offsets_m": [0.0, WHEELBASE, 19.0, 19.0 + WHEELBASE],
    }
    return {
        "format": "treadwatch-registry-1",
        "fleets": [{"code": "F", "name": "Fleet"}],
        "vehicle_classes": [COACH],
        "vehicles": [vehicle | changes],
        "wheelsets": [{"serial": "W1", "fleet": "F", "wheel_profile": "S1002", "nominal_radius_mm": RADIUS}],
        "mountings": [
            {
                "wheelset": "W1",
                "vehicle": "V1",
                "axle": 1,
                "from": "2024-01-08T05:30:00Z",
                "vehicle_odometer_km": 0.0,
                "wheelset_mileage_km": 0.0,
            }
        ],
    }


def load(storage: SqlStorage, folder: Path, content: Content, at_ns: int = 1) -> LoadedRegistry:
    path = folder / "registry.json"
    path.write_text(json.dumps(content))
    with storage.write() as unit:
        return load_registry(path, unit, at_ns)


def refused(storage: SqlStorage, folder: Path, content: Content) -> InputError:
    with pytest.raises(InputError) as found:
        load(storage, folder, content)
    with storage.read() as unit:
        assert not unit.registry.fleets()
        assert not unit.registry.vehicle_classes()
    return found.value


def test_a_class_in_the_registry_is_the_same_as_in_its_own_file(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    assert load(sqlite_storage, tmp_path, registry()).without_class == ()
    with sqlite_storage.read() as unit:
        (inline,) = unit.registry.vehicle_classes()
    assert inline.vehicle_class == shipped_class("coach")
    shutil.copyfile(shipped_path("coach"), tmp_path / "own.toml")
    content = registry() | {"vehicle_classes": [{"file": "own.toml"}]}
    assert load(sqlite_storage, tmp_path, content).contents.classes == (inline.vehicle_class,)
    with sqlite_storage.read() as unit:
        assert unit.registry.vehicle_classes() == [inline]  # the same content is no new version


@pytest.mark.parametrize(
    ("entry", "field", "words"),
    [
        (COACH | {"arrangement": "boggie"}, "vehicle_classes[0].arrangement", "boggie"),
        (COACH | {"colour": "red"}, "vehicle_classes[0].colour", "unknown key"),
        (COACH | {"wheelset": COACH["wheelset"] | {"mass_kg": -1.0}}, "vehicle_classes[0].wheelset.mass_kg.value", "0"),
        ({"file": "missing.toml"}, None, "cannot be read"),
        ({"file": 3}, "vehicle_classes[0].file", "text"),
    ],
)
def test_a_wrong_class_is_refused_with_its_field(
    sqlite_storage: SqlStorage, tmp_path: Path, entry: Content, field: str | None, words: str
) -> None:
    error = refused(sqlite_storage, tmp_path, registry() | {"vehicle_classes": [entry]})
    assert error.field == field
    assert words in str(error)


def test_two_classes_of_one_code_are_refused(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    error = refused(sqlite_storage, tmp_path, registry() | {"vehicle_classes": [COACH, COACH]})
    assert error.field == "vehicle_classes[1]"


@pytest.mark.parametrize("by", [0.049, -0.049, 0.051, -0.051])
def test_axles_of_a_bogie_are_its_wheelbase_apart(sqlite_storage: SqlStorage, tmp_path: Path, by: float) -> None:
    content = registry(axle_offsets_m=[0.0, WHEELBASE, 19.0, 19.0 + WHEELBASE + by])
    if abs(by) < 0.05:
        load(sqlite_storage, tmp_path, content)
        return
    error = refused(sqlite_storage, tmp_path, content)
    assert error.field == "vehicles[0].axle_offsets_m"
    assert "wheelbase of class 'coach' is 2.56 m" in str(error)


def test_a_changed_class_still_fits_the_vehicles_on_file(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    load(sqlite_storage, tmp_path, registry())
    shorter = COACH | {"bogie": COACH["bogie"] | {"wheelbase_m": 2.4}}
    alone = {"format": "treadwatch-registry-1", "vehicle_classes": [shorter]}
    with pytest.raises(InputError, match="vehicle 'V1' on file") as found:
        load(sqlite_storage, tmp_path, alone)
    assert found.value.field == "vehicle_classes[0]"
    both = registry(axle_offsets_m=[0.0, 2.4, 19.0, 21.4]) | {"vehicle_classes": [shorter]}
    load(sqlite_storage, tmp_path, both)


def test_a_vehicle_on_bogies_has_an_even_number_of_axles(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    error = refused(sqlite_storage, tmp_path, registry(axles=3, axle_offsets_m=[0.0, WHEELBASE, 19.0]))
    assert error.field == "vehicles[0].axles"


@pytest.mark.parametrize("share", [0.851, 0.849, 1.149, 1.151])
def test_a_radius_far_from_that_of_the_class_is_refused(
    sqlite_storage: SqlStorage, tmp_path: Path, share: float
) -> None:
    content = registry()
    content["wheelsets"][0]["nominal_radius_mm"] = share * RADIUS
    if abs(share - 1.0) < 0.15:
        load(sqlite_storage, tmp_path, content)
    else:
        assert refused(sqlite_storage, tmp_path, content).field == "wheelsets[0].nominal_radius_mm"


def test_a_radius_is_held_against_the_class_whichever_of_both_is_on_file(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    whole = registry()
    load(sqlite_storage, tmp_path, whole)
    (wheelset,), (mounting,) = whole["wheelsets"], whole["mountings"]
    wheel = COACH["wheelset"] | {"nominal_radius_mm": 330.0}
    small = wheelset | {"serial": "W2", "nominal_radius_mm": 330.0}
    form = {"format": "treadwatch-registry-1"}
    load(sqlite_storage, tmp_path, form | {"wheelsets": [small]})  # not mounted
    on_file = "wheelset 'W1' on file: 460 mm differs by more than 15 % from the 330 mm of class 'coach'"
    for change, field, words in (
        ({"wheelsets": [wheelset | {"nominal_radius_mm": 600.0}]}, "wheelsets[0].nominal_radius_mm", "600 mm differs"),
        ({"mountings": [mounting | {"wheelset": "W2", "axle": 2}]}, "mountings[0].wheelset", "wheelset 'W2' on file"),
        ({"vehicle_classes": [COACH | {"wheelset": wheel}]}, "vehicle_classes[0]", on_file),
        (
            {"vehicle_classes": [COACH | {"wheelset": wheel, "code": "metro"}]}
            | {"vehicles": [whole["vehicles"][0] | {"vehicle_class": "metro"}]},
            "vehicles[0].vehicle_class",
            "wheelset 'W1' on file",
        ),
    ):
        with pytest.raises(InputError) as found:
            load(sqlite_storage, tmp_path, form | change)
        assert found.value.field == field
        assert words in found.value.reason
    with sqlite_storage.read() as unit:
        assert len(unit.registry.vehicle_classes()) == 1
        assert unit.registry.wheelset("W1").nominal_radius_m == pytest.approx(1e-3 * RADIUS)


def test_a_vehicle_whose_class_nobody_knows_is_stored_with_a_warning(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    content = registry(vehicle_class="tram")
    loaded = load(sqlite_storage, tmp_path, content)
    assert [vehicle.code for vehicle in loaded.without_class] == ["V1"]
    assert registry_lines(loaded) == ["warning: class 'tram' is not on file: V1 will not be estimated until it is"]


def test_a_class_of_the_package_need_not_be_registered(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    storage = SqlStorage(sqlite_storage.engine, sqlite_storage.data_dir, class_of_package)
    content = registry() | {"vehicle_classes": []}
    assert registry_lines(load(storage, tmp_path, content)) == []
    content["vehicles"][0]["axle_offsets_m"] = [0.0, 1.8, 19.0, 20.8]
    with pytest.raises(InputError, match="wheelbase of class 'coach'"):
        load(storage, tmp_path, content)


def test_a_registry_is_loaded_without_recordings_and_says_who_waits_for_a_class(
    treadwatch: Run, tmp_path: Path
) -> None:
    path = tmp_path / "registry.json"
    path.write_text(json.dumps(registry(vehicle_class="tram")))
    treadwatch("db", "upgrade")
    done = treadwatch("ingest", "--registry", path)
    assert done.returncode == 0, done.stderr
    assert "class 'tram' is not on file: V1 will not be estimated" in done.stderr
