"""Exchanges that are cut off, shifted, empty or in another unit of the same quantity: refused, and nothing stored."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from exchange_runs import register, true_run
from test_exchange import Received, example

from estimation.errors import ExchangeError
from estimation.values.arrays import FloatArray
from fleet_db.storage import SqlStorage


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, FloatArray]:
    return true_run(tmp_path_factory.mktemp("motion"))


@pytest.fixture
def place(sqlite_storage: SqlStorage, tmp_path: Path) -> Received:
    with sqlite_storage.write() as unit:
        register(unit)
    return Received(sqlite_storage, tmp_path)


def refused(place: Received, path: Path) -> ExchangeError:
    with pytest.raises(ExchangeError) as caught:
        place.receiver.receive_exchange(path)
    assert place.nothing_stored()
    return caught.value


def shifted(lines: list[str]) -> list[str]:
    return [*lines[:9], lines[9].replace(",", ",0.5,", 1), *lines[10:]]


def cut(lines: list[str]) -> list[str]:
    return [*lines[:-1], lines[-1].rpartition(",")[0]]


@pytest.mark.parametrize(
    ("edit", "line", "reason"),
    [
        (shifted, 10, "has 12 columns, the header 11"),
        (cut, 15002, "has 10 columns, the header 11"),
        (lambda lines: lines[:1], None, "has 1 lines"),
        (lambda lines: lines[:0], None, "has 0 lines"),
        (lambda lines: lines[:4], None, "is too short: 3 samples"),
    ],
)
def test_a_table_that_is_damaged_is_refused(
    place: Received,
    motion: Mapping[str, FloatArray],
    edit: Callable[[list[str]], list[str]],
    line: int | None,
    reason: str,
) -> None:
    path = example(place.folder, motion)
    table = place.folder / "run.csv"
    table.write_text("\n".join(edit(table.read_text().splitlines())))
    error = refused(place, path)
    assert (error.file, error.line) == (str(table), line)
    assert reason in error.reason


def test_lines_may_end_with_the_delimiter(place: Received, motion: Mapping[str, FloatArray]) -> None:
    path = example(place.folder, motion)
    table = place.folder / "run.csv"
    header, *lines = table.read_text().splitlines()
    table.write_text("\n".join([header, *(f"{line}," for line in lines)]))
    place.receiver.receive_exchange(path)
    assert len(place.windows()) == 6


@pytest.mark.parametrize(
    ("old", "new", "field", "reason"),
    [
        ("start = 2026", "start = 9999", "run.start", "outside the years 1900 to 2200"),
        ("start = 2026", "start = 1600", "run.start", "outside the years 1900 to 2200"),
        ("odometer_km = 1000.0", "odometer_km = 1e300", "run.odometer_km", r"at most 1e\+08"),
        ('"X-1"', '"X\\u0000"', "run.vehicle", "control character"),
        ('ay_1", unit = "m/s2"', 'ay_1", unit = "g"', "axles[0].lateral", "is the unit of lateral or of yaw another"),
        ('yaw_1", unit = "rad/s2"', 'yaw_1", unit = "deg/s2"', "axles[0].lateral", "times what yaw and speed give"),
    ],
)
def test_what_the_description_cannot_mean_is_refused(
    place: Received, motion: Mapping[str, FloatArray], old: str, new: str, field: str, reason: str
) -> None:
    error = refused(place, example(place.folder, motion, (old, new)))
    assert error.field == field
    assert re.search(reason, error.reason), error.reason
    assert error.line is not None


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("roll_2", np.zeros_like, "has one value only: no roll was measured"),
        ("s", lambda values: np.where(np.arange(len(values)) == 100, 1e300, values), "is no position of a vehicle"),
    ],
)
def test_columns_that_cannot_be_are_named(
    place: Received,
    motion: Mapping[str, FloatArray],
    name: str,
    change: Callable[[FloatArray], FloatArray],
    reason: str,
) -> None:
    error = refused(place, example(place.folder, {**motion, name: change(motion[name])}))
    assert error.field == name
    assert reason in error.reason


def test_a_time_that_is_no_time_of_a_run_is_refused(place: Received, motion: Mapping[str, FloatArray]) -> None:
    path = example(place.folder, motion, ("run.csv", "run.parquet"))
    pq.write_table(pa.table({**motion, "t": motion["t"] + 1e10}), place.folder / "run.parquet")
    error = refused(place, path)
    assert error.field == "t"
    assert "1e+10 s from the start of the run: another unit?" in error.reason
