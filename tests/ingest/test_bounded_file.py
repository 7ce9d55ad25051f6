"""Files that are read whole have a size that no such file needs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimation.errors import ExchangeError, InputError
from ingest import input_file
from ingest.catalogue import load_catalogue
from ingest.exchange.description import CsvTable
from ingest.exchange.table import read_table
from ingest.input_file import read_json, read_text_within, read_toml
from ingest.profiles.files import read_profile
from ingest.track_file import read_track_columns

LIMITED: dict[str, tuple[str, Callable[[Path], object]]] = {
    "ingest.input_file.SETTINGS_BYTES": ("a.json", read_json),
    "ingest.catalogue.SETTINGS_BYTES": ("a.dbc", load_catalogue),
    "ingest.track_file.TABLE_BYTES": ("a.csv", read_track_columns),
    "ingest.profiles.files.PROFILE_BYTES": ("a.csv", lambda path: read_profile(path, "wheel")),
    "ingest.exchange.table.TABLE_BYTES": ("a.csv", lambda path: read_table(path, CsvTable(), ["t"])),
}


def test_a_text_within_its_limit_is_read_and_one_beyond_is_not(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfab\r\ncd\n")
    assert read_text_within(path, 10, InputError, encoding="utf-8-sig") == "ab\ncd\n"
    with pytest.raises(InputError, match="limit for such a file"):
        read_text_within(path, 9, InputError)
    with pytest.raises(InputError, match="limit for such a file"):
        read_text_within(Path("/dev/zero"), 1 << 20, InputError)


@pytest.mark.parametrize("constant", LIMITED)
def test_every_reader_of_whole_files_has_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, constant: str
) -> None:
    name, read = LIMITED[constant]
    path = tmp_path / name
    path.write_text("x" * 200)
    monkeypatch.setattr(constant, 100)
    with pytest.raises(InputError, match="limit for such a file") as caught:
        read(path)
    assert caught.value.file == str(path)


def test_the_limits_of_files_that_are_read_whole() -> None:
    """Above what the largest such file of a fleet needs, and far below the memory of a small machine."""
    assert input_file.SETTINGS_BYTES == 64 << 20
    assert input_file.TABLE_BYTES == 256 << 20
    assert input_file.PROFILE_BYTES == 16 << 20
    with pytest.raises(InputError, match="No such file"):
        read_toml(Path("/nowhere/a.toml"))


def test_a_parquet_file_that_unpacks_to_more_than_an_exchange_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"t": np.zeros(1_000_000)}), path)  # 8 MB in some kB
    assert path.stat().st_size < 100_000
    assert len(read_table(path, CsvTable(), ["t"]).columns["t"]) == 1_000_000
    monkeypatch.setattr("ingest.exchange.table.UNPACKED_BYTES", 4 << 20)
    with pytest.raises(ExchangeError, match="unpacks to more than 4 MiB"):
        read_table(path, CsvTable(), ["t"])
