"""The registry file into a real store, twice, and files that must be refused whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from same_values import same_values
from scenario_text import SMALL

from estimation.errors import InputError
from estimation.values.quantities import Status
from fleet_db.storage import SqlStorage
from ingest.registry_file import load_registry, read_registry
from ingest.simulator.campaign import scenario_track
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario

Content = dict[str, Any]


def load(storage: SqlStorage, path: Path) -> None:
    with storage.write() as unit:
        load_registry(path, unit, 1)


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
        before = (unit.registry.wheelsets(), unit.registry.vehicles_page(None, None, 100), unit.tracks.alignment("S-9"))
    load(sqlite_storage, registry)
    with sqlite_storage.read() as unit:
        after = (unit.registry.wheelsets(), unit.registry.vehicles_page(None, None, 100), unit.tracks.alignment("S-9"))
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
    (lambda c: c["vehicles"][0].update(axles=9), "vehicles[0].axles", "at most 8"),
    (lambda c: c["vehicles"][0].update(axles=2), "vehicles[0].axle_offsets_m", "3 offsets for 2 axles"),
    (lambda c: c["vehicles"][0].update(max_speed_km_h="fast"), "vehicles[0].max_speed_km_h", "number"),
    (lambda c: c["vehicles"][0].update(axle_offsets_m=[1, None, 2]), "vehicles[0].axle_offsets_m[1]", "number"),
    (lambda c: c["wheelsets"][2].update(serial=""), "wheelsets[2].serial", "empty"),
    (lambda c: c["wheelsets"][2].update(nominal_radius_mm=0.45), "wheelsets[2].nominal_radius_mm", "at least 100"),
    (lambda c: c["mountings"][0].update({"from": "2024-01-08"}), "mountings[0].from", "offset"),
    (lambda c: c["mountings"][0].update({"to": "2020-01-01T00:00:00Z"}), "mountings[0].to", "later"),
    (lambda c: c["mountings"][1].update(reversed="no"), "mountings[1].reversed", "true nor false"),
    (lambda c: c["mountings"][1].update(wheelset="Z"), "mountings[1]", "Z"),
    (lambda c: c["reprofilings"][0].update(wheelset="Z"), "reprofilings[0]", "Z"),
    (lambda c: c["wheelsets"][0].update(fleet="Z"), "wheelsets[0]", "Z"),
    (lambda c: c["track_sections"][0].update(number=0), "track_sections[0].number", "at least 1"),
    (lambda c: c["track_sections"][0].update(alignment=3), "track_sections[0].alignment", "object"),
    (lambda c: c.update(vehicles={}), "vehicles", "list"),
    (lambda c: c.update(vehicles=[1]), "vehicles[0]", "object"),
    (lambda c: c["vehicles"].append(c["vehicles"][0]), "vehicles[1]", "is in an entry before"),
    (lambda c: c["wheelsets"].append(c["wheelsets"][1]), "wheelsets[3]", "is in an entry before"),
    (lambda c: c["mountings"].append({**c["mountings"][0], "axle": 2}), "mountings[3]", "is in an entry before"),
    (lambda c: c["mountings"][0].update({"from": "9999-01-01T00:00:00Z"}), "mountings[0].from", "1900 to 2200"),
    (lambda c: c["mountings"][0].update(axle=7), "mountings[0].axle", "has axles 1 to 3, not 7"),
    (lambda c: c["mountings"][0].update(vehicle_odometer_km=1e9), "mountings[0].vehicle_odometer_km", "at most"),
    (lambda c: c["vehicles"][0].update(axle_offsets_m=[2.0, 5.0, 2.0]), "vehicles[0].axle_offsets_m", "at one place"),
    (lambda c: c["vehicles"][0].update(axle_offsets_m=[2.0, 1e300]), "vehicles[0].axle_offsets_m[1]", "at most"),
    (lambda c: c["fleets"][0].update(name="a\0b"), "fleets[0].name", "control character"),
    (lambda c: c["wheelsets"][0].update(serial=65 * "W"), "wheelsets[0].serial", "at most 64"),
    (
        lambda c: c["track_sections"][0].update(tonnage_mgt_per_year=0.0),
        "track_sections[0].tonnage_mgt_per_year",
        "0",
    ),
]


def test_sections_may_exchange_their_numbers(storage: SqlStorage, tmp_path: Path) -> None:
    def registered(**numbers: int) -> Path:
        track = {"name": "", "rail_profile": "56E1", "rail_inclination": 0.05, "nominal_gauge_mm": 1435, "length_m": 9}
        sections = [{"code": code, "number": number, **track, "name": code} for code, number in numbers.items()]
        path = tmp_path / "sections.json"
        path.write_text(json.dumps({"format": "treadwatch-registry-1", "track_sections": sections}))
        return path

    load(storage, registered(A=1, B=2, C=3))
    load(storage, registered(A=2, B=1))
    with storage.read() as unit:
        assert {one.code: one.number for one in unit.tracks.sections()} == {"A": 2, "B": 1, "C": 3}
        assert [(event.action, event.record["number"]) for event in unit.registry_history.list("A")] == [("changed", 1)]
    with pytest.raises(InputError, match="'C' already has number 3"):
        load(storage, registered(A=1, B=3))
    with storage.read() as unit:
        assert {one.code: one.number for one in unit.tracks.sections()} == {"A": 2, "B": 1, "C": 3}


def test_the_traffic_of_a_section_lands_in_the_store_and_its_change_in_the_history(
    storage: SqlStorage, tmp_path: Path
) -> None:
    section = {"code": "A", "number": 1, "name": "A", "rail_profile": "56E1", "rail_inclination": 0.05}
    section |= {"nominal_gauge_mm": 1435, "length_m": 9}
    for tonnage in ({}, {"tonnage_mgt_per_year": 18.5}, {}):
        path = tmp_path / "sections.json"
        path.write_text(json.dumps({"format": "treadwatch-registry-1", "track_sections": [section | tonnage]}))
        load(storage, path)
        with storage.read() as unit:
            assert unit.tracks.section("A").tonnage_mgt_per_year == tonnage.get("tonnage_mgt_per_year")
            changes = [event.record["tonnage_mgt_per_year"] for event in unit.registry_history.list("A")]
    assert changes == [None, 18.5]


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


@pytest.mark.parametrize(
    ("content", "words"),
    [("{", "JSON"), ("[]", "one object"), ("{}", "missing"), ("", "JSON"), (100_000 * "[", "nested too deep")],
)
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


def without_alignment(registry: Path) -> Path:
    """Take the alignment out of the track file."""
    track = registry.parent / "s-9.csv"
    rows = [line.split(",") for line in track.read_text().splitlines()]
    at = rows[0].index("alignment_mm")
    track.write_text("\n".join(",".join(cells[:at] + cells[at + 1 :]) for cells in rows))
    return track


def test_a_track_file_may_be_of_the_gauge_alone(storage: SqlStorage, registry: Path) -> None:
    (whole,) = read_registry(registry).alignments
    without_alignment(registry)
    change(registry, lambda c: c["track_sections"][0]["alignment"].pop("alignment_std_mm"))
    load(storage, registry)
    with storage.read() as unit:
        found = unit.tracks.alignment("S-9")
    assert found is not None
    assert (found.status, found.gauge_known, found.source) == (Status.UNESTIMATED, True, whole.source)
    assert np.isnan(found.alignment).all()
    assert np.isnan(found.alignment_std).all()
    assert same_values(found.gauge_deviation, whole.gauge_deviation)
    assert same_values(found.gauge_deviation_std, whole.gauge_deviation_std)


def test_a_gauge_on_file_is_checked_like_an_alignment(registry: Path) -> None:
    track = without_alignment(registry)
    with pytest.raises(InputError, match="no such column") as refused:  # a std of what is not there: misspelt
        read_registry(registry)
    assert (refused.value.file, refused.value.field) == (str(track), "alignment_mm")
    change(registry, lambda c: c["track_sections"][0]["alignment"].pop("alignment_std_mm"))
    lines = track.read_text().splitlines()
    track.write_text("\n".join([*lines[:41], lines[41].split(",")[0] + ",", *lines[42:]]))
    with pytest.raises(InputError, match="finite number") as refused:
        read_registry(registry)
    assert (refused.value.line, refused.value.field) == (42, "gauge_deviation_mm")
    track.write_text("\n".join(line.split(",")[0] for line in lines))
    with pytest.raises(InputError, match="no such column"):
        read_registry(registry)


def test_an_alignment_on_file_needs_its_standard_deviation(registry: Path) -> None:
    change(registry, lambda c: c["track_sections"][0]["alignment"].pop("alignment_std_mm"))
    with pytest.raises(InputError, match="missing") as refused:
        read_registry(registry)
    assert refused.value.field == "track_sections[0].alignment.alignment_std_mm"


def test_an_uneven_track_file_is_refused(registry: Path) -> None:
    track = registry.parent / "s-9.csv"
    lines = track.read_text().splitlines()
    track.write_text("\n".join(lines[:50] + lines[52:]))
    with pytest.raises(InputError, match="evenly spaced"):
        read_registry(registry)


CURVE = """
[[section.curves]]
start_m = 100.0
length_m = 300.0
radius_m = -900.0
cant_mm = -60.0
"""


@pytest.fixture
def curved(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(SMALL.replace("[speed]", f"{CURVE}\n[speed]\nstop_every_s = 100.0"))
    return prepare(read_scenario(tmp_path / "small.toml"), tmp_path / "out")


def test_the_curves_of_a_track_file_land_in_the_store_as_versions(storage: SqlStorage, curved: Path) -> None:
    load(storage, curved)
    load(storage, curved)
    with storage.read() as unit:
        first = unit.tracks.layout("S-9")
    assert first is not None
    assert first.version == 1
    assert first.curvature.min() == pytest.approx(-1 / 900, abs=1e-8)
    assert first.cant.min() == pytest.approx(-0.06)
    assert not first.curvature[first.s < 95.0].any()
    (curved.parent / "own.csv").write_text("s_m,curvature_per_km,cant_mm\n0,0,0\n200,0,0\n280,1.25,70\n700,1.25,70\n")
    change(curved, lambda content: content["track_sections"][0].update(layout={"file": "own.csv"}))
    load(storage, curved)
    with storage.read() as unit:
        second = unit.tracks.layout("S-9")
    assert second is not None
    assert (second.version, second.curvature.tolist()) == (2, [0.0, 0.0, 1.25e-3, 1.25e-3])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("s_m\n0\n700\n", "no such column"),
        ("s_m,curvature_per_km,cant_mm\n0,0,0\n0.7,0,0\n", "ends at 0.7 m, section 'S-9' has 700 m"),
        ("s_m,curvature_per_km,cant_mm\n0,0,0\n700,800,0\n", "are these radii"),
    ],
)
def test_a_layout_that_cannot_be_is_refused(storage: SqlStorage, curved: Path, text: str, words: str) -> None:
    (curved.parent / "own.csv").write_text(text)
    change(curved, lambda content: content["track_sections"][0].update(layout={"file": "own.csv"}))
    with pytest.raises(InputError, match=words):
        load(storage, curved)
    with storage.read() as unit:
        assert not unit.tracks.sections()
