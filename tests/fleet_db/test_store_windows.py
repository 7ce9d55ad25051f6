"""Windows, their bin tables, and which wheelsets they make stale: the same on both databases."""

from __future__ import annotations

import math
from dataclasses import replace
from threading import Thread

import pytest
import stored_values as make
from due_geometries import due_geometries, see_geometries
from same_values import same_values
from waiting_windows import waiting_windows

from api.schemas import windows
from bench.put_values import put_geometry, put_table
from estimation.errors import ConflictError, NotFoundError, StorageError
from estimation.values.geometry import WindowTable
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Reprofiling
from estimation.values.windows import WindowMark, WindowState
from fleet_db.storage import SqlStorage
from fleet_db.telemetry import WindowFiles, window_digest

SLOW = Reason(ReasonCode.NOT_MOVING, "too slow")


def put(storage: SqlStorage, *indices: int) -> None:
    with storage.write() as unit:
        for index in indices:
            assert unit.windows.put(make.window(index), 10.0 + index, 50)


def estimate(storage: SqlStorage, index: int, seed: int = 0) -> None:
    window = make.window(index)
    with storage.write() as unit:
        digest = window_digest(window)
        put_table(unit, "WS-1", window.start_ns, make.bin_table(seed), 3, digest)
        unit.windows.mark("WS-1", window.start_ns, WindowState.ESTIMATED)


def test_every_reason_code_is_stored_and_served_as_it_is(fleet: SqlStorage) -> None:
    put(fleet, 0)
    start_ns = make.window(0).start_ns
    for code in ReasonCode:
        reason = Reason(code, f"a sentence about {code.value}")
        with fleet.write() as unit:
            unit.windows.mark("WS-1", start_ns, WindowState.REFUSED, reason)
            record = unit.windows.get("WS-1", start_ns)
        assert record is not None
        assert record.reason == reason
        served = windows.window(record, record.reason).model_dump(mode="json")
        assert (served["reason_code"], served["reason"]) == (code.value, reason.text)


def mark_estimated(storage: SqlStorage) -> None:
    """Record a geometry of every stale wheelset."""
    with storage.write() as unit:
        for serial in due_geometries(unit):
            put_geometry(unit, make.geometry_record(wheelset=serial))
        see_geometries(unit)


def stale(storage: SqlStorage) -> list[str]:
    with storage.read() as unit:
        return due_geometries(unit)


def test_a_window_comes_back_with_its_record(fleet: SqlStorage) -> None:
    put(fleet, 0)
    window = make.window(0)
    with fleet.read() as unit:
        assert same_values(unit.windows.load("WS-1", window.start_ns), window)
        (record,) = unit.windows.list("WS-1")
        assert record.quality == window.quality
        assert (record.state, record.reason, record.mileage_km) == (WindowState.PENDING, None, 10.0)
        assert record.content_digest == window_digest(window)
        assert record.recorded_ns == 50
        assert unit.windows.latest("WS-1") == record
        assert unit.windows.latest("WS-2") is None


def test_the_same_content_changes_nothing(fleet: SqlStorage) -> None:
    put(fleet, 0)
    estimate(fleet, 0)
    mark_estimated(fleet)
    with fleet.write() as unit:
        assert not unit.windows.put(make.window(0), 10.0, 99)
    with fleet.read() as unit:
        (record,) = unit.windows.list("WS-1")
        assert (record.state, record.recorded_ns) == (WindowState.ESTIMATED, 50)
        assert len(list(unit.tables.stream("WS-1", 0, None))) == 1
    assert stale(fleet) == []


def test_a_lost_sample_file_is_made_again(fleet: SqlStorage) -> None:
    put(fleet, 0)
    path = WindowFiles(fleet.data_dir / "windows").path(window_digest(make.window(0)))
    path.write_bytes(b"")
    with fleet.read() as unit, pytest.raises(StorageError, match=path.name):
        unit.windows.load("WS-1", make.START)
    with fleet.write() as unit:
        assert not unit.windows.put(make.window(0), 10.0, 99)
        assert same_values(unit.windows.load("WS-1", make.START), make.window(0))


def test_other_content_is_pending_again_without_a_bin_table(fleet: SqlStorage) -> None:
    put(fleet, 0)
    estimate(fleet, 0)
    mark_estimated(fleet)
    other = make.window(0, seed=1)
    with fleet.write() as unit:
        assert unit.windows.put(other, 10.0, 99)
    with fleet.read() as unit:
        (record,) = waiting_windows(unit)
        assert (record.content_digest, record.recorded_ns) == (window_digest(other), 99)
        assert list(unit.tables.stream("WS-1", 0, None)) == []
        assert same_values(unit.windows.load("WS-1", make.START), other)
    assert stale(fleet) == ["WS-1"]


def test_another_mileage_keeps_the_bin_table(fleet: SqlStorage) -> None:
    put(fleet, 0)
    estimate(fleet, 0)
    mark_estimated(fleet)
    with fleet.write() as unit:
        assert unit.windows.put(make.window(0), 11.5, 99)
    with fleet.read() as unit:
        ((record, _, _),) = unit.tables.stream("WS-1", 0, None)
        assert (record.mileage_km, record.state) == (11.5, WindowState.ESTIMATED)
    assert stale(fleet) == ["WS-1"]


def test_unknown_quality_is_null_and_comes_back_as_nan(fleet: SqlStorage) -> None:
    quality = replace(make.window().quality, speed_min_m_s=math.nan, speed_max_m_s=math.nan)
    with fleet.write() as unit:
        unit.windows.put(make.window(quality=quality), 1.0, 1)
    with fleet.engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT speed_min_m_s FROM windows").scalar() is None
    with fleet.read() as unit:
        (record,) = unit.windows.list("WS-1")
        assert math.isnan(record.quality.speed_min_m_s)
        assert record.quality.coverage == quality.coverage


def test_lists_and_pages_in_the_order_of_time(fleet: SqlStorage) -> None:
    put(fleet, 3, 0, 2, 1)
    starts = [make.START + index * make.LENGTH for index in range(4)]
    with fleet.read() as unit:
        windows = unit.windows
        assert [one.start_ns for one in windows.list("WS-1")] == starts
        assert [one.start_ns for one in windows.list("WS-1", starts[1], starts[3])] == starts[1:3]
        assert [one.start_ns for one in windows.page("WS-1", None, 3)] == starts[:3]
        assert [one.start_ns for one in windows.page("WS-1", starts[2], 3)] == starts[3:]
        assert windows.counts() == {"pending": 4, "estimated": 0, "refused": 0}
    with fleet.write() as unit:
        unit.windows.mark("WS-1", starts[0], WindowState.REFUSED, SLOW)
    with fleet.read() as unit:
        assert unit.windows.counts() == {"pending": 3, "estimated": 0, "refused": 1}
        assert unit.windows.list("WS-1")[0].reason == SLOW
        assert [one.start_ns for one in waiting_windows(unit)] == starts[1:]


def test_bin_tables_stream_in_the_order_of_time(fleet: SqlStorage) -> None:
    put(fleet, *range(4))
    for index in (2, 0, 1):
        estimate(fleet, index, seed=index)
    with fleet.read() as unit:
        found = list(unit.tables.stream("WS-1", make.START, make.START + 2 * make.LENGTH))
        assert [record.start_ns for record, _, _ in found] == [make.START, make.START + make.LENGTH]
        assert all(make.same(table, make.bin_table(seed)) for seed, (_, table, _) in enumerate(found))
        assert {version for _, _, version in found} == {3}
        assert len(list(unit.tables.stream("WS-1", 0, None))) == 3
        assert list(unit.tables.stream("WS-2", 0, None)) == []


def test_tables_and_states_of_several_windows_are_stored_together(fleet: SqlStorage) -> None:
    put(fleet, *range(5))
    estimate(fleet, 0)
    estimate(fleet, 1)
    estimate(fleet, 4)
    mark_estimated(fleet)
    starts = [make.window(index).start_ns for index in range(5)]
    keys = [("WS-1", start_ns) for start_ns in starts]
    with fleet.write() as unit:
        records = unit.windows.several([*reversed(keys), ("WS-1", 5)], held=True)
        assert [record.key for record in records] == keys
        tables = [
            WindowTable(*record.key, record.content_digest, make.bin_table(seed), version)
            for record, seed, version in zip(records, (0, 7, 2, 3), (3, 3, 3, None), strict=False)
        ]
        unit.tables.put_all(tables)  # the same, another one, and two new ones
        states = (WindowState.ESTIMATED, WindowState.PENDING, WindowState.ESTIMATED, WindowState.ESTIMATED)
        marks = [WindowMark(*key, state) for key, state in zip(keys, states, strict=False)]
        marks.append(WindowMark(*keys[4], WindowState.REFUSED, SLOW))
        assert unit.windows.mark_all(marks) == marks
    with fleet.read() as unit:
        found = {record.start_ns: (table, version) for record, table, version in unit.tables.stream("WS-1", 0, None)}
        assert list(found) == starts[:4]  # a refused window loses its own
        for one in tables:
            assert make.same(found[one.start_ns], (one.table, one.track_version))
        assert [record.state for record in unit.windows.several(keys)] == [mark.state for mark in marks]
        assert [record.reason for record in unit.windows.several(keys)] == [mark.reason for mark in marks]
    assert stale(fleet) == ["WS-1"]


def test_nothing_is_stored_of_several_windows_where_one_is_unknown_or_another(fleet: SqlStorage) -> None:
    put(fleet, 0, 1)
    digest = window_digest(make.window(0))
    good = WindowTable("WS-1", make.START, digest, make.bin_table(), 3)
    for bad, error in (
        (replace(good, start_ns=make.window(1).start_ns), ConflictError),
        (replace(good, start_ns=5), NotFoundError),
    ):
        with pytest.raises(error), fleet.write() as unit:
            unit.tables.put_all([good, bad])
    with pytest.raises(NotFoundError), fleet.write() as unit:
        unit.windows.mark_all([WindowMark("WS-1", start_ns, WindowState.ESTIMATED) for start_ns in (make.START, 5)])
    with fleet.read() as unit:
        assert list(unit.tables.stream("WS-1", 0, None)) == []
        assert unit.windows.counts()["pending"] == 2
        assert unit.windows.several([]) == []


def test_a_window_that_is_held_is_not_replaced_until_the_transaction_has_ended(fleet: SqlStorage) -> None:
    put(fleet, 0)
    done: list[bool] = []

    def replaced() -> None:
        with fleet.write() as unit:
            done.append(unit.windows.put(make.window(0, seed=9), 10.0, 60))

    with fleet.write() as unit:
        unit.windows.several([("WS-1", make.START)], held=True)
        other = Thread(target=replaced)
        other.start()
        other.join(0.3)
        assert not done
    other.join()
    assert done == [True]


def test_a_bin_table_of_replaced_content_is_refused(fleet: SqlStorage) -> None:
    put(fleet, 0)
    with pytest.raises(ConflictError, match="was replaced while it was estimated"), fleet.write() as unit:
        put_table(unit, "WS-1", make.START, make.bin_table(), None, "0" * 64)


def test_a_refused_window_loses_its_bin_table(fleet: SqlStorage) -> None:
    put(fleet, 0)
    estimate(fleet, 0)
    mark_estimated(fleet)
    with fleet.write() as unit:
        unit.windows.mark("WS-1", make.START, WindowState.REFUSED, SLOW)
        assert list(unit.tables.stream("WS-1", 0, None)) == []
    assert stale(fleet) == ["WS-1"]


def test_what_makes_a_wheelset_stale(fleet: SqlStorage) -> None:
    put(fleet, 0)
    assert stale(fleet) == []  # a pending window says nothing yet
    estimate(fleet, 0)
    assert stale(fleet) == ["WS-1"]
    mark_estimated(fleet)
    estimate(fleet, 0)  # the same again
    assert stale(fleet) == []
    estimate(fleet, 0, seed=5)
    assert stale(fleet) == ["WS-1"]
    mark_estimated(fleet)  # the record is the same as before, and yet it was looked at
    assert stale(fleet) == []
    with fleet.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("WS-1", 5, 1.0))
        unit.registry.add_reprofiling(Reprofiling("WS-2", 5, 1.0))  # of which nothing is known
        assert due_geometries(unit) == ["WS-1"]  # inside the same transaction too
    assert stale(fleet) == ["WS-1"]
    for expected in (["WS-1"], []):  # the second time the same again
        mark_estimated(fleet)
        with fleet.write() as unit:
            unit.registry.add_measured_profiles(make.measured_profiles(make.START))
        assert stale(fleet) == expected


def test_the_unknown_is_named(fleet: SqlStorage) -> None:
    with pytest.raises(NotFoundError, match="no wheelset 'WS-9'"), fleet.write() as unit:
        unit.windows.put(make.window(wheelset="WS-9"), 1.0, 1)
    with pytest.raises(ConflictError), fleet.write() as unit:
        unit.windows.put(make.window(track_section="S-9"), 1.0, 1)
    with fleet.read() as unit, pytest.raises(NotFoundError, match="no window 'WS-1@5'"):
        unit.windows.load("WS-1", 5)
    with pytest.raises(NotFoundError, match="no window 'WS-1@5'"), fleet.write() as unit:
        unit.windows.mark("WS-1", 5, WindowState.REFUSED, SLOW)
    with pytest.raises(NotFoundError, match="no window 'WS-1@5'"), fleet.write() as unit:
        put_table(unit, "WS-1", 5, make.bin_table(), None, "")
    with fleet.read() as unit:
        assert unit.windows.counts() == {"pending": 0, "estimated": 0, "refused": 0}


def test_every_window_of_a_section_can_wait_again(fleet: SqlStorage) -> None:
    put(fleet, 0, 1, 2)  # the third waits already
    estimate(fleet, 0)
    first, second = (make.window(index) for index in range(2))
    with fleet.write() as unit:
        unit.windows.mark("WS-1", second.start_ns, WindowState.REFUSED, SLOW)
        section = first.track_section
        assert section is not None
        unit.windows.estimate_again("S-other")
        assert unit.windows.counts()["pending"] == 1
        unit.windows.estimate_again(section)
        found = unit.windows.get("WS-1", first.start_ns)
        assert found is not None
        assert (found.state, found.reason) == (WindowState.PENDING, None)
