"""Parquet tables of exchanges are read in a process of their own, which ends at its limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimation.errors import ExchangeError, PassingFaultError
from ingest.exchange import table
from ingest.exchange.description import CsvTable
from ingest.exchange.table import read_table, read_table_apart
from ingest.input_file import MEBIBYTE


def test_it_gives_what_reading_in_this_process_gives(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t;v\n0,5;1e300\n-0,25;3,141592653589793\n")
    layout = CsvTable(delimiter=";", decimal=",")
    here, apart = (read(path, layout, ["v", "t"]) for read in (read_table, read_table_apart))
    assert apart.first_line == here.first_line
    assert list(apart.columns) == list(here.columns)
    assert all(np.array_equal(apart.columns[name], here.columns[name]) for name in here.columns)


def test_a_refusal_keeps_its_place(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,v\n0,1\n1,x\n")
    with pytest.raises(ExchangeError, match="is no number") as refused:
        read_table_apart(path, CsvTable(), ["t", "v"])
    assert (refused.value.file, refused.value.line, refused.value.field) == (str(path), 3, "v")


def test_a_bomb_costs_its_own_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = 60_000
    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array(["x" * 4_000]))
    path = tmp_path / "bomb.parquet"  # of 240 MB
    pq.write_table(pa.table({"t": np.zeros(rows), "note": text}), path, compression="zstd", store_schema=False)
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(table, "MEMORY_BYTES", 128 * MEBIBYTE)
    with pytest.raises(ExchangeError, match="cannot be read with 128 MiB of memory"):
        read_table_apart(path, CsvTable(), ["t"])


def test_no_room_for_the_columns_is_no_fault_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t\n0\n")
    monkeypatch.setattr(table.sys, "executable", str(tmp_path / "none"))
    with pytest.raises(PassingFaultError, match="No such file"):
        read_table_apart(path, CsvTable(), ["t"])


def test_the_limits_of_a_table() -> None:
    assert (table.MEMORY_BYTES, table.CPU_S, table.WALL_S) == (2 << 30, 120, 600.0)
