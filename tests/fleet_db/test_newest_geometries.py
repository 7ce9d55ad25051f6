"""The newest geometry and trend of a wheelset: the right ones, at a cost that does not grow with those before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import stored_values as make
from sqlalchemy import insert, select, union_all

from bench.put_values import put_geometry, put_trend
from estimation.values.geometry import GeometryRecord, interval_conicities
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.results import RESULTS

EVER = 2**62


def drawn(seed: int, count: int) -> list[GeometryRecord]:
    """Return geometries of some baselines, current and of intervals, in the order of their commits."""
    random = np.random.default_rng(seed)
    intervals = (None, -3, -1, 0, 1, 7)
    return [
        make.geometry_record(
            k, 100 + 10 * k, baseline=int(random.integers(0, 4)), interval=intervals[random.integers(0, 6)]
        )
        for k in range(count)
    ]


def newest(records: Sequence[GeometryRecord], as_of_ns: int, *, current: bool) -> list[str]:
    """Return the digests of the last of each baseline, or of each of its intervals, the slow way."""
    found: dict[tuple[int, int], str] = {}
    for record in records:
        if record.recorded_ns <= as_of_ns and (record.interval is None) is current:
            found[record.baseline, record.interval or 0] = record.input_digest
    return [digest for _, digest in sorted(found.items())]


@pytest.mark.parametrize("seed", range(3))
def test_the_newest_of_each_baseline_and_interval(fleet: SqlStorage, seed: int) -> None:
    records = drawn(seed, 60)
    with fleet.write() as unit:
        assert all(put_geometry(unit, record) for record in records)
        put_geometry(unit, replace(records[0], wheelset="WS-2", baseline=9, interval=5))
    with fleet.read() as unit:
        for as_of_ns in (0, 100, 250, 480, EVER):
            intervals = unit.geometries.intervals("WS-1", None, as_of_ns)
            assert [one.input_digest for one in intervals] == newest(records, as_of_ns, current=False)
        assert [r.input_digest for r in unit.geometries.baselines("WS-1")] == newest(records, EVER, current=True)
        second = [one for one in records if one.baseline == 2]
        assert [r.input_digest for r in unit.geometries.intervals("WS-1", 2)] == newest(second, EVER, current=False)
        assert unit.geometries.intervals("none") == []
        expected = [interval_conicities(r) for r in unit.geometries.intervals("WS-1", 2)]
        assert make.same(tuple(unit.geometries.conicities("WS-1", 2)), tuple(expected))


def test_who_is_bound_to_another_fleet_sees_none(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        put_geometry(unit, make.geometry_record(interval=1))
    for fleets, count in ((frozenset({"F-1"}), 1), (frozenset({"another"}), 0)):
        with fleet.seen_by(fleets).read() as unit:
            assert len(unit.geometries.intervals("WS-1")) == count


def put_all(storage: SqlStorage) -> None:
    make.populate(storage)
    with storage.write() as unit:
        for record in drawn(1, 40):
            put_geometry(unit, record)
        for seed in range(40):
            put_trend(unit, make.trend_record(seed, 100 + seed))


def repeat_what_was_superseded(unit: SqlUnitOfWork, times: int) -> None:
    """Append every result that another one followed again, some times."""
    columns = [column for column in RESULTS.c if column.name != "result_id"]
    row = select(*columns).where(RESULTS.c.superseded_ns.is_not(None))
    repeated = union_all(*[row] * times).subquery()
    unit.connection.execute(insert(RESULTS).from_select([column.name for column in columns], select(repeated)))


def steps(storage: SqlStorage, ask: Callable[[SqlUnitOfWork], object]) -> int:
    """Return how many steps the machine of SQLite makes for a question."""
    counted = 0

    def count() -> int:
        nonlocal counted
        counted += 1
        return 0

    with storage.read() as unit:
        driver: Any = unit.connection.connection.driver_connection
        driver.set_progress_handler(count, 1)
        ask(unit)
        driver.set_progress_handler(None, 0)
    return counted


def test_what_came_before_costs_nothing(sqlite_storage: SqlStorage) -> None:
    questions: dict[str, Callable[[SqlUnitOfWork], object]] = {
        "version": lambda unit: unit.trends.version("WS-1"),
        "trend": lambda unit: unit.trends.latest("WS-1"),
        "geometry version": lambda unit: unit.geometries.version("WS-1"),
        "geometry": lambda unit: unit.geometries.current("WS-1"),
        "baselines": lambda unit: unit.geometries.baselines("WS-1"),
        "intervals": lambda unit: unit.geometries.intervals("WS-1", 0),
    }
    put_all(sqlite_storage)
    few = {name: steps(sqlite_storage, ask) for name, ask in questions.items()}
    with sqlite_storage.write() as unit:
        repeat_what_was_superseded(unit, 50)
    many = {name: steps(sqlite_storage, ask) for name, ask in questions.items()}
    assert many == few
