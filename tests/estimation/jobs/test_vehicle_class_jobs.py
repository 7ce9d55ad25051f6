"""The jobs on vehicles whose class is unknown, comes, changes, or differs from that of the vehicle before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from alignment_job import LENGTH, counts, surveyed
from paper_class import PAPER_CLASS, paper_class
from section_runs import windows

from estimation.storage import Storage
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import WindowState
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.storage import SqlStorage

STIFFER = replace(
    paper_class("metro"),
    parameters=replace(PAPER_CLASS.parameters, yaw_stiffness=3e6),
    relative_std={"yaw_stiffness": 0.2},
)


def register(storage: SqlStorage, *, radius: float = 0.45) -> None:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, LENGTH))
        unit.tracks.add_alignment(surveyed())
        unit.registry.add_vehicle(VehicleRecord("V1", "F", "metro", 1, 40.0, (0.0,)))
        unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", radius, None))
        unit.registry.add_mounting(Mounting("W1", "V1", 1, 0, None, 0.0, 0.0))
        for window in windows(1):
            unit.windows.put(replace(window, track_section="S1"), 10.0, 1)


def classify(storage: SqlStorage, vehicle_class: VehicleClass) -> None:
    with storage.write() as unit:
        unit.registry.add_vehicle_class(vehicle_class, 7)


def jobs(storage: Storage) -> tuple[int, int]:
    """Run the jobs up to the geometry; return how many windows were estimated, and how many refused."""
    counts(storage, "refresh_alignment")
    found = counts(storage, "estimate_windows")
    counts(storage, "refresh_geometry")
    return found["estimated"], found["refused"]


def current(storage: Storage) -> GeometryRecord:
    with storage.read() as unit:
        found = unit.geometries.current("W1")
    assert found is not None
    return found


def provenance(storage: Storage) -> tuple[object, ...]:
    known = current(storage).parameters
    of_class, vehicle = known["vehicle_class"], known["vehicle"]
    assert isinstance(of_class, dict)
    assert isinstance(vehicle, dict)
    return of_class["code"], of_class["version"], vehicle["yaw_stiffness"], vehicle["nominal_radius"]


def test_a_vehicle_waits_for_its_class_and_is_estimated_again_with_another(sqlite_storage: SqlStorage) -> None:
    count = len(windows(1))
    register(sqlite_storage)
    assert jobs(sqlite_storage) == (0, count)
    with sqlite_storage.read() as unit:
        assert {code_of(one.reason) for one in unit.windows.list("W1")} == {ReasonCode.CLASS_UNKNOWN}
        assert unit.geometries.current("W1") is None
    classify(sqlite_storage, paper_class("metro"))
    assert jobs(sqlite_storage) == (count, 0)
    first = current(sqlite_storage)
    assert provenance(sqlite_storage) == ("metro", 1, 2.5e6, 0.45)
    classify(sqlite_storage, STIFFER)
    assert jobs(sqlite_storage) == (count, 0)
    second = current(sqlite_storage)
    assert provenance(sqlite_storage) == ("metro", 2, 3e6, 0.45)
    assert second.geometry.parameter_key != first.geometry.parameter_key
    values = [record.geometry.equivalent_conicity.value for record in (first, second)]
    assert None not in values
    assert values[0] != values[1]
    assert jobs(sqlite_storage) == (0, 0)


def test_a_class_that_is_known_worse_widens_the_intervals_without_estimating_a_window(
    sqlite_storage: SqlStorage,
) -> None:
    classify(sqlite_storage, paper_class("metro"))
    register(sqlite_storage)
    jobs(sqlite_storage)
    before = current(sqlite_storage).geometry.equivalent_conicity
    classify(sqlite_storage, replace(paper_class("metro"), relative_std={"nominal_radius": 0.05}))
    assert jobs(sqlite_storage) == (0, 0)
    after = current(sqlite_storage).geometry.equivalent_conicity
    assert after.value == before.value
    assert before.std is not None
    assert after.std is not None
    assert after.value is not None
    assert after.std == pytest.approx(float(np.hypot(before.std, 0.05 * after.value)), rel=0.05)


def test_the_radius_is_that_of_the_wheelset_and_not_of_the_class(sqlite_storage: SqlStorage) -> None:
    classify(sqlite_storage, paper_class("metro"))
    register(sqlite_storage)
    jobs(sqlite_storage)
    before = current(sqlite_storage).geometry.equivalent_conicity.value
    with sqlite_storage.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", 0.42, None))
    assert jobs(sqlite_storage) == (len(windows(1)), 0)
    after = current(sqlite_storage).geometry.equivalent_conicity.value
    assert provenance(sqlite_storage)[3] == 0.42
    assert before is not None
    assert after == pytest.approx(before * 0.42 / 0.45, rel=0.02)  # R follows from a moment times r0


def test_what_ran_under_vehicles_of_two_classes_is_not_merged(sqlite_storage: SqlStorage) -> None:
    """Both are within one interval of mileage; the current geometry is of the vehicle that it runs under now."""
    classify(sqlite_storage, paper_class("metro"))
    classify(sqlite_storage, replace(STIFFER, code="tram"))
    register(sqlite_storage)
    later = windows(1)[0].start_ns + 10**15
    with sqlite_storage.write() as unit:
        unit.registry.add_mounting(Mounting("W1", "V1", 1, 0, later, 0.0, 0.0))
        unit.registry.add_vehicle(VehicleRecord("V2", "F", "tram", 1, 40.0, (0.0,)))
        unit.registry.add_mounting(Mounting("W1", "V2", 1, later, None, 0.0, 0.0))
        moved = replace(windows(1)[0], start_ns=later, vehicle="V2", track_section="S1")
        unit.windows.put(moved, 20.0, 1)
    jobs(sqlite_storage)
    with sqlite_storage.read() as unit:
        (interval,) = unit.geometries.intervals("W1")
        assert {one.state for one in unit.windows.list("W1")} == {WindowState.ESTIMATED}
    assert interval.geometry.windows == len(windows(1))
    assert current(sqlite_storage).geometry.windows == 1
    assert provenance(sqlite_storage)[0] == "tram"
