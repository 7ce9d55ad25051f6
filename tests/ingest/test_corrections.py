"""Recordings set aside, restored, moved, tried again: the windows are those of a fleet without the mistake."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from sqlalchemy import select
from vehicle_bus import OFFSETS_M, SECOND_NS, VEHICLE, Run, register

from estimation.errors import ConflictError, LogFileError, NotFoundError
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import SubjectKind
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState, RecordingAction
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.windows import WindowRow
from ingest.catalogue import TIME_ID, default_catalogue
from ingest.corrections import Author, RecordingCorrections
from ingest.frames import FrameBatch, take
from ingest.logs import write_blf
from ingest.receiver import ChunkReceipt, Receiver

OTHER = "V-OTHER"
AUTHOR = Author("kim", "was mixed up")
Windows = set[tuple[str, int, str, str, float]]


class CountingClock:
    def __init__(self) -> None:
        self._count = itertools.count(1_800_000_000 * SECOND_NS)

    def now_ns(self) -> int:
        return next(self._count)


class Deployment:
    """A store with two vehicles, and what receives and corrects."""

    def __init__(self, storage: SqlStorage, directory: Path) -> None:
        clock = CountingClock()
        self.storage = storage
        self.receiver = Receiver(storage, FileRawStore(directory / "raw"), default_catalogue(), clock, 10.0)
        self.corrections = RecordingCorrections(storage, clock)

    def receive(self, path: Path, vehicle: str = VEHICLE) -> str:
        return self.receiver.receive_file(path, vehicle).record.digest

    def rest(self) -> list[ChunkReceipt | Exception]:
        """Decode and assemble until nothing is left to do."""
        found = list(self.receiver.decode_stored())
        self.receiver.reassembler.work_off()
        return found

    def windows(self) -> Windows:
        columns = [
            table_of(WindowRow).c[name] for name in ("vehicle", "start_ns", "wheelset", "content_digest", "mileage_km")
        ]
        self.receiver.reassembler.work_off()
        with self.storage.read() as unit:
            return {tuple(row) for row in unit.connection.execute(select(*columns))}


@pytest.fixture
def deployment(storage: SqlStorage, tmp_path: Path) -> Deployment:
    with storage.write() as unit:
        register(unit)
        unit.registry.add_vehicle(VehicleRecord(OTHER, "north", "multiple unit", 2, 40.0, OFFSETS_M))
        for axle in (1, 2):
            unit.registry.add_wheelset(WheelsetRecord(f"OT-{axle}", "north", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(f"OT-{axle}", OTHER, axle, 0, None, 4000.0, 100.0 * axle))
    return Deployment(storage, tmp_path)


def pieces(folder: Path, *batches: FrameBatch) -> list[Path]:
    paths = [folder / f"{number}.blf" for number in range(len(batches))]
    for path, batch in zip(paths, batches, strict=True):
        write_blf(path, batch)
    return paths


def halves(folder: Path) -> list[Path]:
    run = Run(seconds=26.0).frames()
    half = len(run) // 2
    return pieces(folder, take(run, slice(0, half)), take(run, slice(half, None)))


def test_one_that_was_set_aside_counts_no_more_and_restored_it_counts_again(
    deployment: Deployment, tmp_path: Path
) -> None:
    first, second = halves(tmp_path)
    deployment.receive(first)
    alone = deployment.windows()
    digest = deployment.receive(second)
    both = deployment.windows()
    assert alone != both
    assert deployment.corrections.correct(digest, RecordingAction.SET_ASIDE, AUTHOR).state is ChunkState.SET_ASIDE
    deployment.rest()
    assert deployment.windows() == alone
    assert deployment.receive(second) == digest  # received again it stays aside
    deployment.rest()
    assert deployment.windows() == alone
    deployment.corrections.correct(digest, RecordingAction.RESTORE, AUTHOR)
    deployment.rest()
    assert deployment.windows() == both
    with deployment.storage.read() as unit:
        changes = unit.recording_changes.list(digest)
    assert [(one.action, one.state_before, one.state_after) for one in changes] == [
        (RecordingAction.SET_ASIDE, ChunkState.DECODED, ChunkState.SET_ASIDE),
        (RecordingAction.RESTORE, ChunkState.SET_ASIDE, ChunkState.STORED),
    ]
    assert {(one.actor, one.why) for one in changes} == {("kim", "was mixed up")}


def test_one_that_came_from_the_wrong_vehicle_is_moved_as_if_it_had_come_from_the_right_one(
    deployment: Deployment, tmp_path: Path
) -> None:
    first, second = halves(tmp_path)
    deployment.receive(first)
    digest = deployment.receive(second)
    of_one = deployment.windows()
    with pytest.raises(ConflictError, match=f"recordings reassign {digest[:12]} --vehicle {OTHER}"):
        deployment.receive(second, OTHER)
    deployment.corrections.correct(digest, RecordingAction.REASSIGN, AUTHOR, OTHER)
    deployment.rest()
    moved = deployment.windows()
    assert {row[0] for row in moved} == {VEHICLE, OTHER}
    assert {row[2] for row in moved if row[0] == OTHER} == {"OT-1", "OT-2"}
    assert deployment.receive(second, OTHER) == digest
    deployment.corrections.correct(digest, RecordingAction.REASSIGN, AUTHOR, VEHICLE)  # and back
    deployment.rest()
    assert deployment.windows() == of_one
    with pytest.raises(ConflictError, match=f"is of vehicle {VEHICLE} already"):
        deployment.corrections.correct(digest, RecordingAction.REASSIGN, AUTHOR, VEHICLE)
    with pytest.raises(NotFoundError, match="no vehicle 'nobody'"):
        deployment.corrections.correct(digest, RecordingAction.REASSIGN, AUTHOR, "nobody")


def test_those_that_it_had_given_their_time_wait_without_it(deployment: Deployment, tmp_path: Path) -> None:
    run = Run(seconds=26.0).frames()
    half = len(run) // 2
    early, late = take(run, slice(0, half)), take(run, slice(half, None))
    with_time, without = pieces(tmp_path, early, take(late, late.arbitration_id != TIME_ID))
    digest = deployment.receive(with_time)
    waiting = deployment.receive(without)
    both = deployment.windows()
    deployment.corrections.correct(digest, RecordingAction.SET_ASIDE, AUTHOR)
    deployment.rest()
    assert deployment.windows() == set()
    with deployment.storage.read() as unit:
        record = unit.chunks.get(waiting)
    assert record is not None
    assert record.reason is not None
    assert (record.state, record.reason.code) == (ChunkState.STORED, ReasonCode.WAITS_FOR_TIME)
    deployment.corrections.correct(digest, RecordingAction.RESTORE, AUTHOR)
    deployment.rest()
    assert deployment.windows() == both


def test_one_that_was_rejected_is_tried_again_by_hand_only(deployment: Deployment, tmp_path: Path) -> None:
    path = tmp_path / "0.blf"
    path.write_bytes(b"LOGG" + bytes(200))
    with pytest.raises(LogFileError):
        deployment.receive(path)
    with deployment.storage.read() as unit:
        (record,) = unit.chunks.with_state(ChunkState.REJECTED)
    assert deployment.rest() == []
    deployment.corrections.correct(record.digest[:12], RecordingAction.RETRY, AUTHOR)
    (error,) = deployment.rest()
    assert isinstance(error, LogFileError)
    deployment.corrections.correct(record.digest, RecordingAction.SET_ASIDE, AUTHOR)
    with pytest.raises(ConflictError, match="is set_aside"):
        deployment.corrections.correct(record.digest, RecordingAction.RETRY, AUTHOR)
    with pytest.raises(NotFoundError, match="no recording 'ffff'"):
        deployment.corrections.correct("ffff", RecordingAction.RETRY, AUTHOR)
    with deployment.storage.read() as unit:
        assert unit.quarantine.get(SubjectKind.RECORDING, record.digest, "ingest") is None


def test_one_that_was_deleted_is_as_if_it_had_never_come_and_comes_back_only_when_asked(
    deployment: Deployment, tmp_path: Path
) -> None:
    first, second = halves(tmp_path)
    deployment.receive(first)
    never = deployment.windows()
    digest = deployment.receive(second)
    both = deployment.windows()
    assert never != both
    raw = FileRawStore(tmp_path / "raw")
    record = deployment.corrections.delete(digest, AUTHOR, raw)
    deployment.rest()
    assert deployment.windows() == never
    assert not raw.path(digest, ".blf").exists()
    assert record.reason is not None
    assert record.reason.text.endswith(" by kim: was mixed up")
    with pytest.raises(ConflictError, match=rf"{digest[:12]} was deleted at .* by kim: was mixed up; .*--take-deleted"):
        deployment.receive(second)
    assert not raw.path(digest, ".blf").exists()  # nothing of what was refused stays
    assert deployment.receiver.keep(second.read_bytes(), ".blf", VEHICLE, "a")[0].state is ChunkState.DELETED
    assert not raw.path(digest, ".blf").exists()
    with pytest.raises(ConflictError, match="is deleted"):
        deployment.corrections.correct(digest, RecordingAction.RESTORE, AUTHOR)
    deployment.receiver = Receiver(
        deployment.storage, raw, default_catalogue(), CountingClock(), 10.0, deleted_taken_by="lee"
    )
    assert deployment.receive(second) == digest
    assert deployment.windows() == both
    with deployment.storage.read() as unit:
        changes = unit.recording_changes.list(digest)
    assert [(one.action, one.actor) for one in changes] == [("delete", "kim"), ("take_again", "lee")]


def test_one_under_the_name_of_no_vehicle_is_as_if_it_had_come_for_the_one_that_it_is_given_to(
    deployment: Deployment, tmp_path: Path
) -> None:
    first, second = halves(tmp_path)
    digests = [deployment.receive(path) for path in (first, second)]
    at_first = deployment.windows()
    raw = FileRawStore(tmp_path / "raw")
    for digest in digests:
        deployment.corrections.delete(digest, AUTHOR, raw)
    deployment.rest()
    assert deployment.windows() == set()
    deployment.receiver = Receiver(
        deployment.storage, raw, default_catalogue(), CountingClock(), 10.0, deleted_taken_by="lee"
    )
    for path in (first, second):
        with pytest.raises(NotFoundError, match="no vehicle 'nobody'"):
            deployment.receive(path, "nobody")
    for digest in digests:
        assert (
            deployment.corrections.correct(digest, RecordingAction.REASSIGN, AUTHOR, VEHICLE).state is ChunkState.STORED
        )
    deployment.rest()
    assert deployment.windows() == at_first
