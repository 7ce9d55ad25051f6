"""What windows are estimated with besides their samples, read together, and each change of it noticed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bogie_run import of_bogie
from executed_statements import executed_statements
from test_load_window import SECOND, register, window

from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.load_window import WindowInputs, WindowLoader, inputs_of_batch
from estimation.values.quantities import Status
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
from estimation.values.windows import Window, WindowKey, WindowPosition
from fleet_db.storage import SqlStorage, SqlUnitOfWork

BOGIE_CLASS = replace(of_bogie(2.5e6), code="bogie")
START, LATER = 60 * SECOND, 120 * SECOND
KEYS = [("W1", START), ("W1", LATER), ("W2", START)]
SECTION = TrackSectionRecord("S", 1, "a section", "56E1", 0.05, 1.435, 1000.0)


@pytest.fixture
def bogie(sqlite_storage: SqlStorage) -> SqlStorage:
    """Return a bogie with a window of both axles, and a later one of the first alone."""
    with sqlite_storage.write() as unit:
        unit.tracks.add_section(SECTION)
        unit.registry.add_vehicle_class(BOGIE_CLASS, 1)
    windows = [window(1, track_section="S"), window(1, track_section="S", start_ns=LATER), window(2)]
    register(sqlite_storage, windows)
    return sqlite_storage


def inputs(storage: SqlStorage) -> dict[WindowKey, WindowInputs]:
    with storage.read() as unit:
        records = unit.windows.several(KEYS)
        return dict(inputs_of_batch(unit, records, ClassLookup(unit, EstimationSettings())).found)


def test_inputs_are_those_of_each_window(bogie: SqlStorage) -> None:
    found = inputs(bogie)
    with bogie.read() as unit:
        digests = {record.key: record.content_digest for record in unit.windows.several(KEYS)}
    assert [found[key].partner for key in KEYS] == [digests["W2", START], None, digests["W1", START]]
    assert [one.mounting.wheelset for one in found.values() if one.mounting is not None] == ["W1", "W1", "W2"]
    assert {one.position for one in found.values()} == {one.layout for one in found.values()} == {None}


def put_position(unit: SqlUnitOfWork) -> None:
    unit.tracks.put_positions([WindowPosition("W1", START, "d" * 64, 1, 2.5)])


def put_layout(unit: SqlUnitOfWork) -> None:
    unit.tracks.add_layout(TrackLayout("S", 0, np.array([0.0, 1000.0]), np.zeros(2), np.zeros(2)))


def put_class(unit: SqlUnitOfWork) -> None:
    unit.registry.add_vehicle_class(replace(BOGIE_CLASS, name="another"), 2)


def put_radius(unit: SqlUnitOfWork) -> None:
    unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", 0.46, None), 2)


def turn(unit: SqlUnitOfWork) -> None:
    unit.registry.add_mounting(Mounting("W2", "V", 2, 0, None, 0.0, 0.0, reversed=True))


def put_samples(unit: SqlUnitOfWork) -> None:
    unit.windows.put(window(1, track_section="S", speed=np.full(500, 21.0)), 10.0, 2)


@pytest.mark.parametrize(
    ("change", "noticed_by"),
    [
        (put_position, {("W1", START)}),
        (put_layout, {("W1", START), ("W1", LATER)}),
        (put_class, set(KEYS)),
        (put_radius, {("W1", START), ("W1", LATER)}),
        (turn, {("W2", START)}),
        (put_samples, {("W2", START)}),  # of which they are the partner's
    ],
)
def test_every_change_is_noticed_by_the_windows_that_it_concerns(
    bogie: SqlStorage, change: Callable[[SqlUnitOfWork], None], noticed_by: set[WindowKey]
) -> None:
    before = inputs(bogie)
    with bogie.write() as unit:
        change(unit)
    after = inputs(bogie)
    assert {key for key in KEYS if before[key] != after[key]} == noticed_by


def test_mountings_end_before_their_last_moment(bogie: SqlStorage) -> None:
    with bogie.write() as unit:
        unit.registry.add_mounting(Mounting("W1", "V", 1, 0, LATER, 0.0, 0.0))
        places = [("V", 1, -1), ("V", 1, 0), ("V", 1, LATER - 1), ("V", 1, LATER), ("V", 2, LATER), ("X", 1, 0)]
        absent = [unit.registry.mounting_at(*place) is None for place in places]
    assert absent == [True, False, False, True, False, True]


def test_the_samples_of_a_bogie_are_read_once_for_both_of_its_axles(bogie: SqlStorage) -> None:
    with bogie.read() as unit:
        records = {record.key: record for record in unit.windows.several(KEYS)}
        loader = WindowLoader(unit, records)
        front = loader.load(records["W1", START], BOGIE_CLASS)
        for path in (bogie.data_dir / "windows").rglob("*.window"):
            path.unlink()
        rear = loader.load(records["W2", START], BOGIE_CLASS)
    assert isinstance(front, Window)
    assert isinstance(rear, Window)
    np.testing.assert_array_equal(front.frame_yaw_acceleration, rear.frame_yaw_acceleration)


def test_statements_do_not_grow_with_the_windows_of_a_batch(bogie: SqlStorage) -> None:
    def statements(keys: list[WindowKey]) -> int:
        with bogie.read() as unit:
            records = unit.windows.several(keys)
            with executed_statements() as executed:
                batch = inputs_of_batch(unit, records, ClassLookup(unit, EstimationSettings()))
                for record in records:
                    batch.alignment(record)
                    batch.layout(record)
        return len(executed)

    assert statements(KEYS[:1]) <= 12
    assert statements(KEYS[:2]) == statements(KEYS[:1]) <= 8  # what is on file was read before


def test_windows_are_estimated_on_the_alignment_in_force_or_that_of_their_epoch(bogie: SqlStorage) -> None:
    alignment = TrackAlignment("S", 0, np.arange(3.0), *np.zeros((4, 3)), np.zeros(3, int), Status.ESTIMATED)
    with bogie.write() as unit:
        for shift in (0.0, 1e-3):
            unit.tracks.add_alignment(replace(alignment, alignment=alignment.alignment + shift))
        records = unit.windows.several(KEYS)
        found = inputs_of_batch(unit, records, ClassLookup(unit, EstimationSettings()))
        versions = [None if (one := found.alignment(record)) is None else one.version for record in records]
        assert versions == [2, 2, None]  # the last is of no section
        former = replace(found, versions={KEYS[0]: 1, KEYS[1]: None})
        first, second = (former.alignment(record) for record in records[:2])
    assert first is not None
    assert (first.version, second) == (1, None)
