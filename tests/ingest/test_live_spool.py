"""The spool of a live bus: what was written stays, whatever is cut off, and the rest is counted."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_listening import frames_in
from vehicle_bus import Run

from estimation.errors import ConflictError, StorageError
from ingest.frames import OVERFLOW_ID, FrameBatch, batch_of, count_dropped, dropped_marker
from ingest.live.receiver import Spooling
from ingest.live.spool import (
    FRAME_BYTES,
    DropCount,
    DropCountFile,
    FrameBuffer,
    Record,
    Spool,
    TakenOver,
    decode,
    encode,
    pack_frame,
    spool_folder,
)
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import read_piece
from ingest.logs import read_log

LIMIT = 1 << 20


def packed(batch: FrameBatch) -> bytes:
    columns = (batch.t_ns.tolist(), batch.arbitration_id.tolist(), batch.dlc.tolist(), batch.data)
    return b"".join(pack_frame(t, i, n, d.tobytes()) for t, i, n, d in zip(*columns, strict=True))


def some_frames(first: int, count: int) -> bytes:
    return b"".join(pack_frame(1000 + n, 0x181, 8, n.to_bytes(8, "little")) for n in range(first, first + count))


RECORDS = (Record(some_frames(0, 3)), Record(some_frames(3, 1), 7, 7), Record(some_frames(4, 4), 0, 7))
CONTENT = b"".join(encode(record) for record in RECORDS)
ENDS = np.cumsum([len(encode(record)) for record in RECORDS]).tolist()


@contextmanager
def held(folder: Path, limit_bytes: int = LIMIT) -> Iterator[Spool]:
    spool = Spool(folder, limit_bytes)
    try:
        yield spool
    finally:
        spool.close()


def test_whatever_is_cut_off_the_whole_records_before_it_are_used(tmp_path: Path) -> None:
    piece = tmp_path / "000000000007.frames"
    for cut in range(len(CONTENT) + 1):
        whole = sum(end <= cut for end in ENDS)
        end = ENDS[whole - 1] if whole else 0
        assert decode(CONTENT[:cut]).records == RECORDS[:whole]
        piece.write_bytes(CONTENT[:cut])
        with held(tmp_path) as spool:
            assert spool.take_over() == TakenOver(min(whole, 1), cut - end, 0)
            waiting = spool.oldest()
            assert (waiting is not None) == (whole > 0)
            assert not waiting or waiting.path.read_bytes() == CONTENT[:end]


@given(at=st.integers(0, len(CONTENT) - 1), flip=st.integers(1, 255))
def test_damage_costs_the_record_it_is_in_and_no_other(at: int, flip: int) -> None:
    damaged = bytearray(CONTENT)
    damaged[at] ^= flip
    hit = sum(end <= at for end in ENDS)
    assert decode(bytes(damaged)).records == RECORDS[:hit] + RECORDS[hit + 1 :]


def test_a_piece_becomes_the_same_recording_every_time(tmp_path: Path) -> None:
    batch = Run(seconds=1.0).frames()
    with held(tmp_path / "spool") as spool:
        spool.take_over()
        half = len(batch) // 2 * FRAME_BYTES
        spool.append(Record(packed(batch)[:half], 5, 5))
        spool.append(Record(packed(batch)[half:], 0, 5))
        spool.close_piece()
        piece = spool.oldest()
    assert piece is not None
    recording = read_piece(piece.path)
    assert recording == read_piece(piece.path)
    assert recording is not None
    assert (recording.frames, recording.dropped, recording.first_ns) == (len(batch), 5, int(batch.t_ns[0]))
    log = tmp_path / "a.blf"
    log.write_bytes(recording.content)
    stored = read_log(log)
    ours = stored.arbitration_id != OVERFLOW_ID
    assert np.array_equal(stored.t_ns[ours], batch.t_ns)
    assert np.array_equal(stored.data[ours], batch.data)
    assert count_dropped(stored) == 5
    assert stored.t_ns[~ours].tolist() == [batch.t_ns[len(batch) // 2 - 1]]
    piece.path.write_bytes(CONTENT[: ENDS[0] - 1])
    assert read_piece(piece.path) is None


def test_dropped_frames_are_counted_by_the_frames_that_say_so() -> None:
    assert count_dropped(dropped_marker(1, 3, "can0")) == 3
    assert count_dropped(dropped_marker(1, 1 << 40, "can0")) == 0xFFFF_FFFF
    others = {(0, 1, 0, 0, 9, 9, 9, 9): 1, (0xDD, 1, 0, 0, 2, 1, 0, 0): 258, (0xDD, 2, 0, 0, 2, 1, 0, 0): 0}
    for payload, count in others.items():
        data = np.array([payload], np.uint8)
        assert count_dropped(batch_of(OVERFLOW_ID, np.array([1]), data, 8)) == count
        assert count_dropped(batch_of(0x004, np.array([1]), data, 8)) == 0


def test_a_full_spool_refuses_and_removes_nothing(tmp_path: Path) -> None:
    record = Record(some_frames(0, 4))
    size = len(encode(record))
    with held(tmp_path, limit_bytes=3 * size) as spool:
        spool.take_over()
        for _ in range(2):
            spool.append(record)
            spool.close_piece()
        spool.append(record)
        with pytest.raises(StorageError, match=f"the spool is full: {3 * size} of {3 * size} bytes"):
            spool.append(record)
        assert (spool.size_bytes, spool.pieces_waiting) == (3 * size, 2)
        oldest = spool.oldest()
        assert oldest is not None
        spool.remove(oldest)
        spool.append(record)
        assert spool.size_bytes == 3 * size == sum(path.stat().st_size for path in tmp_path.glob("*.frames"))


def test_one_process_holds_a_spool(tmp_path: Path) -> None:
    with held(tmp_path), pytest.raises(ConflictError, match=rf"another receiver .*process {os.getpid()}"):
        Spool(tmp_path, LIMIT)
    with held(tmp_path):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="cannot be used: Not a directory"):
        Spool(tmp_path / "file" / "spool", LIMIT)


def test_every_vehicle_has_a_folder_of_its_own(tmp_path: Path) -> None:
    vehicles = ["L-1", "..", ".", "a/b", "a%2Fb", "../x", "Zug 1", ".x", "%2Ex"]
    folders = [spool_folder(tmp_path, vehicle) for vehicle in vehicles]
    assert len(set(folders)) == len(vehicles)
    assert all(folder.resolve().parent == tmp_path.resolve() for folder in folders)
    assert folders[0] == tmp_path / "L-1"


def test_a_piece_set_aside_is_out_of_the_way_until_the_next_start(tmp_path: Path) -> None:
    with held(tmp_path) as spool:
        spool.take_over()
        for record in RECORDS[:2]:
            spool.append(record)
            spool.close_piece()
        first = spool.oldest()
        assert first is not None
        spool.set_aside(first)
        second = spool.oldest()
        assert second is not None
        assert decode(second.path.read_bytes()).records == RECORDS[1:2]
        assert (spool.pieces_aside, spool.pieces_waiting, spool.size_bytes) == (1, 1, ENDS[1])
    with held(tmp_path) as spool:
        assert spool.take_over() == TakenOver(2, 0, 0)
        spool.append(RECORDS[2])
        spool.close_piece()
        kept = []
        while (piece := spool.oldest()) is not None:
            kept += decode(piece.path.read_bytes()).records
            spool.remove(piece)
        assert tuple(kept) == RECORDS
        assert spool.size_bytes == 0


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no write of this process go beyond a byte of a file: the disk is full there."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_write_that_fails_half_way_leaves_what_was_written_before(tmp_path: Path) -> None:
    with held(tmp_path) as spool:
        spool.take_over()
        spool.append(RECORDS[0])
        with largest_file(ENDS[0] + 20), pytest.raises(OSError, match="File too large"):
            spool.append(RECORDS[1])
        assert (spool.size_bytes, spool.pieces_waiting) == (ENDS[0], 1)
        spool.append(RECORDS[1])
        spool.append(RECORDS[2])
    with held(tmp_path) as spool:
        assert spool.take_over() == TakenOver(2, 0, 0)
        assert b"".join(path.read_bytes() for path in sorted(tmp_path.glob("*.frames"))) == CONTENT


def test_the_count_of_dropped_frames_survives_a_torn_write(tmp_path: Path) -> None:
    path = tmp_path / "dropped"
    counts = DropCountFile(path)
    counts.write(DropCount(5, 2))
    before = path.read_bytes()
    counts.write(DropCount(9, 9))
    counts.close()
    after = path.read_bytes()
    assert DropCountFile(path).count == DropCount(9, 9)
    changed = [at for at in range(len(after)) if before[at] != after[at]]
    for at in changed[:-1]:
        path.write_bytes(after[: at + 1] + before[at + 1 :])
        assert DropCountFile(path).count == DropCount(5, 2)


def test_a_count_that_only_a_record_mentions_is_not_lost(tmp_path: Path) -> None:
    with held(tmp_path) as spool:
        spool.take_over()
        spool.append(RECORDS[1])  # killed before the count was written
    with held(tmp_path) as spool:
        assert spool.drop_count == DropCount(0, 0)
        spool.take_over()
        assert spool.drop_count == DropCount(7, 7)


def spooling_on(spool: Spool, buffer: FrameBuffer, said: list[str]) -> tuple[Spooling, LiveStatus]:
    status = LiveStatus()
    reports = Reports(lambda text, *, bad=False: said.append(f"{'bad: ' if bad else ''}{text}"), lambda *_: None)
    return Spooling(spool, buffer, 60.0, status, reports), status


def test_what_is_dropped_is_said_counted_and_kept_over_a_restart(tmp_path: Path) -> None:
    said: list[str] = []
    buffer = FrameBuffer(4 * FRAME_BYTES)
    limit_bytes = len(encode(Record(some_frames(0, 5))))
    with held(tmp_path, limit_bytes=limit_bytes) as spool:
        spooling, status = spooling_on(spool, buffer, said)
        assert spooling._take_over()
        for round_of in range(3):  # 4 frames reach the disk, 4 the record that waits, 4 the memory; then it is full
            for frame in range(4):
                buffer.add(some_frames(4 * round_of + frame, 1))
            spooling._step()
        for _ in range(6):
            buffer.add(some_frames(99, 1))
        spooling._step()
        assert status.frames_dropped == 6
        assert spool.drop_count == DropCount(6, 0)
        assert [text for text in said if "dropped" in text] == [
            f"bad: 6 frames dropped: the spool is full: {spool.size_bytes} of {limit_bytes} bytes"
        ]
        assert spool.pieces_waiting == 1, "what waits can be stored"
    again = FrameBuffer(LIMIT)
    with held(tmp_path) as spool:
        spooling, status = spooling_on(spool, again, said)
        spooling._take_over()
        assert status.frames_dropped == 6
        again.add(some_frames(50, 1))
        spooling._step()
        assert spool.drop_count == DropCount(6, 6)
        spool.close_piece()
        pieces = sorted(tmp_path.glob("*.frames"))
        assert sum(record.dropped for piece in pieces for record in decode(piece.read_bytes()).records) == 6
    with held(tmp_path) as spool:
        spooling, status = spooling_on(spool, FrameBuffer(LIMIT), said)
        spooling._take_over()
        spooling._step()
        assert status.frames_dropped == 6


def test_frames_wait_in_memory_while_the_disk_takes_nothing(tmp_path: Path) -> None:
    said: list[str] = []
    buffer = FrameBuffer(LIMIT)
    with held(tmp_path) as spool:
        spooling, status = spooling_on(spool, buffer, said)
        spooling._take_over()
        for part in range(3):
            buffer.add(some_frames(part, 1))
            with largest_file(20):
                spooling._step()
            assert "File too large" in str(status.spool_fault)
        spooling._step()
        assert status.spool_fault is None
        spool.close_piece()
        piece = spool.oldest()
        assert piece is not None
        frames = b"".join(record.frames for record in decode(piece.path.read_bytes()).records)
        assert np.array_equal(frames_in(frames).data, frames_in(some_frames(0, 3)).data)
    assert said == [
        "bad: frames wait in memory, they cannot be written: [Errno 27] File too large",
        "frames reach the spool again",
    ]
