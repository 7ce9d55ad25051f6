"""A bus that is another one now: recordings are placed, read or refused as if they had just been received."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from test_lost_recordings import state
from test_reassembly import Windows, made_of, received, receiver_on
from test_receiver import CountingClock, files_of
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run, register

from estimation.errors import LogFileError, PassingFaultError, StorageError
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest import recordings
from ingest.catalogue import default_catalogue
from ingest.reassembly import HeldRecordings
from ingest.receiver import Receiver
from ingest.stored_settings import BusChoice, claim


def decoded(storage: SqlStorage, folder: Path) -> tuple[ChunkRecord, Windows]:
    with storage.write() as unit:
        register(unit)
    received(storage, folder, [Run().frames()])
    with storage.read() as unit:
        (record,) = unit.chunks.with_state(ChunkState.DECODED)
    return record, made_of(storage)


def at_rest(receiver: Receiver, storage: SqlStorage) -> None:
    """Do what the job does, until nothing is left."""
    for _ in range(3):
        with storage.read() as unit:
            due = HeldRecordings(storage, CountingClock()).due(unit)
        list(receiver.decode(due))
        receiver.reassembler.work_off()
    with storage.read() as unit:
        assert unit.stale_spans.all() == []


def test_a_recording_that_was_placed_elsewhere_is_placed_where_its_bus_says_now(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    record, windows = decoded(sqlite_storage, tmp_path)
    assert record.first_ns is not None
    hour = 3600 * SECOND_NS
    wrong = replace(record, first_ns=START_NS - hour, last_ns=START_NS - hour + 25 * SECOND_NS)
    with sqlite_storage.write() as unit:
        unit.chunks.update(wrong)
        unit.assembled.remove(unit.windows.list("WS-1"))
        unit.stale_spans.add(VEHICLE, None, None, "the catalogue of its bus has changed")
    receiver = receiver_on(sqlite_storage, tmp_path)
    receiver.reassembler.work_off()
    at_rest(receiver, sqlite_storage)
    assert made_of(sqlite_storage) == windows
    with sqlite_storage.read() as unit:
        assert unit.chunks.get(record.digest) == record


def test_a_recording_of_another_bus_is_rejected_and_its_windows_go(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    record, windows = decoded(sqlite_storage, tmp_path)
    with sqlite_storage.write() as unit:
        unit.stale_spans.add(VEHICLE, None, None, "the catalogue of its bus has changed")
    other = replace(default_catalogue(), sample_interval_ns=2_000_000)
    raw = FileRawStore(tmp_path / "raw")
    receiver = Receiver(sqlite_storage, raw, other, CountingClock(), window_length_s=10.0)
    at_rest(receiver, sqlite_storage)
    assert windows
    assert made_of(sqlite_storage) == {}
    assert state(sqlite_storage, record) is ChunkState.REJECTED
    with sqlite_storage.read() as unit:
        assert unit.quarantine.held() == []


def test_windows_wait_where_a_recording_cannot_be_read_for_a_passing_fault(
    sqlite_storage: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, windows = decoded(sqlite_storage, tmp_path)

    def no_memory(_: Path) -> None:
        raise PassingFaultError("no memory", code="waits_for_memory")

    monkeypatch.setattr(recordings, "read_content", no_memory)
    receiver = receiver_on(sqlite_storage, tmp_path)
    with pytest.raises(StorageError, match="no memory"):
        receiver.reassembler.reassemble(VEHICLE, None, None)
    with sqlite_storage.read() as unit:
        assert unit.stale_spans.all() != [], "it is tried again"
    assert made_of(sqlite_storage) == windows
    assert state(sqlite_storage, record) is ChunkState.DECODED


@pytest.mark.parametrize("by", ["class", "catalogue"])
def test_a_rejected_recording_is_decoded_once_its_vehicle_has_its_own_bus(
    sqlite_storage: SqlStorage, tmp_path: Path, by: str
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
        right = unit.registry.vehicle(VEHICLE)
        unit.registry.add_vehicle(replace(right, vehicle_class="another"))
    fast = replace(default_catalogue(), sample_interval_ns=2_000_000)
    claim(sqlite_storage, BusChoice(fast, {}), 10 * SECOND_NS, 1)
    wrong = Receiver(sqlite_storage, FileRawStore(tmp_path / "raw"), fast, CountingClock(), window_length_s=10.0)
    (path,) = files_of([Run().frames()], tmp_path)
    with pytest.raises(LogFileError, match="SYNC comes every"):
        wrong.receive_file(path, VEHICLE)
    if by == "class":
        with sqlite_storage.write() as unit:
            unit.registry.add_vehicle(right, 1)
    else:
        claim(sqlite_storage, BusChoice(default_catalogue(), {}), 10 * SECOND_NS, 2)
    at_rest(receiver_on(sqlite_storage, tmp_path), sqlite_storage)
    assert len(made_of(sqlite_storage)) == 6
