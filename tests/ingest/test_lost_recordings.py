"""Raw recordings that are lost or damaged: what changed meanwhile reaches their windows once they are back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from purged_raw import purge_raw
from test_reassembly import Windows, made_of, mounting, received, receiver_on
from test_receiver import files_of
from vehicle_bus import VEHICLE, Run, register

from estimation.values.runs import SubjectKind
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.reassembly import ASSEMBLY
from ingest.receiver import Receiver


def flip(path: Path) -> None:
    """Damage a file without another size."""
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))


def corrected_without(storage: SqlStorage, folder: Path, harm: Callable[[Path], None]) -> tuple[Path, Receiver]:
    """Return a raw file that was harmed before a mounting was ended, and a new process."""
    with storage.write() as unit:
        register(unit)
    received(storage, folder, [Run().frames()])
    with storage.write() as unit:
        (record,) = unit.chunks.with_state(ChunkState.DECODED)
        unit.registry.add_mounting(mounting(1, to_ns=1))
    path = FileRawStore(folder / "raw").path(record.digest, record.suffix)
    harm(path)
    receiver = receiver_on(storage, folder)
    receiver.reassembler.work_off()
    return path, receiver


def held(storage: SqlStorage) -> list[str]:
    with storage.read() as unit:
        return [item.key for item in unit.quarantine.held(ASSEMBLY) if item.kind is SubjectKind.RECORDING]


def serials(windows: Windows) -> set[str]:
    return {serial for serial, _ in windows}


@pytest.mark.parametrize("harm", [Path.unlink, flip])
def test_windows_follow_the_registry_once_their_recording_is_copied_back(
    sqlite_storage: SqlStorage, tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    path, receiver = corrected_without(sqlite_storage, tmp_path, harm)
    assert serials(made_of(sqlite_storage)) == {"WS-1", "WS-2"}
    assert held(sqlite_storage) == [path.stem], "it is listed"
    receiver.reassembler.work_off()
    assert held(sqlite_storage) == [path.stem], "it is still lost"
    (copy,) = files_of([Run().frames()], tmp_path)
    path.write_bytes(copy.read_bytes())
    with sqlite_storage.write() as unit:
        unit.quarantine.retry()
    receiver_on(sqlite_storage, tmp_path).reassembler.work_off()
    assert serials(made_of(sqlite_storage)) == {"WS-2"}
    assert held(sqlite_storage) == []


@pytest.mark.parametrize("harm", [Path.unlink, flip])
def test_windows_follow_the_registry_once_their_recording_is_received_again(
    sqlite_storage: SqlStorage, tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    path, receiver = corrected_without(sqlite_storage, tmp_path, harm)
    (copy,) = files_of([Run().frames()], tmp_path)
    assert receiver.receive_file(copy, VEHICLE).windows_changed == 3
    assert path.read_bytes() == copy.read_bytes()
    assert serials(made_of(sqlite_storage)) == {"WS-2"}
    assert held(sqlite_storage) == []


def test_windows_follow_the_registry_once_a_purged_recording_is_received_again(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    storage = SqlStorage(sqlite_storage.engine, tmp_path)

    def delete(_: Path) -> None:
        purge_raw(storage)

    _, receiver = corrected_without(storage, tmp_path, delete)
    assert serials(made_of(storage)) == {"WS-1", "WS-2"}
    assert held(storage) == [], "nothing is missing: it was purged on purpose"
    receiver.receive_file(*files_of([Run().frames()], tmp_path), VEHICLE)
    receiver.reassembler.work_off()
    assert serials(made_of(storage)) == {"WS-2"}


def test_a_recording_that_the_disk_has_damaged_is_not_rejected(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    (path,) = files_of([Run().frames()], tmp_path)
    receiver = receiver_on(sqlite_storage, tmp_path)
    record, _ = receiver.keep(path.read_bytes(), ".blf", VEHICLE, path.name)
    with sqlite_storage.write() as unit:
        register(unit)
    flip(FileRawStore(tmp_path / "raw").path(record.digest, record.suffix))
    (outcome,) = receiver.decode_stored()
    assert state(sqlite_storage, record) is ChunkState.STORED, outcome
    assert receiver.receive_file(path, VEHICLE).windows_changed == 6
    assert state(sqlite_storage, record) is ChunkState.DECODED


def state(storage: SqlStorage, record: ChunkRecord) -> ChunkState:
    with storage.read() as unit:
        found = unit.chunks.get(record.digest)
    assert found is not None
    return found.state
