"""Records of the registry are voided and restored, each decision kept, and what rests on them follows."""

from __future__ import annotations

from dataclasses import replace

import pytest
from due_geometries import INPUTS, see_geometries
from stored_values import measured_profiles, same

from bench.put_values import put_mountings
from estimation.errors import ConflictError, NotFoundError, ParameterError
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from fleet_db.records import Decision, RecordAction, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey

FROM, LATER, END = 1_000, 5_000, 9_000
WRONG, RIGHT = Decision("ada", "wrong wheelset", 77), Decision("ada", "it was right", 78)
MOUNTING = Mounting("W1", "V1", 1, FROM, None, 10.0, 20.0)
SECTION = TrackSectionRecord("S", 12, "section", "60E1", 0.05, 1.435, 3000.0)


@pytest.fixture
def known(storage: SqlStorage) -> SqlStorage:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("f", "F"))
        unit.registry.add_vehicle(VehicleRecord("V1", "f", "paper", 2, 40.0, (1.0, 3.0)))
        for serial in ("W1", "W2"):
            unit.registry.add_wheelset(WheelsetRecord(serial, "f", "P8", 0.46, None))
        unit.registry.add_mounting(MOUNTING)
        unit.tracks.add_section(SECTION)
        unit.stale_spans.remove(unit.stale_spans.all())
    return storage


def spans(unit: SqlUnitOfWork) -> list[tuple[str, int]]:
    return [(span.vehicle, span.from_ns) for span in unit.stale_spans.all()]


def actions(unit: SqlUnitOfWork, subject: str) -> list[tuple[str, str, str]]:
    return [(event.action, event.actor, event.reason) for event in unit.registry_history.list(subject)]


def test_a_voided_mounting_leaves_its_axle_to_another_and_is_restored_when_that_is_gone(known: SqlStorage) -> None:
    key = RecordKey(RecordKind.MOUNTING, "W1", FROM)
    with known.write() as unit:
        assert unit.corrections.void(key, WRONG)["vehicle_odometer_km"] == 10.0
    with known.read() as unit:
        assert unit.registry.mountings("W1") == []
        assert spans(unit) == [("V1", FROM)]
        assert actions(unit, "W1") == [("voided", "ada", "wrong wheelset")]
    other = replace(MOUNTING, wheelset="W2", from_ns=FROM + 1)
    with known.write() as unit:
        unit.registry.add_mounting(other)
    with pytest.raises(ConflictError, match="overlaps wheelset 'W2'"), known.write() as unit:
        unit.corrections.restore(key, RIGHT)
    with known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.MOUNTING, "W2", FROM + 1), WRONG)
        unit.corrections.restore(key, RIGHT)
        assert unit.registry.mountings("W1") == [MOUNTING]
    with pytest.raises(ConflictError, match="is on file"), known.write() as unit:
        unit.corrections.restore(key, RIGHT)
    with known.read() as unit:
        assert actions(unit, "W1") == [("voided", "ada", "wrong wheelset"), ("restored", "ada", "it was right")]
        (_, restored) = unit.registry_history.list("W1")
        assert (restored.recorded_ns, restored.at_ns, restored.record["axle"]) == (78, FROM, 1)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        (MOUNTING, []),
        (replace(MOUNTING, to_ns=END), [("V1", END, None)]),
        (replace(MOUNTING, axle=2), [("V1", FROM, None)]),
        (replace(MOUNTING, vehicle_odometer_km=11.0, to_ns=END), [("V1", FROM, END), ("V1", FROM, None)]),
    ],
)
def test_a_changed_mounting_makes_stale_what_it_changes_and_no_more(
    known: SqlStorage, after: Mounting, expected: list[tuple[str, int, int | None]]
) -> None:
    latest = 1 << 62
    with known.write() as unit:
        unit.registry.add_mounting(after, recorded_ns=5)
    with known.read() as unit:
        found = [(span.vehicle, span.from_ns, span.to_ns) for span in unit.stale_spans.all()]
        assert sorted(found) == [(vehicle, a, latest if b is None else b) for vehicle, a, b in expected]
        assert len(actions(unit, "W1")) == bool(expected)
        for event in unit.registry_history.list("W1"):
            assert Mounting(**event.record) == MOUNTING  # type: ignore[arg-type]  # JSON


def test_two_mountings_that_were_exchanged_are_put_right_together(known: SqlStorage) -> None:
    second = replace(MOUNTING, wheelset="W2", axle=2)
    exchanged = [replace(MOUNTING, axle=2), replace(second, axle=1)]
    with known.write() as unit:
        unit.registry.add_mounting(second)
        put_mountings(unit, exchanged)
        assert [unit.registry.mounting_at("V1", axle, LATER) for axle in (2, 1)] == exchanged
        put_mountings(unit, [MOUNTING, second])
        assert [unit.registry.mounting_at("V1", axle, LATER) for axle in (1, 2)] == [MOUNTING, second]
    with pytest.raises(ConflictError, match="overlaps"), known.write() as unit:
        put_mountings(unit, [replace(MOUNTING, axle=2)])


def test_reprofilings_and_measurements_are_voided_and_restored_as_they_were(known: SqlStorage) -> None:
    turned = Reprofiling("W1", LATER, 300.0, "lathe 2")
    measured = replace(measured_profiles(LATER), wheelset="W1")
    with known.write() as unit:
        unit.registry.add_reprofiling(turned)
        unit.registry.add_measured_profiles(measured)
    keys = [RecordKey(kind, "W1", LATER) for kind in (RecordKind.REPROFILING, RecordKind.MEASUREMENT)]
    with known.write() as unit:
        see_geometries(unit)
        for key in keys:
            unit.corrections.void(key, WRONG)
        assert "W1" in unit.marks.due(INPUTS, 0)
        assert unit.registry.wheelset("W1").reprofilings == ()
        assert unit.registry.measured_profiles("W1") == []
        for key in keys:
            with pytest.raises(NotFoundError):
                unit.corrections.void(key, WRONG)
    with known.write() as unit:
        for key in keys:
            unit.corrections.restore(key, RIGHT)
        assert unit.registry.wheelset("W1").reprofilings == (turned,)
        (after,) = unit.registry.measured_profiles("W1")
        assert same(after, measured)


def test_a_voided_section_gives_its_number_up(known: SqlStorage) -> None:
    key = RecordKey(RecordKind.SECTION, "S")
    with known.write() as unit:
        unit.corrections.void(key, WRONG)
        assert unit.tracks.sections() == []
        assert unit.tracks.section_by_number(12) is None
        with pytest.raises(NotFoundError):
            unit.corrections.void(key, WRONG)
        unit.tracks.add_section(replace(SECTION, code="T"))
    with pytest.raises(ConflictError, match="already has number 12"), known.write() as unit:
        unit.corrections.restore(key, RIGHT)
    with known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.SECTION, "T"), WRONG)
        unit.corrections.restore(key, RIGHT)
        assert unit.tracks.sections() == [SECTION]


def test_a_wheelset_is_voided_when_it_is_mounted_nowhere(known: SqlStorage) -> None:
    key = RecordKey(RecordKind.WHEELSET, "W1")
    with pytest.raises(ConflictError, match="void its mountings first"), known.write() as unit:
        unit.corrections.void(key, WRONG)
    with known.write() as unit:
        unit.corrections.void(RecordKey(RecordKind.MOUNTING, "W1", FROM), WRONG)
        unit.corrections.void(key, WRONG)
    with known.read() as unit:
        assert [one.serial for one in unit.registry.wheelsets_of(["W1", "W2"], voided=False)] == ["W2"]
    with known.write() as unit:  # a registry file that still has it
        unit.registry.add_wheelset(WheelsetRecord("W1", "f", "P8", 0.46, None), 99)
        assert [one.serial for one in unit.registry.wheelsets_of(["W1", "W2"], voided=False)] == ["W1", "W2"]
        assert actions(unit, "W1")[-1][0] == RecordAction.RESTORED


@pytest.mark.parametrize(
    ("key", "decision", "field"),
    [
        (RecordKey(RecordKind.MOUNTING, "W1", FROM), Decision("ada", " ", 1), "reason"),
        (RecordKey(RecordKind.MOUNTING, "W1"), WRONG, "at"),
    ],
)
def test_a_decision_without_a_reason_or_a_time_is_none(
    known: SqlStorage, key: RecordKey, decision: Decision, field: str
) -> None:
    with pytest.raises(ParameterError) as caught, known.write() as unit:
        unit.corrections.void(key, decision)
    assert caught.value.field == field
