"""Exchanges of one vehicle for the same time: the second is refused until the first is set aside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exchange_runs import EXAMPLE, register, true_run, write_csv

from estimation.errors import ConflictError
from estimation.values.arrays import FloatArray
from fleet_db.raw import FileRawStore
from fleet_db.records import RecordingAction
from fleet_db.storage import SqlStorage
from fleet_db.stores.chunks import ChosenChunks
from ingest.catalogue import default_catalogue
from ingest.corrections import Author, RecordingCorrections
from ingest.receiver import Receiver


class Clock:
    at_ns = 1_800_000_000_000_000_000

    def now_ns(self) -> int:
        self.at_ns += 1
        return self.at_ns


def example(folder: Path, columns: dict[str, FloatArray]) -> Path:
    """Write the example of an exchange; return the path of its TOML file."""
    folder.mkdir()
    write_csv(folder / "run.csv", {name: columns[name] for name in columns if f'column = "{name}"' in EXAMPLE})
    (folder / "run.toml").write_text(EXAMPLE)
    return folder / "run.toml"


def test_a_run_of_a_time_that_another_one_has_is_refused_and_taken_once_that_is_set_aside(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    receiver = Receiver(
        sqlite_storage, FileRawStore(tmp_path / "raw"), default_catalogue(), Clock(), window_length_s=10.0
    )
    motion = dict(true_run(tmp_path))
    standing = {**motion, "s": np.full_like(motion["s"], 500.0), "v": np.zeros_like(motion["v"])}
    first = receiver.receive_exchange(example(tmp_path / "still", standing)).record
    assert first.state == "decoded"
    run = example(tmp_path / "moving", motion)
    with pytest.raises(ConflictError, match=f"recordings set-aside {first.digest[:12]}"):
        receiver.receive_exchange(run)
    with sqlite_storage.read() as unit:
        assert len(unit.chunks.page(ChosenChunks(), 10)) == 1
    RecordingCorrections(sqlite_storage, Clock()).correct(
        first.digest, RecordingAction.SET_ASIDE, Author("kim", "the other is right")
    )
    assert receiver.receive_exchange(run).windows_changed == 6
