"""The table of an exchange: named columns of numbers from a CSV or Parquet file, each number finite.

Parquet tables are read in a process of their own, for a file of kilobytes can unpack to gigabytes. It ends itself at
its limits of memory and CPU, and answers in one line of JSON, with the columns in a file. A text file is bounded by its
size, and read in place.
"""

from __future__ import annotations

import csv
import itertools
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from estimation.errors import ExchangeError, PassingFaultError
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.reasons import ReasonCode
from fleet_db.atomic_files import passing_fault
from ingest.exchange.description import CsvTable
from ingest.input_file import MEBIBYTE, TABLE_BYTES, end_with, limit_memory, read_text_within

PARQUET = ".parquet"
SUFFIXES = (".csv", ".txt", PARQUET)
MAGIC = b"PAR1"
BATCH_ROWS = 65_536
UNPACKED_BYTES = 512 * MEBIBYTE  # of a Parquet file, unpacked: an hour at 250 Hz with 25 columns has 180 MiB


@dataclass(frozen=True, slots=True)
class ExchangeTable:
    """Columns of a table by their names, (n,) each, and where in its file a row is."""

    path: Path
    columns: Mapping[str, FloatArray]
    first_line: int | None  # of a text file; rows of a Parquet file have none

    def error(self, reason: str, row: int, column: str) -> ExchangeError:
        """Return the error that names a row, from 0, and a column."""
        return _row_error(self.path, self.first_line, reason, row, column)


def read_table(path: Path, layout: CsvTable, names: Sequence[str]) -> ExchangeTable:
    """Return the columns of a table, all of finite numbers; errors name line and column."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ExchangeError(f"is no table: the suffix is none of {', '.join(SUFFIXES)}", file=path)
    if suffix == PARQUET:
        values, first_line = _read_parquet(path, names), None
    else:
        values, first_line = _read_csv(path, layout, names), layout.first
    for name in names:
        bad = np.flatnonzero(~np.isfinite(values[name]))
        if len(bad):
            reason = f"{values[name][bad[0]]} is no finite number; {len(bad)} values of the column are not"
            raise _row_error(path, first_line, reason, int(bad[0]), name)
    return ExchangeTable(path, {name: frozen_array(values[name], (None,), name=name) for name in names}, first_line)


def _row_error(path: Path, first_line: int | None, reason: str, row: int, column: str) -> ExchangeError:
    if first_line is None:
        return ExchangeError(f"row {row + 1}: {reason}", file=path, field=column)
    return ExchangeError(reason, file=path, line=first_line + row, field=column)


def _read_csv(path: Path, layout: CsvTable, names: Sequence[str]) -> Mapping[str, FloatArray]:
    lines = read_text_within(path, TABLE_BYTES, ExchangeError, encoding="utf-8-sig").rstrip().splitlines()
    if len(lines) < layout.first:
        raise ExchangeError(f"has {len(lines)} lines; numbers were to begin in line {layout.first}", file=path)
    header = _cells(lines[layout.header_line - 1], layout)
    places = _places(path, header, names, layout.header_line)
    numbers = lines[layout.first - 1 :]
    if "" in numbers:
        raise ExchangeError("is empty", file=path, line=layout.first + numbers.index(""))
    _check_widths(path, layout, numbers, len(header))
    if layout.decimal == ",":
        numbers = [line.replace(",", ".") for line in numbers]
    try:
        table = np.loadtxt(numbers, delimiter=layout.delimiter, usecols=places, comments=None, quotechar='"', ndmin=2)
    except ValueError as error:
        raise _first_bad_cell(path, layout, numbers, dict(zip(names, places, strict=True))) from error
    return {name: table[:, column].copy() for column, name in enumerate(names)}


def _check_widths(path: Path, layout: CsvTable, numbers: Sequence[str], columns: int) -> None:
    """Refuse lines of more or fewer columns than the header: values would be read as those of another column."""
    for row, line in enumerate(numbers):
        width = len(_cells(line, layout)) if '"' in line else line.count(layout.delimiter) + 1
        if width != columns and not (width == columns + 1 and line.endswith(layout.delimiter)):
            reason = f"has {width} columns, the header {columns}"
            raise ExchangeError(reason, file=path, line=layout.first + row)


def _cells(line: str, layout: CsvTable) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=layout.delimiter, skipinitialspace=True))]


def _places(path: Path, header: Sequence[str], names: Sequence[str], line: int | None) -> list[int]:
    for name in names:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else "is there more than once"
            raise ExchangeError(f"{problem}; the columns are {', '.join(header)}", file=path, line=line, field=name)
    return [header.index(name) for name in names]


def _first_bad_cell(path: Path, layout: CsvTable, numbers: Sequence[str], places: Mapping[str, int]) -> ExchangeError:
    for row, line in enumerate(numbers):
        cells = _cells(line, layout)
        for name, place in places.items():
            if place >= len(cells):
                return _row_error(path, layout.first, f"the line has {len(cells)} columns", row, name)
            try:
                float(cells[place])
            except ValueError:
                return _row_error(path, layout.first, f"{cells[place]!r} is no number", row, name)
    return ExchangeError("is no table of numbers", file=path)


def _read_parquet(path: Path, names: Sequence[str]) -> Mapping[str, FloatArray]:
    try:
        from arro3.io import read_parquet  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        raise ExchangeError("needs the extra 'parquet': pip install 'treadwatch[parquet]'", file=path) from error
    _check_magic(path)
    try:
        reader = read_parquet(path, batch_size=BATCH_ROWS)
        header = list(reader.schema.names)
        _places(path, header, names, None)
        table = _within_limit(reader, path)
    except ExchangeError:
        raise
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        raise ExchangeError(f"is a damaged Parquet file: {error}", file=path) from error  # panics are no Exceptions
    return {name: _numbers(path, name, table.column(name)) for name in names}


def _within_limit(reader: Any, path: Path) -> Any:  # noqa: ANN401 - of an extra
    from arro3.core import Table  # noqa: PLC0415 - an extra

    batches, size = [], 0
    for batch in reader:
        batches.append(batch)
        size += int(batch.nbytes)
        if size > UNPACKED_BYTES:
            reason = f"unpacks to more than {UNPACKED_BYTES / MEBIBYTE:.0f} MiB, the limit for an exchange"
            raise ExchangeError(reason, file=path)
    return Table.from_batches(batches, schema=reader.schema)


def _check_magic(path: Path) -> None:
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
            size = file.seek(0, 2)
            file.seek(max(size - len(MAGIC), 0))
            tail = file.read()
    except OSError as error:
        raise ExchangeError(f"cannot be read: {error.strerror or error}", file=path) from error
    if size > TABLE_BYTES:
        raise ExchangeError(f"has more than {TABLE_BYTES / MEBIBYTE:.0f} MiB, the limit for such a file", file=path)
    if head != MAGIC or tail != MAGIC or size < 3 * len(MAGIC):
        raise ExchangeError("is no Parquet file, or is cut off", file=path)


def _numbers(path: Path, name: str, column: Any) -> FloatArray:  # noqa: ANN401 - of an extra
    if column.null_count:
        before = itertools.accumulate((len(chunk) for chunk in column.chunks), initial=0)
        first, chunk = next((at, chunk) for at, chunk in zip(before, column.chunks, strict=False) if chunk.null_count)
        at = next(i for i, value in enumerate(chunk) if value.as_py() is None)
        raise _row_error(path, None, f"is null; {column.null_count} values of the column are", first + at, name)
    try:
        values = np.asarray(column.to_numpy())
    except (NotImplementedError, ValueError, TypeError) as error:
        raise ExchangeError(f"is no column of numbers ({column.type})", file=path, field=name) from error
    if values.dtype.kind not in "iuf":
        raise ExchangeError(f"is no column of numbers ({column.type})", file=path, field=name)
    return values.astype(np.float64)


MEMORY_BYTES = 2048 * MEBIBYTE
"""Of address space, beyond what the process has before it reads: four times the largest table that is taken."""

CPU_S = 120  # an hour at 250 Hz with 25 columns takes 10 s as text
WALL_S = 600.0
COLUMNS = "columns.npy"


def read_table_apart(path: Path, layout: CsvTable, names: Sequence[str]) -> ExchangeTable:
    """Return the columns of a table, read in a process of its own; as :func:`read_table`.

    Raises PassingFaultError where there is no process or no space to read it with.
    """
    with TemporaryDirectory(prefix="treadwatch-table-") as folder:
        table = [str(path.absolute()), layout.model_dump_json(), json.dumps(list(names)), folder]
        answer = _answer([*table, str(os.getpid()), str(MEMORY_BYTES)], path)
        values = np.load(Path(folder) / COLUMNS, allow_pickle=False)
    return ExchangeTable(path, dict(zip(names, values, strict=True)), answer["first_line"])


def _answer(request: Sequence[str], path: Path) -> dict[str, Any]:
    try:
        done = subprocess.run(  # noqa: S603 - our own module, arguments as a list
            [sys.executable, "-m", __name__, *request],
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=WALL_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ExchangeError(f"reading takes longer than {WALL_S:g} s", file=path) from None
    except OSError as error:
        raise passing_fault(error, path) from error
    if done.returncode == -signal.SIGKILL:
        raise PassingFaultError("the process that reads it was killed", file=path, code=ReasonCode.WAITS_FOR_MEMORY)
    if done.returncode != 0 or not done.stdout:
        raise ExchangeError(
            f"cannot be read with {MEMORY_BYTES // MEBIBYTE} MiB of memory and {CPU_S} s of CPU, the limits for a table"
            f" (the process that reads it ended with {done.returncode})",
            file=path,
        )
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    if "passing" in answer:
        raise PassingFaultError(answer["passing"], file=path)
    if "error" in answer:
        raise ExchangeError(answer["error"], file=path, line=answer["line"], field=answer["field"])
    return answer


def main(path: str, layout: str, names: str, folder: str, parent: str, memory_bytes: str) -> None:
    """Read one table, write its columns, and print how it went."""
    end_with(int(parent))
    csv_table, wanted = CsvTable.model_validate_json(layout), json.loads(names)
    limit_memory(int(memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
    try:
        table = read_table(Path(path), csv_table, wanted)
    except ExchangeError as error:
        answer: dict[str, object] = {"error": error.reason, "line": error.line, "field": error.field}
    else:
        answer = {"first_line": table.first_line}
        try:
            np.save(Path(folder) / COLUMNS, np.stack([table.columns[name] for name in wanted]))
        except OSError as error:
            answer = {"passing": error.strerror or str(error)}
    print(json.dumps(answer))  # noqa: T201 - the answer


if __name__ == "__main__":
    main(*sys.argv[1:])
