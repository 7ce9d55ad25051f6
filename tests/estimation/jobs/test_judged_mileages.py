"""Mileages are judged as new windows come: at the cost of the new ones, with the verdict of all together."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace

import pytest
from executed_statements import executed_statements
from one_database import on_sqlite
from sqlalchemy import select
from wheelset_life import DAY_NS, START_NS, WINDOW_NS, SetClock, register, sample_window

from estimation.jobs import estimate_windows
from estimation.jobs.estimate_windows import JUDGE
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.motion.mileage import implausible_mileages
from estimation.storage import Storage
from estimation.values.reasons import Reason
from estimation.values.windows import DueStage
from fleet_db.due import list_due
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.window_rows import implausible_reason
from fleet_db.tables.windows import WindowRow

WINDOWS = table_of(WindowRow)


def put(storage: Storage, number: int, mileage_km: float | None = None) -> None:
    at_km = 0.6 * number if mileage_km is None else mileage_km
    with storage.write() as unit:
        unit.windows.put(sample_window("W1", START_NS + number * WINDOW_NS), at_km, 1)


def judge(storage: Storage) -> int:
    return run(JUDGE, JobContext(storage, SetClock(START_NS), "test", JobSettings()))["mileages_judged"]


@on_sqlite
def test_a_run_of_the_job_judges_where_nothing_else_is_due(storage: SqlStorage) -> None:
    register(storage, "W1")
    for number in range(6):
        put(storage, number, 40_000.0 if number == 3 else None)
    context = JobContext(storage, SetClock(START_NS), "test", JobSettings())
    assert estimate_windows.JOB.run(context)["mileages_judged"] == 1
    with storage.write() as unit:  # the mileage of a stored window is corrected, which makes nothing else due
        list_due(unit.connection, DueStage.MILEAGES, WINDOWS.c.wheelset == "W1")
    estimate_windows.JOB.run(context)
    assert len(verdicts(storage)) == 1


def verdicts(storage: SqlStorage) -> Mapping[int, Reason]:
    with storage.read() as unit:
        rows = unit.connection.execute(select(WINDOWS)).all()
        assert unit.plausibility.due(["W1"])[0] == {}
    return {row.start_ns: reason for row in rows if (reason := implausible_reason(row)) is not None}


def together(storage: SqlStorage) -> Mapping[int, Reason]:
    """Return what all windows together say, read and judged at once."""
    with storage.read() as unit:
        readings, found = unit.plausibility.readings("W1"), {}
        for mounting in unit.registry.mountings("W1"):
            ended = mounting.to_ns or 2**63
            own = [one for one in readings if mounting.from_ns <= one.start_ns < ended]
            found |= implausible_mileages(own, mounting, unit.registry.vehicle("V1").max_speed_m_s)
    return found


@pytest.mark.parametrize("seed", range(6))
@on_sqlite
def test_the_verdict_is_that_of_all_windows_whatever_came_when(storage: SqlStorage, seed: int) -> None:
    register(storage, "W1")
    rng = random.Random(seed)  # noqa: S311 - a test
    numbers = rng.sample(range(8000), 60)
    seen = set()
    for step, number in enumerate(numbers):
        garbled = rng.random() < 0.05 * (seed % 3)
        put(storage, number, 0.6 * number + rng.choice([-900.0, 40_000.0, 3e9, float("nan")]) if garbled else None)
        if step == 20:
            with storage.write() as unit:
                unit.registry.add_vehicle(replace(unit.registry.vehicle("V1"), max_speed_m_s=16.5))
        if step == 40:
            with storage.write() as unit:
                (mounting,) = unit.registry.mountings("W1")
                unit.registry.add_mounting(replace(mounting, wheelset_mileage_km=30.0))
        if step % 4 == 0 or step == len(numbers) - 1:
            judge(storage)
            assert verdicts(storage) == together(storage)
            seen |= set(verdicts(storage))
    assert seen or not seed % 3


@on_sqlite
def test_new_windows_are_judged_beside_those_next_to_them(storage: SqlStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    register(storage, "W1")
    statements, read = [], []
    for count in (10, 200):
        for number in range(count):
            put(storage, 10 * number)
        judge(storage)
        put(storage, 10 * count + 5)
        put(storage, 55)
        monkeypatch.setattr(estimate_windows, "implausible_mileages", lambda *_: read.append(1))
        with executed_statements() as executed:
            assert judge(storage) == 0
        monkeypatch.undo()
        statements.append(len(executed))
    assert read == []
    assert statements[0] == statements[1] <= 30


@on_sqlite
def test_windows_a_day_apart_are_read_for_themselves(storage: SqlStorage) -> None:
    register(storage, "W1")
    for day in range(9):
        put(storage, day * DAY_NS // WINDOW_NS)
    judge(storage)
    put(storage, 1)
    put(storage, 8 * DAY_NS // WINDOW_NS + 1)
    with storage.read() as unit:
        new = unit.plausibility.new_readings(["W1"])["W1"]
        spans = estimate_windows._spans(("W1", one.start_ns) for one in new)["W1"]
        around = unit.plausibility.readings_around(spans)
    assert WORK.windows_apart_ns == DAY_NS
    assert [len(found) for found in around.values()] == [3, 2]
