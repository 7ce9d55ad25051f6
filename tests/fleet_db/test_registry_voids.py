"""Voiding a record of any kind is as if it had never been entered; restoring it as if it had never been voided."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import stored_values as make
from sqlalchemy import select
from stored_values import measured_profiles

from estimation.errors import ConflictError, NotFoundError
from estimation.values.registry import (
    FleetRecord,
    Mounting,
    Reprofiling,
    SensorChange,
    SensorWork,
    VehicleRecord,
    WheelsetRecord,
)
from estimation.values.runs import Facet
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.vehicle_class import class_digest
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from fleet_db.subjects import VERSIONS
from fleet_db.tables import Base
from ingest.vehicle_class_schema import class_of_package, shipped_class

AT = 5_000
WHY = Decision("ada", "wrong", 77)
SECTION = TrackSectionRecord("T", 13, "another", "60E1", 0.05, 1.435, 3000.0)
WORK = SensorChange("V1", 2, AT, SensorWork.SWAP, "old", "new", "chafed")
OWN = replace(shipped_class("coach"), name="our coach")

Enter = Callable[[SqlUnitOfWork], object]
KINDS: dict[RecordKey, Enter] = {
    RecordKey(RecordKind.MOUNTING, "W2", AT): lambda unit: unit.registry.add_mounting(
        Mounting("W2", "V1", 2, AT, None, 1.0, 2.0)
    ),
    RecordKey(RecordKind.REPROFILING, "W1", AT): lambda unit: unit.registry.add_reprofiling(
        Reprofiling("W1", AT, 300.0, "lathe")
    ),
    RecordKey(RecordKind.MEASUREMENT, "W1", AT): lambda unit: unit.registry.add_measured_profiles(
        replace(measured_profiles(AT), wheelset="W1")
    ),
    RecordKey(RecordKind.WHEELSET, "W9"): lambda unit: unit.registry.add_wheelset(
        WheelsetRecord("W9", "f", "P8", 0.46, None)
    ),
    RecordKey(RecordKind.VEHICLE, "V9"): lambda unit: unit.registry.add_vehicle(
        VehicleRecord("V9", "f", "coach", 2, 40.0, (1.0, 3.0))
    ),
    RecordKey(RecordKind.SECTION, "T"): lambda unit: unit.tracks.add_section(SECTION),
    RecordKey(RecordKind.SENSOR_CHANGE, "V1", AT): lambda unit: unit.sensor_changes.add(WORK, 2, Decision()),
    RecordKey(RecordKind.VEHICLE_CLASS, "coach"): lambda unit: unit.registry.add_vehicle_class(OWN, 5),
}


@pytest.fixture
def known(storage: SqlStorage) -> SqlStorage:
    found = replace(storage, shipped=class_of_package)
    with found.write() as unit:
        unit.registry.add_fleet(FleetRecord("f", "F"))
        unit.registry.add_vehicle(VehicleRecord("V1", "f", "coach", 2, 40.0, (1.0, 3.0)))
        for serial in ("W1", "W2"):
            unit.registry.add_wheelset(WheelsetRecord(serial, "f", "P8", 0.46, None))
        unit.registry.add_mounting(Mounting("W1", "V1", 1, 1_000, None, 10.0, 20.0))
    return found


def shown(storage: SqlStorage) -> dict[str, object]:
    """Return the registry as everybody reads it."""
    with storage.read() as unit:
        vehicles = unit.registry.vehicles_page(None, None, 100)
        wheelsets = unit.registry.wheelsets_of([one.serial for one in unit.registry.wheelsets()], voided=False)
        coach = unit.registry.vehicle_class("coach")
        with storage.engine.connect() as connection:
            measured = [tuple(row) for row in connection.execute(select(Base.metadata.tables["measured_profiles"]))]
        return {
            "vehicles": vehicles,
            "wheelsets": wheelsets,
            "mountings": [unit.registry.mountings(one.serial) for one in wheelsets],
            "measured": measured,
            "sections": unit.tracks.sections(),
            "sensors": [unit.sensor_changes.list(one.code) for one in vehicles],
            "class": None if coach is None else class_digest(coach.vehicle_class),
        }


RAISED: dict[RecordKind, set[str]] = {
    RecordKind.MOUNTING: {"wheelset W2", "vehicle V1", "wheelset W1", "section S"},
    RecordKind.REPROFILING: {"wheelset W1", "section S"},
    RecordKind.MEASUREMENT: {"wheelset W1", "section S"},
    RecordKind.WHEELSET: {"wheelset W9"},
    RecordKind.VEHICLE: {"vehicle V9"},
    RecordKind.SECTION: {"section T"},
    RecordKind.SENSOR_CHANGE: {"vehicle V1", "wheelset W1", "section S"},
    RecordKind.VEHICLE_CLASS: {"vehicle V1", "wheelset W1", "section S"},
}
"""Whose facet REGISTRY has another version where a record is entered, voided or restored."""


def versions(storage: SqlStorage) -> dict[str, int]:
    with storage.read() as unit:
        rows = unit.connection.execute(select(VERSIONS).where(VERSIONS.c.facet == Facet.REGISTRY.value))
        return {f"{row.kind} {row.subject}": row.version for row in rows}


@pytest.mark.parametrize("key", KINDS, ids=lambda key: key.kind.value)
def test_what_rests_on_a_record_has_another_version(known: SqlStorage, key: RecordKey) -> None:
    with known.write() as unit:  # W1 has a window on S
        unit.tracks.add_section(replace(SECTION, code="S", number=1))
        window = make.window(vehicle="V1", wheelset="W1", track_section="S")
        unit.windows.put(window, 1.0, 1)
    steps: list[Enter] = [
        KINDS[key],
        lambda unit: unit.corrections.void(key, WHY),
        lambda unit: unit.corrections.restore(key, WHY),
    ]
    for step in steps:
        before = versions(known)
        with known.write() as unit:
            step(unit)
        after = versions(known)
        raised = {subject for subject, version in after.items() if version != before.get(subject)}
        assert raised == RAISED[key.kind] | {"fleet "}, step
    with known.write() as unit:  # the same again changes nothing
        KINDS[key](unit)
    assert versions(known) == after


@pytest.mark.parametrize("key", KINDS, ids=lambda key: key.kind.value)
def test_a_voided_record_is_as_if_it_had_never_been_and_a_restored_one_as_if_never_voided(
    known: SqlStorage, key: RecordKey
) -> None:
    never = shown(known)
    with known.write() as unit:
        KINDS[key](unit)
    entered = shown(known)
    assert entered != never
    with known.write() as unit:
        unit.corrections.void(key, WHY)
    assert shown(known) == never
    with pytest.raises(NotFoundError), known.write() as unit:
        unit.corrections.void(key, WHY)
    with known.write() as unit:
        unit.corrections.restore(key, replace(WHY, reason="it was right"))
    assert shown(known) == entered
    with pytest.raises(ConflictError), known.write() as unit:
        unit.corrections.restore(key, WHY)
    with known.write() as unit:  # once more, and entered again by whoever has it on file still
        unit.corrections.void(key, WHY)
        KINDS[key](unit)
    assert shown(known) == entered
    with known.read() as unit:
        decided = [one.action for one in unit.registry_history.list(key.subject, kind=key.kind)]
    assert [one for one in decided if one != "changed"][:3] == ["voided", "restored", "voided"]


def test_what_vehicles_rest_on_is_voided_after_them(known: SqlStorage) -> None:
    with pytest.raises(ConflictError, match="wheelset 'W1' is mounted on vehicle 'V1'"), known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.VEHICLE, "V1"), WHY)
    alone = replace(OWN, code="own")
    with known.write() as unit:
        unit.registry.add_vehicle_class(alone, 5)
        unit.registry.add_vehicle(VehicleRecord("V2", "f", "own", 2, 40.0, (1.0, 3.0)))
    with pytest.raises(ConflictError, match="vehicle 'V2' is of class 'own'"), known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.VEHICLE_CLASS, "own"), WHY)
    with known.write() as unit:
        unit.registry.add_vehicle(VehicleRecord("V2", "f", "coach", 2, 40.0, (1.0, 3.0)))
        unit.corrections.void(RecordKey(RecordKind.VEHICLE_CLASS, "own"), WHY)
        assert unit.registry.vehicle_class("own") is None
        assert "own" not in [one.vehicle_class.code for one in unit.registry.vehicle_classes()]
        assert unit.registry.vehicle_class("own", 1) is not None  # as it was estimated with
    with pytest.raises(NotFoundError), known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.VEHICLE_CLASS, "freight"), WHY)  # of the package


def test_one_time_has_work_on_one_axle(known: SqlStorage) -> None:
    with known.write() as unit:
        assert unit.sensor_changes.add(WORK, 2, Decision())
        assert not unit.sensor_changes.add(WORK, 2, Decision())
        assert unit.sensor_changes.newest(["V1"]) == {("V1", 2): AT}
    with pytest.raises(ConflictError, match="axle 2 of vehicle 'V1' has one of"), known.write() as unit:
        unit.sensor_changes.add(replace(WORK, axle=1), 2, Decision())
