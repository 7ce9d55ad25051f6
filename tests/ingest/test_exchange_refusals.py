"""Exchanges that are cut off, shifted, empty or in another unit of the same quantity: refused, and nothing stored."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from exchange_runs import VEHICLE, register, true_run
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


def broken(name: str, row: int, value: float) -> Callable[[Mapping[str, FloatArray]], dict[str, FloatArray]]:
    def change(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        found = {key: values.copy() for key, values in columns.items()}
        found[name][row] = value
        return found

    return change


def without_rows(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: np.delete(values, slice(1000, 1040)) for name, values in columns.items()}


def without_column(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: values for name, values in columns.items() if name != "roll_2"}


BAD: list[tuple[Callable[..., dict[str, FloatArray]], tuple[str, str] | None, str, str, int | None]] = [
    (without_column, None, "is missing; the columns are t, s", "roll_2", 1),
    (broken("yaw_1", 7, np.nan), None, "nan is no finite number; 1 values", "yaw_1", 9),
    (broken("t", 70, 0.0), None, "the time does not increase", "t", 72),
    (without_rows, None, "a gap: 40 samples are missing", "t", 1002),
    (broken("t", 1000, 1.9991), None, "not uniform", "t", 1002),
    (broken("ay_1", 5, 5e6), None, "is no lateral of a vehicle", "ay_1", 7),
    (broken("v", 5, -20.0), None, "x must point in the direction of running", "v", 7),
    (dict, ("rate_hz = 500", "rate_hz = 250"), "come at 500 Hz, declared are 250", "t", 2),
    (dict, ('unit = "m/s"\n', 'unit = "km/h"\n'), "is a unit another?", "s", 15002),
    (dict, ('unit = "m/s"\n', 'unit = "knots"\n'), "'knots' is no known unit; a speed", "speed.unit", 28),
    (dict, ('yaw_1", unit = "rad/s2"', 'yaw_1", unit = "g"'), "unit of acceleration", "axles[0].yaw.unit", 33),
    (dict, ('y = "left"', 'y = "right"'), "left-handed axes: turn one of them", "axes.y", 12),
    (dict, ('vehicle = "X-1"', 'vehicle = "X-2"'), "the registry has no vehicle 'X-2'", "run.vehicle", 4),
    (dict, ('section = "LINE"', 'section = "SIDE"'), "no track section 'SIDE'", "run.section", 5),
    (dict, ("axle = 2", "axle = 3"), "3: vehicle X-1 has 2 axles", "axles[1].axle", 38),
    (dict, ('"ay_2"', '"ay_1"'), "is that of axles.0.lateral too", "axles[1].lateral.column", 39),
    (dict, ("start = 2026", "start = 1960"), "no one wheelset was mounted at axle 1", "axles[0].axle", 31),
]  # fmt: skip


@pytest.mark.parametrize(("change", "toml", "reason", "field", "line"), BAD)
def test_bad_exchanges_are_refused_with_file_line_and_field(
    place: Received,
    motion: Mapping[str, FloatArray],
    change: Callable[..., dict[str, FloatArray]],
    toml: tuple[str, str] | None,
    reason: str,
    field: str,
    line: int | None,
) -> None:
    path = example(place.folder, change(motion), *([toml] if toml else []))
    with pytest.raises(ExchangeError, match=re.escape(reason)) as caught:
        place.receiver.receive_exchange(path)
    assert (caught.value.field, caught.value.line) == (field, line)
    assert caught.value.file in {str(path), str(place.folder / "run.csv")}
    assert place.nothing_stored()


def test_a_run_beyond_its_section_is_refused(place: Received, motion: Mapping[str, FloatArray]) -> None:
    with pytest.raises(ExchangeError, match=r"section LINE of the registry goes from 0 to 3000.0 m") as caught:
        place.receiver.receive_exchange(example(place.folder, {**motion, "s": motion["s"] + 2000.0}))
    assert caught.value.field == "run.section"


def test_a_vehicle_without_class_is_refused(place: Received, motion: Mapping[str, FloatArray]) -> None:
    with place.storage.write() as unit:
        unit.registry.add_vehicle(replace(unit.registry.vehicle(VEHICLE), vehicle_class="tram"))
    with pytest.raises(ExchangeError, match=r"no class 'tram', of which vehicle X-1 is") as caught:
        place.receiver.receive_exchange(example(place.folder, motion))
    assert caught.value.field == "run.vehicle"


def test_parquet_that_is_damaged_or_has_gaps_is_refused(place: Received, motion: Mapping[str, FloatArray]) -> None:
    path = example(place.folder, motion, ('data = "run.csv"', 'data = "run.parquet"'))
    table = place.folder / "run.parquet"
    values = pa.array(motion["yaw_1"], mask=np.arange(len(motion["t"])) == 10_000)
    for content, reason in (
        ({**motion, "yaw_1": values}, "row 10001: is null; 1 values of the column are"),
        ({**motion, "ay_1": pa.array(["x"] * len(motion["t"]))}, "is no column of numbers"),
    ):
        pq.write_table(pa.table(content), table)
        with pytest.raises(ExchangeError, match=re.escape(reason)):
            place.receiver.receive_exchange(path)
    whole = table.read_bytes()
    for content in (whole[:4000], b"PAR1" + bytes(100) + b"PAR1", b"", whole[:100] + bytes(200) + whole[300:]):
        table.write_bytes(content)
        with pytest.raises(ExchangeError):
            place.receiver.receive_exchange(path)
    assert place.nothing_stored()
