"""Chunks that were received are decoded by workers: each once, by however many, and the same as by an ingest."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest
from log_files import write_recording
from test_log_limits import blf_bytes, blf_object
from test_receiver import CountingClock
from vehicle_bus import CATALOGUE, SECOND_NS, START_NS, VEHICLE, Run, register

from estimation.errors import StoppedError
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.runs import SubjectKind
from fleet_db.locks import decoding_locks
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import DecodedChunks, decode_received
from ingest.receipts import Arrival, Chunk, ChunkStorage, Stored
from ingest.receiver import Receiver

LENGTH_S = 5.0


def receiver_of(storage: SqlStorage) -> Receiver:
    return Receiver(
        storage, FileRawStore(storage.data_dir / "raw"), CATALOGUE, CountingClock(), window_length_s=LENGTH_S
    )


def hand_in(storage: SqlStorage, *paths: Path, vehicle: str = VEHICLE) -> list[str]:
    """Store files as chunks; return their digests."""
    raw = FileRawStore(storage.data_dir / "raw")
    arrivals = []
    for path in paths:
        incoming = raw.incoming(path.suffix)
        incoming.write(path.read_bytes())
        incoming.finish()
        arrivals.append(Arrival(incoming, Chunk(vehicle, path.suffix, path.name, None)))
    answers = ChunkStorage(storage, raw, CountingClock()).store(arrivals)
    assert all(isinstance(answer, Stored) and not answer.known for answer in answers)
    return [arrival.file.digest for arrival in arrivals]


def runs(folder: Path, count: int, seconds: float = 8.0) -> list[Path]:
    paths = []
    for number in range(count):
        paths.append(folder / f"{VEHICLE}__{number}.blf")
        start_ns = START_NS + number * round(seconds * SECOND_NS)
        write_recording(paths[-1], Run(seconds=seconds, start_ns=start_ns, seed=number + 1).frames())
    return paths


def decode(storage: SqlStorage) -> DecodedChunks:
    return decode_received(storage, receiver_of(storage), "the test", lambda _done, _total: None)


def windows(storage: SqlStorage) -> set[tuple[str, int, str]]:
    with storage.read() as unit:
        found = unit.assembled.of_vehicle(VEHICLE, 0, 1 << 62)
    return {(one.wheelset, one.start_ns, one.content_digest) for one in found}


def test_chunks_make_the_same_windows_as_an_ingest(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
    paths = runs(tmp_path, 3)
    digests = hand_in(storage, *reversed(paths))
    done = decode(storage)
    assert (done.decoded, done.others) == (3, 0)
    with storage.read() as unit:
        assert {unit.chunks.get(digest).state for digest in digests} == {ChunkState.DECODED}  # type: ignore[union-attr]
        assert unit.chunks.undecoded_size().count == 0
    made = windows(storage)
    assert made
    receiver = receiver_of(storage)
    assert [receiver.receive_file(path, VEHICLE).windows_changed for path in paths] == [0, 0, 0]
    assert windows(storage) == made


def test_what_cannot_be_decoded_is_left_with_its_reason_and_never_tried_for_ever(
    storage: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with storage.write() as unit:
        register(unit)
    broken, good = tmp_path / "broken.blf", runs(tmp_path, 1)[0]
    broken.write_bytes(good.read_bytes()[:-1000])
    (first,) = hand_in(storage, broken)
    (second,) = hand_in(storage, good, vehicle="NEW-1")
    assert decode(storage) == DecodedChunks(0, 2)
    with storage.read() as unit:
        states = {digest: unit.chunks.get(digest) for digest in (first, second)}
    assert [(one.state, code_of(one.reason)) for one in states.values() if one] == [
        (ChunkState.REJECTED, ReasonCode.LOG_DAMAGED),
        (ChunkState.STORED, ReasonCode.VEHICLE_UNKNOWN),
    ]
    (third,) = hand_in(storage, runs(tmp_path, 1, seconds=9.0)[0])
    with monkeypatch.context() as patch:
        patch.setattr(Receiver, "_decode", lambda *_: 1 / 0)
        assert decode(storage) == DecodedChunks(0, 1)
    with storage.read() as unit:
        item = unit.quarantine.get(SubjectKind.RECORDING, third, "ingest")
        assert item is not None
        assert item.code is ReasonCode.PROCESSING_FAILED
        assert unit.chunks.undecoded_size().count == 0


def test_a_vehicle_that_another_worker_decodes_is_left_to_it(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
    hand_in(storage, *runs(tmp_path, 2))
    with decoding_locks(storage.engine, "another") as try_vehicle, try_vehicle(VEHICLE) as locked:
        assert locked
        assert decode(storage) == DecodedChunks(0, 0)
    assert decode(storage) == DecodedChunks(2, 0)


def test_two_workers_decode_each_chunk_once(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
    hand_in(storage, *runs(tmp_path, 6, seconds=3.0))
    done: list[DecodedChunks] = []
    workers = [Thread(target=lambda: done.append(decode(storage))) for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(120)
    assert sum(one.decoded for one in done) + decode(storage).decoded == 6


def test_a_worker_that_is_to_stop_ends_between_two_chunks(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
    hand_in(storage, *runs(tmp_path, 3, seconds=3.0))
    reported: list[tuple[int, int]] = []

    def checkpoint(done: int, total: int) -> None:
        reported.append((done, total))
        if done == 2:
            raise StoppedError(done, total)

    with pytest.raises(StoppedError):
        decode_received(storage, receiver_of(storage), "the test", checkpoint)
    assert [done for done, _ in reported] == [1, 2]
    with storage.read() as unit:
        assert unit.chunks.undecoded_size().count == 1


def inflated_zeros(path: Path) -> str:
    """Write a BLF file of 1 MB that inflates to 1 GB."""
    path.write_bytes(blf_bytes(blf_object(96, 1 << 20) * 8, 128))
    return "inflates to more than"


def one_line_without_end(path: Path) -> str:
    """Write an ASC file of one line of 16 MB."""
    path.write_bytes(b"date Sun Jun 15 00:00:00 2025\nbase hex timestamps absolute\n" + b"0" * (1 << 24))
    return "line"


@pytest.mark.parametrize(("suffix", "hostile"), [(".blf", inflated_zeros), (".asc", one_line_without_end)])
def test_a_hostile_chunk_is_kept_aside_with_its_reason_and_the_next_is_decoded(
    storage: SqlStorage, tmp_path: Path, suffix: str, hostile: Callable[[Path], str]
) -> None:
    with storage.write() as unit:
        register(unit)
    path = tmp_path / f"{VEHICLE}__bomb{suffix}"
    reason = hostile(path)
    bomb, good = hand_in(storage, path, runs(tmp_path, 1)[0])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode(storage) == DecodedChunks(1, 1)
    with storage.read() as unit:
        first, second = unit.chunks.get(bomb), unit.chunks.get(good)
    assert first is not None
    assert second is not None
    assert (first.state, second.state) == (ChunkState.REJECTED, ChunkState.DECODED)
    assert code_of(first.reason) is ReasonCode.LOG_DAMAGED
    assert first.reason is not None
    assert reason in first.reason.text
    assert FileRawStore(storage.data_dir / "raw").fault(bomb, suffix) is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 128 << 10  # KiB, in this process
