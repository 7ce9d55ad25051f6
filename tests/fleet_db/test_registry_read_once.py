"""What a process has read of the registry is read again once the registry has changed, and not before."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import pytest
from sqlalchemy import insert

from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import Facet, SubjectKind
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from fleet_db.subjects import BRANCHES, KeptRecords
from tests.executed_statements import executed_statements

RADIUS_M = 0.46


@pytest.fixture
def known(storage: SqlStorage) -> SqlStorage:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("f", "F"))
        unit.registry.add_vehicle(VehicleRecord("V1", "f", "coach", 2, 40.0, (1.0, 3.0)))
        unit.registry.add_wheelset(WheelsetRecord("W1", "f", "P8", RADIUS_M, None))
        unit.registry.add_mounting(Mounting("W1", "V1", 1, 1_000, None, 10.0, 20.0))
    return storage


def radius(unit: SqlUnitOfWork) -> float:
    return unit.registry.wheelset("W1").nominal_radius_m


def change(unit: SqlUnitOfWork, radius_m: float) -> None:
    unit.registry.add_wheelset(WheelsetRecord("W1", "f", "P8", radius_m, None))


def statements(storage: SqlStorage) -> Sequence[str]:
    with executed_statements() as executed, storage.read() as unit:
        unit.registry.wheelset("W1")
        unit.registry.vehicle("V1")
        unit.registry.mountings_on("V1", 0, 2_000)
        unit.registry.mountings("W1")
    return [one for one in executed if not one.startswith("BEGIN")]


def test_one_statement_asks_whether_the_registry_has_changed_and_the_rest_is_remembered(known: SqlStorage) -> None:
    assert len(statements(known)) == 5
    assert len(statements(known)) == 1
    assert len(statements(replace(known, kept=KeptRecords()))) == 5


def test_a_change_by_another_process_is_seen_by_the_next_transaction(known: SqlStorage) -> None:
    other = replace(known, kept=KeptRecords())
    with known.read() as before:
        assert radius(before) == RADIUS_M
        with other.write() as unit:
            change(unit, 0.45)
        with known.read() as after:
            assert radius(after) == 0.45
        assert radius(before) == RADIUS_M  # it sees one snapshot
    with known.read() as unit:
        assert radius(unit) == 0.45


def test_what_is_not_committed_is_seen_by_its_own_transaction_alone(known: SqlStorage) -> None:
    with known.read() as unit:
        assert radius(unit) == RADIUS_M
    seen = []
    with suppress(ZeroDivisionError), known.write() as unit:
        change(unit, 0.45)
        seen.append(radius(unit))
        raise ZeroDivisionError
    assert seen == [0.45]
    with known.read() as unit:
        assert radius(unit) == RADIUS_M


def test_a_row_of_the_worklist_is_of_what_another_process_has_changed_meanwhile(known: SqlStorage) -> None:
    with known.write() as unit:
        unit.worklist.refresh(["W1"])
    with replace(known, kept=KeptRecords()).write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("W1", "f", "other profile", RADIUS_M, None))
    with known.write() as unit:
        unit.worklist.refresh(["W1"])
    with known.read() as unit:
        assert "other profile" in unit.worklist.row("W1")


def test_a_restored_database_is_read_again_even_with_the_same_number_of_changes(known: SqlStorage) -> None:
    with known.read() as unit:
        assert radius(unit) == RADIUS_M
    with known.write() as unit:  # as a restore does, which changes records without a trace
        unit.connection.exec_driver_sql("UPDATE wheelsets SET nominal_radius_m = 0.45")
        row = {"branch_id": 2, "identity": "of the restore", "after_sequence": 0, "began_ns": 1}
        unit.connection.execute(insert(BRANCHES).values(**row))
    with known.read() as unit:
        assert radius(unit) == 0.45


def test_who_does_not_see_all_fleets_neither_uses_nor_adds_to_what_was_read(known: SqlStorage) -> None:
    with known.read() as unit:
        assert radius(unit) == RADIUS_M
    with known.seen_by(frozenset({"other"})).read() as unit:
        assert not unit.registry.wheelsets_of(["W1"])
    with known.read() as unit:
        assert radius(unit) == RADIUS_M


def test_a_mounting_that_is_voided_is_seen_by_the_versions_of_its_vehicle(known: SqlStorage) -> None:
    key = RecordKey(RecordKind.MOUNTING, "W1", 1_000)
    subjects, facets = {(SubjectKind.VEHICLE, "V1")}, [Facet.REGISTRY]
    with known.read() as unit:
        own, beside = unit.marks.versions(subjects, ["V1"], facets)
    with known.write() as unit:
        unit.corrections.void(key, Decision("ada", "never mounted", 77))
    with known.read() as unit:
        now = unit.marks.versions(subjects, ["V1"], facets)
    # the wheelset is not beside it any more: the sum of both could be the same
    assert now[0] > own
    assert now[1] == 0 < beside
