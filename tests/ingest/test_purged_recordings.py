"""Windows of recordings whose raw bytes were purged stay as they are, until the bytes are received again."""

from __future__ import annotations

from pathlib import Path

from purged_raw import purge_raw
from test_reassembly import made_of, mounting, pieces_of, received
from test_receiver import files_of
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run, register

from fleet_db.storage import SqlStorage
from ingest.span_commit import NO_CHANGES


def test_windows_of_purged_recordings_stay(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    first, second = pieces_of(Run(), 20.0)
    later = Run(start_ns=START_NS + 3600 * SECOND_NS, seed=3).frames()
    storage = SqlStorage(sqlite_storage.engine, tmp_path)
    receiver = received(storage, tmp_path, [first, second])
    whole = made_of(storage)
    purge_raw(storage)
    assert list((tmp_path / "raw").rglob("*.blf")) == []
    receiver = received(storage, tmp_path, [later])  # new recordings go on
    assert {key: made_of(storage)[key] for key in whole} == whole
    assert receiver.reassembler.reassemble(VEHICLE, None, None) == NO_CHANGES
    with storage.write() as unit:
        unit.registry.add_mounting(mounting(1, to_ns=1))  # a correction reaches what can be made again
    assert receiver.reassembler.work_off().removed == 3
    assert set(made_of(storage)) & set(whole) == set(whole)
    for path in files_of([first, second], tmp_path):
        assert receiver.receive_file(path, VEHICLE).known
    receiver.reassembler.reassemble(VEHICLE, None, None)
    assert {serial for serial, _ in made_of(storage)} == {"WS-2"}
