"""Versions of vehicle classes, and what a changed class puts back to the begin: the same on both databases."""

from __future__ import annotations

from dataclasses import replace

import pytest
import stored_values as make
from due_geometries import due_geometries, see_geometries
from sqlalchemy import text

from bench.put_values import put_table
from estimation.errors import DamagedError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Facet, StageInputs, SubjectKind
from estimation.values.track import AlignmentSource
from estimation.values.windows import WindowPosition, WindowState
from estimation.vehicle.vehicle_class import (
    SHIPPED_VERSION,
    Arrangement,
    BogieParameters,
    SensorChannel,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
    class_document,
    class_of_document,
)
from fleet_db.records import NOTHING_AGAIN
from fleet_db.storage import SqlStorage

COACH = VehicleClass(
    code="regional",
    name="Regional coach",
    source="data sheet 7",
    arrangement=Arrangement.BOGIE,
    parameters=VehicleParameters(yaw_stiffness=62.8e6),
    bogie=BogieParameters(2.56, 2615.0, 3067.0, 16000.0, secondary_yaw_damping=1.5),
    sensors=SensorLayout(SensorChannel(1e-3, 0.01, 50.0), yaw_is_gyroscope=True, rate_hz=500.0),
    relative_std={"yaw_stiffness": 0.2, "wheelbase": 0.0},
)
STIFFER = replace(COACH, parameters=replace(COACH.parameters, yaw_stiffness=70e6))
LESS_CERTAIN = replace(COACH, relative_std={"yaw_stiffness": 0.3})


def estimated(storage: SqlStorage) -> None:
    """Store two estimated windows of V-1 with their positions, and one of V-2 on the same section."""
    with storage.write() as unit:
        for number in range(2):
            put(unit, make.window(number))
        put(unit, make.window(2, vehicle="V-2", wheelset="WS-2"))


def put(unit, window) -> None:  # type: ignore[no-untyped-def] # noqa: ANN001 - of a transaction
    unit.windows.put(window, 1.0, 1)
    key = (window.wheelset, window.start_ns)
    record = unit.windows.get(*key)
    put_table(unit, *key, make.bin_table(), 1, record.content_digest)
    unit.windows.mark(*key, WindowState.ESTIMATED)
    unit.tracks.put_positions([WindowPosition(*key, record.content_digest, 1)])


def pending(storage: SqlStorage) -> dict[str, list[WindowState]]:
    with storage.read() as unit:
        return {serial: [one.state for one in unit.windows.list(serial)] for serial in ("WS-1", "WS-2")}


def test_a_class_comes_back_as_it_was_with_its_version_and_time(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        assert unit.registry.vehicle_class("regional") is None
        assert unit.registry.add_vehicle_class(COACH, 100).windows == 0
        assert unit.registry.add_vehicle_class(COACH, 200) == NOTHING_AGAIN
        unit.registry.add_vehicle_class(STIFFER, 300)
    with fleet.read() as unit:
        newest, first = unit.registry.vehicle_class("regional"), unit.registry.vehicle_class("regional", 1)
        assert unit.registry.vehicle_class("regional", 3) is None
        assert [one.version for one in unit.registry.vehicle_classes()] == [2]
    assert first is not None
    assert newest is not None
    assert (first.vehicle_class, first.version, first.recorded_ns) == (COACH, 1, 100)
    assert (newest.vehicle_class, newest.version, newest.recorded_ns) == (STIFFER, 2, 300)
    assert first.digest != newest.digest


def test_a_limit_that_is_infinite_and_a_single_wheelset_come_back() -> None:
    single = replace(COACH, arrangement=Arrangement.SINGLE_WHEELSET, bogie=None)
    for one in (COACH, replace(single, relative_std={})):
        assert class_of_document(class_document(one)) == one


def test_a_class_that_nobody_registered_is_that_of_the_package(fleet: SqlStorage) -> None:
    shipped = SqlStorage(fleet.engine, fleet.data_dir, lambda code: COACH if code == "regional" else None)
    with shipped.write() as unit:
        found = unit.registry.vehicle_class("regional")
        assert found is not None
        assert (found.vehicle_class, found.version, found.recorded_ns) == (COACH, SHIPPED_VERSION, None)
        assert unit.registry.vehicle_class("other") is unit.registry.vehicle_class("regional", 1) is None
        unit.registry.add_vehicle_class(STIFFER, 5)
        own = unit.registry.vehicle_class("regional")
        assert own is not None
        assert own.vehicle_class == STIFFER


def test_a_damaged_class_is_named(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.registry.add_vehicle_class(COACH, 100)
        unit.connection.execute(text("UPDATE vehicle_classes SET document = '{}'"))
    with fleet.read() as unit, pytest.raises(DamagedError, match="version 1 of vehicle class 'regional'"):
        unit.registry.vehicle_class("regional")


def test_a_changed_class_lets_every_window_of_its_vehicles_wait_and_says_since_when(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.registry.add_vehicle_class(COACH, 100)
        unit.tracks.add_alignment(make.alignment())
    estimated(fleet)
    with fleet.write() as unit:
        again = unit.registry.add_vehicle_class(STIFFER, 200)
        assert (again.subjects, again.windows, again.from_ns, again.sections) == (("V-1", "V-2"), 3, make.START, ())
        assert unit.tracks.position("WS-1", make.START) is None
        assert due_geometries(unit) == ["WS-1", "WS-2"]
    assert pending(fleet) == {"WS-1": [WindowState.PENDING] * 2, "WS-2": [WindowState.PENDING]}


def test_other_standard_deviations_make_geometries_stale_and_no_window_wait(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.registry.add_vehicle_class(COACH, 100)
    estimated(fleet)
    with fleet.write() as unit:
        see_geometries(unit)
        assert due_geometries(unit) == []
        again = unit.registry.add_vehicle_class(LESS_CERTAIN, 200)
        assert (again.windows, again.from_ns) == (0, make.START)
        assert due_geometries(unit) == ["WS-1", "WS-2"]
    assert pending(fleet) == {"WS-1": [WindowState.ESTIMATED] * 2, "WS-2": [WindowState.ESTIMATED]}


def test_a_vehicle_of_another_class_than_before_is_estimated_again_alone(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.registry.add_vehicle_class(COACH, 100)
        unit.registry.add_vehicle_class(replace(STIFFER, code="stiff"), 100)
    estimated(fleet)
    with fleet.write() as unit:
        moved = replace(unit.registry.vehicle("V-2"), vehicle_class="stiff")
        assert unit.registry.add_vehicle(moved, 300).subjects == ("V-2",)
        assert unit.registry.add_vehicle(moved, 400) == NOTHING_AGAIN
    assert pending(fleet) == {"WS-1": [WindowState.ESTIMATED] * 2, "WS-2": [WindowState.PENDING]}


def test_a_wheelset_of_another_radius_than_before_is_estimated_again_alone(fleet: SqlStorage) -> None:
    estimated(fleet)
    with fleet.write() as unit:
        turned = replace(unit.registry.wheelset("WS-2"), nominal_radius_m=0.42)
        again = unit.registry.add_wheelset(turned)
        assert (again.subjects, again.windows) == (("wheelset WS-2",), 1)
        assert unit.registry.add_wheelset(turned) == NOTHING_AGAIN
    assert pending(fleet) == {"WS-1": [WindowState.ESTIMATED] * 2, "WS-2": [WindowState.PENDING]}


def test_a_section_that_the_vehicles_helped_to_align_is_due_and_its_alignment_stays_until_then(
    fleet: SqlStorage,
) -> None:
    of_fleet = replace(make.alignment(2), source=AlignmentSource.FLEET, cutoff_wavelength=100.0)
    with fleet.write() as unit:
        unit.registry.add_vehicle_class(COACH, 100)
        unit.registry.add_vehicle_class(replace(COACH, code="other"), 100)
        unit.registry.add_vehicle(replace(unit.registry.vehicle("V-2"), vehicle_class="other"))
        unit.tracks.add_alignment(of_fleet, recorded_ns=150)
    estimated(fleet)
    with fleet.write() as unit:
        before = unit.tracks.in_force("S-7")
        assert unit.registry.add_vehicle_class(STIFFER, 200).sections == ("S-7",)
        assert unit.tracks.in_force("S-7") == before
        assert unit.tracks.position("WS-1", make.START) is None
        assert unit.tracks.position("WS-2", make.window(2).start_ns) is not None
        inputs = StageInputs("alignment", SubjectKind.SECTION, (Facet.WINDOWS,), "")
        assert set(unit.marks.due(inputs, 300)) == {"S-7"}
    assert pending(fleet) == {"WS-1": [WindowState.PENDING] * 2, "WS-2": [WindowState.ESTIMATED]}


def test_windows_that_were_refused_for_want_of_a_class_wait_again(fleet: SqlStorage) -> None:
    estimated(fleet)
    unknown, other = Reason(ReasonCode.CLASS_UNKNOWN, "unknown"), Reason(ReasonCode.CLIPPED, "clipped")
    with fleet.write() as unit:
        unit.windows.mark("WS-1", make.START, WindowState.REFUSED, unknown)
        unit.windows.mark("WS-1", make.START + make.LENGTH, WindowState.REFUSED, other)
        refused = unit.windows.refused_on("S-7", [ReasonCode.CLASS_UNKNOWN])
        assert unit.windows.look_again([record.key for record in refused]) == [("WS-1", make.START)]
        assert unit.tracks.position("WS-1", make.START) is None
        assert unit.windows.refused_on("S-7", [ReasonCode.CLASS_UNKNOWN]) == []
    assert pending(fleet)["WS-1"] == [WindowState.PENDING, WindowState.REFUSED]
