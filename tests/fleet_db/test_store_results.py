"""Geometries and trends are appended and reproducible; receipts, runs, keys: the same on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import stored_values as make

from bench.put_values import put_geometry, put_trend
from estimation.errors import ConflictError, NotFoundError, ParameterError
from estimation.values.geometry import COMBINATIONS, BinStatus, GeometryRecord
from estimation.values.runs import JobOutcome, JobTrigger
from estimation.values.trend import TREND
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from fleet_db.stores.results import _as_of

DAY = 86_400 * 10**9
HOUR = 3600 * 10**9


def put(storage: SqlStorage, *records: GeometryRecord) -> list[bool]:
    with storage.write() as unit:
        return [put_geometry(unit, record) for record in records]


def test_a_geometry_comes_back_bit_for_bit(fleet: SqlStorage) -> None:
    record = make.geometry_record()
    assert put(fleet, record) == [True]
    with fleet.read() as unit:
        assert make.same(unit.geometries.current("WS-1"), record)
        assert unit.geometries.current("WS-2") is None
        assert unit.geometries.intervals("WS-1") == []


def test_the_same_inputs_are_not_appended_again(fleet: SqlStorage) -> None:
    first = make.geometry_record()
    later = replace(first, recorded_ns=200)
    changes = [{"input_digest": "b" * 64}, {"parameters": {"forgetting": 0.6}}, {"code_version": "0.2.0"}]
    assert put(fleet, first, later) == [True, False]
    assert put(fleet, *[replace(later, **change) for change in changes]) == [True] * 3
    assert put(fleet, first) == [True]  # what it was before is a change too


def test_what_was_recorded_then_then(fleet: SqlStorage) -> None:
    old, new = make.geometry_record(1, 100), make.geometry_record(2, 200)
    turned = make.geometry_record(3, 300, baseline=1)
    late = make.geometry_record(4, 400)  # data of the first baseline that came late
    put(fleet, old)
    with fleet.read() as unit:
        recorded_then = unit.geometries.current("WS-1", 150)
    put(fleet, new, turned, late)
    with fleet.read() as unit:
        at = unit.geometries.current
        assert make.same(at("WS-1", 150), recorded_then)
        assert [at("WS-1", time) for time in (99,)] == [None]
        for time, record in ((100, old), (199, old), (200, new), (300, turned), (400, turned), (None, turned)):
            assert make.same(at("WS-1", time), record), time


def test_intervals_give_the_newest_of_each(fleet: SqlStorage) -> None:
    records = [
        make.geometry_record(1, 100, interval=2),
        make.geometry_record(2, 110, interval=1),
        make.geometry_record(3, 120, interval=1),
        make.geometry_record(4, 130, interval=0, baseline=1),
        make.geometry_record(5, 140),
    ]
    assert put(fleet, *records) == [True] * 5
    with fleet.read() as unit:
        all_of_them = unit.geometries.intervals("WS-1")
        assert make.same(tuple(all_of_them), (records[2], records[0], records[3]))
        assert make.same(tuple(unit.geometries.intervals("WS-1", 0, 115)), (records[1], records[0]))
        assert make.same(tuple(unit.geometries.intervals("WS-1", baseline=1)), (records[3],))


def test_a_clock_that_went_back_does_not_hide_the_newest(fleet: SqlStorage) -> None:
    put(fleet, make.geometry_record(1, 500), make.geometry_record(2, 400))
    with fleet.read() as unit:
        found = unit.geometries.current("WS-1")
        assert found is not None
        assert (found.input_digest, found.recorded_ns) == (make.geometry_record(2).input_digest, 500)


def recorded(fleet: SqlStorage) -> list[int]:
    """Return the recorded times of the three results that are put first."""
    with fleet.read() as unit:
        found = [unit.geometries.current("WS-1"), *unit.geometries.intervals("WS-1"), unit.trends.latest("WS-1")]
        return [one.recorded_ns for one in found if one is not None]


def put_all(fleet: SqlStorage, day: int, recorded_ns: int) -> None:
    put(fleet, make.geometry_record(day, recorded_ns), make.geometry_record(day, recorded_ns, interval=4))
    with fleet.write() as unit:
        put_trend(unit, make.trend_record(day, recorded_ns))


@pytest.mark.parametrize("wrong_by", [1, HOUR, 400 * DAY])
def test_results_of_a_clock_that_was_ahead_count_as_recorded_once_it_is_right(fleet: SqlStorage, wrong_by: int) -> None:
    put_all(fleet, 1, 10 * DAY + wrong_by)
    with fleet.write() as unit:
        assert unit.recorded_times.correct(10 * DAY) == 3
        assert unit.recorded_times.correct(10 * DAY) == 0
    assert recorded(fleet) == [10 * DAY] * 3
    put_all(fleet, 2, 10 * DAY + 5)
    for as_of, expected in ((10 * DAY - 1, None), (10 * DAY, 1), (10 * DAY + 4, 1), (10 * DAY + 5, 2), (None, 2)):
        with fleet.read() as unit:
            geometry, trend = unit.geometries.current("WS-1", as_of), unit.trends.latest("WS-1", as_of)
        digests = [None if one is None else one.input_digest for one in (geometry, trend)]
        assert digests == [None if expected is None else make.geometry_record(expected).input_digest] * 2, as_of


@pytest.mark.parametrize(("behind", "corrected"), [(DAY, 3), (DAY + 1, 0)])
def test_a_clock_that_is_behind_the_vehicles_rewrites_no_history(
    fleet: SqlStorage, behind: int, corrected: int
) -> None:
    """A server that boots in 1970 is the one that is wrong; a vehicle that is ahead of its receipt says nothing."""
    decoded = replace(make.CHUNK, state=ChunkState.DECODED, first_ns=0, received_ns=10 * DAY)
    measured = replace(decoded, last_ns=10 * DAY)
    ahead = replace(decoded, digest="b" * 64, last_ns=11 * DAY + 1)
    put_all(fleet, 1, 11 * DAY)
    with fleet.write() as unit:
        assert [unit.chunks.put(one) for one in (measured, ahead)] == [True, True]
        assert unit.recorded_times.correct(10 * DAY - behind) == corrected
    put_all(fleet, 2, 10 * DAY - behind)
    assert recorded(fleet) == [10 * DAY - behind if corrected else 11 * DAY] * 3


def test_current_bins_are_plain_rows(fleet: SqlStorage) -> None:
    put(fleet, make.geometry_record(1, 100), make.geometry_record(2, 200, baseline=1))
    put(fleet, make.geometry_record(3, 300), make.geometry_record(4, 300, interval=4))  # neither is the current one
    geometry = make.geometry(2)
    with fleet.engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT * FROM wheelset_bins ORDER BY bin").mappings().all()
    assert len(rows) == len(geometry.samples)
    for name in COMBINATIONS:
        unit = "rad" if "angle" in name else "m"
        values = getattr(geometry, name)
        for row, value, std, status in zip(rows, values.value, values.std, values.status, strict=True):
            assert row[f"{name}_status"] == status
            known = status is BinStatus.ESTIMATED
            assert row[f"{name}_{unit}"] == (value if known else None)
            assert row[f"{name}_std_{unit}"] == (std if known else None)
    np.testing.assert_array_equal([row["lateral_displacement_high_m"] for row in rows], geometry.bin_edges[1:])


def test_nan_in_the_parameters_is_refused(fleet: SqlStorage) -> None:
    with pytest.raises((ParameterError, ValueError)):
        put(fleet, make.geometry_record(parameters={"forgetting": float("nan")}))


def test_trends_are_appended_and_reproducible(fleet: SqlStorage) -> None:
    old, new, turned = (make.trend_record(1, 100), make.trend_record(2, 200), make.trend_record(3, 300, baseline=1))
    with fleet.write() as unit:
        trends = (old, replace(old, recorded_ns=150), new, turned)
        assert [put_trend(unit, one) for one in trends] == [True, False, True, True]
    with fleet.read() as unit:
        assert unit.trends.latest("WS-1", 99) is None
        assert make.same(unit.trends.latest("WS-1", 199), old)
        assert make.same(unit.trends.latest("WS-1", 200), new)
        assert make.same(unit.trends.latest("WS-1"), turned)


def test_a_trend_of_another_quantity_is_the_newest_once_put_whatever_the_clock_says(fleet: SqlStorage) -> None:
    at_3_mm = make.trend_record(1, 200)
    quantity = "equivalent_conicity_2.75_mm"
    of_another = replace(at_3_mm.trend, quantity=quantity)
    other = replace(at_3_mm, trend=of_another, input_digest="d" * 64, recorded_ns=100)
    with fleet.write() as unit:
        assert [put_trend(unit, one) for one in (at_3_mm, other)] == [True, True]
        latest = unit.trends.latest("WS-1")
        assert latest is not None
        assert (latest.trend.quantity, latest.recorded_ns) == (quantity, 200)
        assert not put_trend(unit, other)
        assert put_trend(unit, at_3_mm)  # and back again
        assert make.same(unit.trends.latest("WS-1"), at_3_mm)


def test_receipts(fleet: SqlStorage) -> None:
    decoded = replace(
        make.CHUNK, state=ChunkState.DECODED, first_ns=1000, last_ns=2000, frames=7, counts={"unknown identifier": 3}
    )
    with fleet.write() as unit:
        assert unit.chunks.put(make.CHUNK)
        assert not unit.chunks.put(decoded)
        assert unit.chunks.get(make.CHUNK.digest) == make.CHUNK
        assert unit.chunks.with_state(ChunkState.STORED) == [make.CHUNK]
        unit.chunks.update(decoded)
    with fleet.read() as unit:
        chunks = unit.chunks
        assert chunks.get(make.CHUNK.digest) == decoded
        assert chunks.get("d" * 64) is None
        assert chunks.overlapping("V-1", 2000, 2001) == [decoded]
        assert chunks.overlapping("V-1", 2001, 3000) == chunks.overlapping("V-1", 0, 1000) == []
        assert chunks.overlapping("V-2", 0, 9999) == chunks.with_state(ChunkState.STORED) == []
    with pytest.raises(NotFoundError), fleet.write() as unit:
        unit.chunks.update(replace(decoded, digest="d" * 64))


def test_the_database_wants_both_ends_of_a_receipt(fleet: SqlStorage) -> None:
    with pytest.raises(ConflictError), fleet.write() as unit:
        unit.chunks.put(replace(make.CHUNK, first_ns=5))


def test_runs(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        first = unit.jobs.start("estimate", JobTrigger.SCHEDULE, 10)[0]
        second = unit.jobs.start("trends", JobTrigger.API, 11)[0]
        third = unit.jobs.start("estimate", JobTrigger.CLI, 12)[0]
        unit.jobs.finish(first.run_id, JobOutcome.SUCCEEDED, {"windows": 5}, 20)
        assert unit.jobs.abandon_running(30) == 2
    with fleet.read() as unit:
        jobs = unit.jobs
        done = replace(first, outcome="succeeded", counts={"windows": 5}, finished_ns=20)
        assert jobs.get(first.run_id) == done
        assert jobs.get(second.run_id).outcome == "abandoned"
        assert [run.run_id for run in jobs.page(None, None, 2)] == [third.run_id, second.run_id]
        assert jobs.page("estimate", third.run_id, 9) == [done]
    with pytest.raises(ConflictError, match="has ended: abandoned"), fleet.write() as unit:
        unit.jobs.finish(third.run_id, JobOutcome.SUCCEEDED, {}, 40)
    with pytest.raises(NotFoundError), fleet.write() as unit:
        unit.jobs.finish(999, JobOutcome.SUCCEEDED, {}, 40)
    with pytest.raises(ConflictError, match="has ended"), fleet.write() as unit:
        unit.jobs.finish(first.run_id, JobOutcome.FAILED, {}, 51)


def test_answers_by_key(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        assert unit.idempotency.get("k") is None
        for recorded_ns in (1, 2):
            unit.idempotency.put("k", "digest", 201, '{"a": 1}', recorded_ns)
        assert unit.idempotency.get("k") == ("digest", 201, '{"a": 1}')
        with pytest.raises(ConflictError, match="another answer"):
            unit.idempotency.put("k", "other", 201, "{}", 3)


def test_what_was_in_force_at_a_time_is_found_in_indexes_alone(sqlite_storage: SqlStorage) -> None:
    statement = _as_of(TREND, ["WS-1"], 1, None).compile(
        dialect=sqlite_storage.engine.dialect, compile_kwargs={"literal_binds": True}
    )
    with sqlite_storage.read() as unit:
        plan = [row.detail for row in unit.connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}").all()]
    assert not [step for step in plan if step.startswith("SCAN")], plan
    of_part = "(stage=? AND subject=? AND part=? AND recorded_ns<?)"
    assert any(of_part in step for step in plan), plan
