"""What contradicts is refused whole with the records named, whichever came first; what is confirmed is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from registry_files import DAY_NS, FILE, MOUNTED_NS, NOW_NS, at, load, refused, written

from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord
from fleet_db.records import Decision
from fleet_db.storage import SqlStorage
from ingest.registry_entry.contents import RegistryRefusedError, Rule
from ingest.vehicle_class_schema import class_of_package

Content = dict[str, Any]
TURNED = {"wheelset": "W-1", "at": at(20), "mileage_km": 60_000.0}


def turned(**changes: object) -> Content:
    return {"reprofilings": [TURNED | changes]}


def mounted(**changes: object) -> Content:
    return {"mountings": [FILE["mountings"][0] | changes]}


@pytest.fixture
def registered(sqlite_storage: SqlStorage, tmp_path: Path) -> SqlStorage:
    """Return a storage that knows the small registry and the classes of the package."""
    known = replace(sqlite_storage, shipped=class_of_package)
    load(known, written(tmp_path, FILE))
    return known


CONTRADICTIONS: list[tuple[Content, str, str, list[str]]] = [
    (turned(at="2036-01-01T00:00:00Z"), "reprofilings[0].at", "is in the future", []),
    (turned(at=at(-1)), "reprofilings[0].at", "before the first mounting of wheelset 'W-1'", ["mountings"]),
    (turned(mileage_km=1000.0), "reprofilings[0].mileage_km", "run backwards, there is 50,000 km", ["mountings"]),
    (turned(mileage_km=6e7), "reprofilings[0].mileage_km", "faster than any vehicle (metres?)", ["mountings"]),
    (
        mounted(**{"from": at(30), "vehicle": "V-2", "wheelset_mileage_km": 70_000.0}),
        "mountings[0]",
        "overlaps wheelset 'W-1' at axle 1 of 'V-1' from 2024-01-01T00:00:00Z",
        ["mountings"],
    ),
    (
        mounted(wheelset="W-2", vehicle="V-1", axle=1, **{"from": at(30)}),
        "mountings[0]",
        "overlaps wheelset 'W-1'",
        ["mountings"],
    ),
    (
        mounted(wheelset="W-3", vehicle="V-1", axle=2, **{"from": at(1)}, vehicle_odometer_km=2_000_000.0),
        "mountings[0].vehicle_odometer_km",
        "the odometer would run faster than any vehicle (metres?)",
        ["mountings"],
    ),
    (mounted(**{"from": "2036-01-01T00:00:00Z"}, wheelset="W-3", axle=2), "mountings[0].from", "future", []),
    (mounted(to="2036-01-01T00:00:00Z"), "mountings[0].to", "is in the future", []),
    (
        {"wheelsets": [FILE["wheelsets"][0] | {"nominal_radius_mm": 920.0}]},
        "wheelsets[0].nominal_radius_mm",
        "of class",
        [],
    ),
    (
        {"wheelsets": [FILE["wheelsets"][0] | {"serial": "W-9", "nominal_radius_mm": 920.0}]},
        "wheelsets[0].nominal_radius_mm",
        "a diameter?",
        [],
    ),
    (
        {"wheelsets": [FILE["wheelsets"][0] | {"serial": "W-9", "wheel_profile": "S1003"}]},
        "wheelsets[0].wheel_profile",
        "no wheel profile named 'S1003'; known: ",
        [],
    ),
    ({"wheelsets": [FILE["wheelsets"][0] | {"serial": "W/9"}]}, "wheelsets[0].serial", "divides paths", []),
    ({"vehicles": [FILE["vehicles"][0] | {"code": "V__9"}]}, "vehicles[0].code", "file name", []),
    (
        {"track_sections": [FILE["track_sections"][0] | {"code": "S-2", "number": 2, "nominal_gauge_mm": 1000.0}]},
        "track_sections[0].nominal_gauge_mm",
        "no vehicle on file runs on it, their wheels touch the rails 1500 mm apart",
        [],
    ),
    (
        {"track_sections": [FILE["track_sections"][0] | {"rail_profile": "61E9"}]},
        "track_sections[0].rail_profile",
        "no rail profile named '61E9'",
        [],
    ),
]


@pytest.mark.parametrize(("content", "field", "words", "others"), CONTRADICTIONS)
def test_what_contradicts_is_refused_with_the_records_named(
    registered: SqlStorage, tmp_path: Path, content: Content, field: str, words: str, others: list[str]
) -> None:
    error = refused(registered, written(tmp_path, content))
    found = [one for one in error.refusals if one.error.field == field and words in one.error.reason]
    assert len(found) == 1, [str(one.error) for one in error.refusals]
    named = found[0].contradiction
    assert [one.kind for one in (() if named is None else named.others)] == others
    with registered.read() as unit:
        assert unit.registry.wheelset("W-1").reprofilings == ()
        assert [one.serial for one in unit.registry.wheelsets()] == ["W-1", "W-2", "W-3"]
        assert unit.registry.mountings("W-3") == []


def test_everything_that_is_wrong_is_listed_and_nothing_is_stored(registered: SqlStorage, tmp_path: Path) -> None:
    content = {
        "wheelsets": [FILE["wheelsets"][0] | {"serial": "W/9"}],
        "mountings": [FILE["mountings"][0] | {"wheelset": "W-7", "axle": 2}],
        "reprofilings": [TURNED | {"mileage_km": 10.0}, TURNED | {"wheelset": "W-8"}],
    }
    error = refused(registered, written(tmp_path, content))
    assert [one.error.field for one in error.refusals] == [
        "mountings[0]",
        "reprofilings[1]",
        "wheelsets[0].serial",
        "reprofilings[0].mileage_km",
    ]


@pytest.mark.parametrize("rule", [Rule.ODOMETER_JUMP, Rule.UNUSUAL_RADIUS, Rule.UNUSUAL_GAUGE, Rule.UNKNOWN_PROFILE])
def test_a_doubt_is_confirmed_by_its_name_alone(registered: SqlStorage, tmp_path: Path, rule: Rule) -> None:
    content = {
        "wheelsets": [FILE["wheelsets"][0] | {"serial": "W-9", "nominal_radius_mm": 920.0, "wheel_profile": "ours"}],
        "mountings": [
            FILE["mountings"][0] | {"wheelset": "W-3", "axle": 2, "from": at(1), "vehicle_odometer_km": 900_000.0}
        ],
        "track_sections": [FILE["track_sections"][0] | {"nominal_gauge_mm": 1000.0}],
    }
    doubts = {Rule.ODOMETER_JUMP, Rule.UNUSUAL_RADIUS, Rule.UNUSUAL_GAUGE, Rule.UNKNOWN_PROFILE}
    path = written(tmp_path, content)
    error = refused(registered, path, doubts - {rule})
    assert [one.contradiction.rule for one in error.refusals if one.contradiction] == [rule]
    assert f"confirm {rule})" in error.refusals[0].error.reason
    load(registered, path, doubts)
    load(registered, path)  # on file as it is: there is no doubt about it any more


def test_what_is_on_file_already_is_not_questioned_again(registered: SqlStorage, tmp_path: Path) -> None:
    with registered.write() as unit:  # what the rules of entry would not take
        unit.registry.add_wheelset(WheelsetRecord("A/B__C", "N", "own", 0.9, None))
        unit.registry.add_reprofiling(Reprofiling("W-1", MOUNTED_NS - DAY_NS, 7.0))
    old = {"serial": "A/B__C", "fleet": "N", "wheel_profile": "own", "nominal_radius_mm": 900.0}
    wrong = {"wheelset": "W-1", "at": at(-1), "mileage_km": 7.0}
    load(registered, written(tmp_path, {"wheelsets": [old], "reprofilings": [wrong]}))


def test_a_first_mounting_after_a_reprofiling_is_refused_too(registered: SqlStorage, tmp_path: Path) -> None:
    load(registered, written(tmp_path, {"reprofilings": [TURNED | {"wheelset": "W-3"}]}))
    late = FILE["mountings"][0] | {"wheelset": "W-3", "axle": 2, "from": at(21), "wheelset_mileage_km": 60_000.0}
    error = refused(registered, written(tmp_path, {"mountings": [late]}))
    assert "the first mounting is later than the reprofiling of wheelset 'W-3'" in str(error)


def test_the_end_of_a_mounting_is_entered_whatever_its_mileage(registered: SqlStorage, tmp_path: Path) -> None:
    with registered.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W-1", MOUNTED_NS + DAY_NS, 7.0))  # contradicts the mounting
    load(registered, written(tmp_path, mounted(to=at(40))))


def test_who_enters_what_and_why_is_kept(registered: SqlStorage, tmp_path: Path) -> None:
    load(registered, written(tmp_path, turned()), decision=Decision("ada", "report 7", NOW_NS))
    load(registered, written(tmp_path, turned(note="lathe 2")), decision=Decision("bob", "forgotten", NOW_NS + 1))
    with registered.read() as unit:
        events = unit.registry_history.list("W-1")
    assert [(one.action, one.actor, one.reason, one.recorded_ns) for one in events] == [
        ("entered", "ada", "report 7", NOW_NS),
        ("changed", "bob", "forgotten", NOW_NS + 1),
    ]
    assert [one.after["note"] for one in events if one.after] == ["", "lathe 2"]
    assert [one.record.get("note") for one in events] == [None, ""]


def test_a_byte_order_mark_is_accepted(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    path = tmp_path / "registry.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(FILE).encode())
    load(sqlite_storage, path)
    with sqlite_storage.read() as unit:
        assert len(unit.registry.wheelsets()) == 3


def test_wheelsets_that_are_turned_mounted_and_exchanged_as_usual_are_entered(
    registered: SqlStorage, tmp_path: Path
) -> None:
    first = FILE["mountings"][0]
    life = {
        "mountings": [
            first | {"to": at(20)},
            first | {"wheelset": "W-3", "from": at(20), "vehicle_odometer_km": 60_000.0, "wheelset_mileage_km": 0.0},
            first | {"from": at(25), "vehicle": "V-1", "axle": 2, "vehicle_odometer_km": 62_500.0,
                     "wheelset_mileage_km": 60_000.0},
        ],
        "reprofilings": [TURNED | {"at": at(22)}],
    }  # fmt: skip
    load(registered, written(tmp_path, life))
    with registered.read() as unit:
        assert [one.vehicle for one in unit.registry.mountings("W-1")] == ["V-1", "V-1"]
        assert unit.registry.mounting_at("V-1", 1, MOUNTED_NS + 21 * DAY_NS) == Mounting(
            "W-3", "V-1", 1, MOUNTED_NS + 20 * DAY_NS, None, 60_000.0, 0.0
        )


def test_a_refusal_is_an_input_error_with_the_first_place(registered: SqlStorage, tmp_path: Path) -> None:
    path = written(tmp_path, turned(mileage_km=1000.0))
    with pytest.raises(RegistryRefusedError, match=r"field 'reprofilings\[0\].mileage_km': 1,000 km"):
        load(registered, path)
