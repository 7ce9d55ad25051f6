"""Parquet tables of exchanges read in a process of their own: a file of kilobytes can unpack to gigabytes.

A text file is bounded by its size, and read in place.

The process ends itself at its limits of memory and CPU; it answers in one line of JSON, with the columns in a file.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from estimation.errors import ExchangeError, PassingFaultError
from estimation.values.reasons import ReasonCode
from fleet_db.atomic_files import passing_fault
from ingest.exchange.description import CsvTable
from ingest.exchange.table import ExchangeTable, read_table
from ingest.input_file import MEBIBYTE, end_with, limit_memory

MEMORY_BYTES = 2048 * MEBIBYTE
"""Of address space, beyond what the process has before it reads: four times the largest table that is taken."""

CPU_S = 120
"""An hour at 250 Hz with 25 columns takes 10 s as text."""

WALL_S = 600.0
COLUMNS = "columns.npy"


def read_table_apart(path: Path, layout: CsvTable, names: Sequence[str]) -> ExchangeTable:
    """Return the columns of a table, read in a process of its own; as :func:`ingest.exchange.table.read_table`.

    Raises:
        PassingFaultError: There is no process or no space to read it with.
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
    csv, wanted = CsvTable.model_validate_json(layout), json.loads(names)
    limit_memory(int(memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
    try:
        table = read_table(Path(path), csv, wanted)
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
