"""Faults that pass reject no recording, and one recording that cannot be decoded keeps no other from it."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import psycopg
import pytest
from sqlalchemy import delete, event, select, update
from vehicle_bus import OFFSETS_M, SECOND_NS, START_NS, VEHICLE, Run, register

from estimation.errors import PassingFaultError, StorageError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.runs import JobTrigger
from fleet_db.raw import MARK_NAME, FileRawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.chunks import ChosenChunks
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.windows import WindowRow
from ingest.catalogue import TIME_ID, default_catalogue
from ingest.frames import from_owned_arrays, take
from ingest.intake.backlog import assemble_windows
from ingest.logs import write_blf
from ingest.logs.formats import stop_server
from ingest.receiver import ChunkReceipt, Receiver
from ingest.span_commit import SpanChanges

MINUTE_NS = 60 * SECOND_NS
YEAR_OF_START = 40  # place of the year of the start in the header of a BLF file


@dataclass
class SetClock:
    at_ns: int

    def now_ns(self) -> int:
        return self.at_ns


@pytest.fixture
def registered(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


@pytest.fixture
def clock() -> SetClock:
    return SetClock(START_NS + 3600 * SECOND_NS)


def receiver_on(storage: SqlStorage, directory: Path, clock: SetClock) -> Receiver:
    """Return a receiver as a new process would have it."""
    return Receiver(storage, FileRawStore(directory / "raw"), default_catalogue(), clock, window_length_s=10.0)


def recording(folder: Path, number: int = 0) -> Path:
    path = folder / f"{VEHICLE}__{number}.blf"
    write_blf(path, Run(seconds=12.0, start_ns=START_NS + number * MINUTE_NS).frames())
    return path


def states(storage: SqlStorage) -> list[tuple[ChunkState, ReasonCode | None]]:
    with storage.read() as unit:
        found: list[ChunkRecord] = unit.chunks.page(ChosenChunks(), 100)
    return sorted((one.state, None if one.reason is None else one.reason.code) for one in found)


def pending(storage: SqlStorage) -> int:
    with storage.read() as unit:
        return unit.windows.counts()["pending"]


def windows_away(directory: Path) -> None:
    """Put a file where the folder of the windows should be: nothing can be written below it."""
    (directory / "data").mkdir(exist_ok=True)
    (directory / "data" / "windows").touch()


@contextmanager
def no_file_longer_than(size: int) -> Iterator[None]:
    """Let the system refuse to write more: the write fails half way, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_under_the_raw_store_stores_nothing_and_the_same_again_succeeds(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    path = recording(tmp_path)
    receiver = receiver_on(registered, tmp_path, clock)
    receiver.receive_file(recording(tmp_path, 1), VEHICLE)
    with no_file_longer_than(1000), pytest.raises(PassingFaultError) as raised:
        receiver.receive_file(path, VEHICLE)
    assert raised.value.code == "waits_for_storage"
    assert len(states(registered)) == 1
    assert not list((tmp_path / "raw").rglob(".incoming-*"))
    receiver.receive_file(path, VEHICLE)
    assert states(registered) == [(ChunkState.DECODED, None)] * 2


def test_windows_that_cannot_be_written_leave_the_recording_stored_and_the_next_start_decodes_it(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    path = recording(tmp_path)
    windows_away(tmp_path)
    receipt = receiver_on(registered, tmp_path, clock).receive_file(path, VEHICLE)
    assert receipt.record.reason is not None
    assert (receipt.record.state, receipt.record.reason.code) == (ChunkState.STORED, ReasonCode.WAITS_FOR_STORAGE)
    (again,) = receiver_on(registered, tmp_path, clock).decode_stored()  # the first retry is at once
    assert isinstance(again, ChunkReceipt)
    assert again.record.state is ChunkState.STORED
    (tmp_path / "data" / "windows").unlink()
    assert list(receiver_on(registered, tmp_path, clock).decode_stored()) == []  # the second after a minute
    clock.at_ns += MINUTE_NS
    (decoded,) = receiver_on(registered, tmp_path, clock).decode_stored()
    assert isinstance(decoded, ChunkReceipt)
    assert (decoded.record.state, decoded.record.reason) == (ChunkState.DECODED, None)
    with registered.read() as unit:
        assert unit.quarantine.held() == []


def test_a_raw_store_that_is_not_mounted_is_refused_and_nothing_is_rejected_or_written(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    windows_away(tmp_path)
    receiver_on(registered, tmp_path, clock).receive_file(recording(tmp_path), VEHICLE)
    (tmp_path / "data" / "windows").unlink()
    before = states(registered)
    raw, away = tmp_path / "raw", tmp_path / "away"
    assert (raw / MARK_NAME).is_file()
    raw.rename(away)
    for bare in (False, True):  # the folder is not there, or empty
        if bare:
            raw.mkdir()
        receiver = receiver_on(registered, tmp_path, clock)
        (refusal,) = receiver.decode_stored()
        assert isinstance(refusal, PassingFaultError)
        assert "is it mounted?" in str(refusal)
        with pytest.raises(PassingFaultError, match=f"{raw}: .*is it mounted"):
            receiver.receive_file(recording(tmp_path, 1), VEHICLE)
    assert states(registered) == before
    assert list(raw.iterdir()) == []
    raw.rmdir()
    away.rename(raw)
    (decoded,) = receiver_on(registered, tmp_path, clock).decode_stored()
    assert isinstance(decoded, ChunkReceipt)
    assert decoded.record.state is ChunkState.DECODED


def test_a_raw_store_that_goes_while_a_receiver_runs_is_noticed(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    receiver = receiver_on(registered, tmp_path, clock)
    receiver.receive_file(recording(tmp_path), VEHICLE)
    (tmp_path / "raw").rename(tmp_path / "away")
    with pytest.raises(PassingFaultError, match="is it mounted"):
        receiver.receive_file(recording(tmp_path, 1), VEHICLE)
    assert not (tmp_path / "raw").exists()


def test_a_folder_with_the_recordings_but_without_the_mark_is_marked(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    receiver_on(registered, tmp_path, clock).receive_file(recording(tmp_path), VEHICLE)
    mark = tmp_path / "raw" / MARK_NAME
    text = mark.read_text()
    mark.unlink()  # a restored folder
    receiver_on(registered, tmp_path, clock).receive_file(recording(tmp_path, 1), VEHICLE)
    assert mark.read_text() == text


def test_a_raw_file_that_cannot_be_read_is_not_rejected(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    windows_away(tmp_path)
    digest = receiver_on(registered, tmp_path, clock).receive_file(recording(tmp_path), VEHICLE).record.digest
    (tmp_path / "data" / "windows").unlink()
    path = FileRawStore(tmp_path / "raw").path(digest, ".blf")
    whole = path.read_bytes()
    path.unlink()
    path.mkdir()  # the system refuses to read it, for root too
    (held,) = receiver_on(registered, tmp_path, clock).decode_stored()
    assert isinstance(held, ChunkReceipt)
    assert states(registered) == [(ChunkState.STORED, ReasonCode.WAITS_FOR_STORAGE)]
    path.rmdir()
    path.write_bytes(whole)
    clock.at_ns += MINUTE_NS
    (decoded,) = receiver_on(registered, tmp_path, clock).decode_stored()
    assert isinstance(decoded, ChunkReceipt)
    assert states(registered) == [(ChunkState.DECODED, None)]


END_OTHERS = """SELECT pg_terminate_backend(pid) FROM pg_stat_activity
WHERE datname = current_database() AND pid <> pg_backend_pid() AND backend_type = 'client backend'"""


def test_a_database_that_breaks_off_anywhere_in_decoding_is_a_fault_that_passes(
    postgres_storage: SqlStorage, postgres_url: str, tmp_path: Path, clock: SetClock
) -> None:
    with postgres_storage.write() as unit:
        register(unit)
    receiver = receiver_on(postgres_storage, tmp_path, clock)
    broken = statements = 0
    break_at: int | None = None

    def count(*_: object) -> None:
        nonlocal statements
        statements += 1
        if statements == break_at:
            with psycopg.connect(postgres_url, autocommit=True) as other:
                other.execute(END_OTHERS)

    event.listen(postgres_storage.engine, "before_cursor_execute", count)
    for number in range(4):
        record, _ = receiver.keep(recording(tmp_path, number).read_bytes(), ".blf", VEHICLE, "a")
        statements, break_at = 0, 1 + 5 * number
        (outcome,) = receiver.decode([record])
        broken += statements >= break_at
        if isinstance(outcome, ChunkReceipt):
            assert outcome.record.reason is not None
            assert outcome.record.reason.code is ReasonCode.WAITS_FOR_STORAGE
        else:
            assert isinstance(outcome, StorageError)
        break_at = None
        (again,) = receiver_on(postgres_storage, tmp_path, clock).decode_stored()  # at once
        assert isinstance(again, ChunkReceipt)
        assert (again.record.digest, again.record.state) == (record.digest, ChunkState.DECODED)
    assert broken == 4


def of_1984(folder: Path) -> Path:
    """Return a recording of which one TIME frame is zero: midnight of the first day of 1984."""
    run = Run(seconds=12.0).frames()
    data = run.data.copy()
    data[np.flatnonzero(run.arbitration_id == TIME_ID)[5]] = 0
    path = folder / f"{VEHICLE}__1984.blf"
    write_blf(path, from_owned_arrays(run.channel, run.t_ns.copy(), run.arbitration_id.copy(), run.dlc.copy(), data))
    return path


def of_6120(folder: Path) -> Path:
    """Return a recording whose header says that it began in the year 6120."""
    path = recording(folder, 7)
    content = bytearray(path.read_bytes())
    content[YEAR_OF_START : YEAR_OF_START + 2] = (6120).to_bytes(2, "little")
    other = folder / f"{VEHICLE}__6120.blf"
    other.write_bytes(content)
    path.unlink()
    return other


@pytest.mark.parametrize("bad", [of_1984, of_6120])
def test_an_impossible_time_ends_no_ingest_now_or_at_the_next_start(
    registered: SqlStorage, tmp_path: Path, clock: SetClock, bad: object
) -> None:
    assert callable(bad)
    files = [bad(tmp_path), recording(tmp_path, 1), recording(tmp_path, 2)]
    outcomes = dict(receiver_on(registered, tmp_path, clock).receive_files((path, VEHICLE) for path in files))
    assert [path for path in files if path in outcomes] == files
    good = [outcomes[path] for path in files[1:]]
    assert [one.record.state for one in good if isinstance(one, ChunkReceipt)] == [ChunkState.DECODED] * 2
    assert pending(registered) >= 8
    list(receiver_on(registered, tmp_path, clock).decode_stored())
    again = receiver_on(registered, tmp_path, clock).receive_file(recording(tmp_path, 3), VEHICLE)
    assert again.record.state is ChunkState.DECODED


def test_a_failure_of_the_program_holds_its_recording_and_the_others_go_on(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    run = Run(seconds=12.0).frames()
    without = tmp_path / f"{VEHICLE}__without.blf"
    write_blf(without, take(run, run.arbitration_id != TIME_ID))
    receiver_on(registered, tmp_path, clock).receive_file(without, VEHICLE)
    table = table_of(ChunkRow)
    with registered.engine.begin() as connection:
        counts = connection.scalar(select(table.c.counts))
        connection.execute(update(table).values(counts={"recorder_first_ns": 0}))  # damaged: its end is missing
    first, second = recording(tmp_path, 1), recording(tmp_path, 2)
    with registered.write() as unit:
        unit.registry.add_vehicle(VehicleRecord("N-8", "north", "multiple unit", 2, 40.0, OFFSETS_M))
    files = [(first, VEHICLE), (second, "N-8")]
    (_, held), (_, other) = receiver_on(registered, tmp_path, clock).receive_files(files)
    assert isinstance(held, ChunkReceipt)
    assert isinstance(other, ChunkReceipt)
    assert other.record.state is ChunkState.DECODED
    assert held.record.reason is not None
    assert (held.record.state, held.record.reason.code) == (ChunkState.STORED, ReasonCode.PROCESSING_FAILED)
    assert held.record.reason.text == "KeyError: 'recorder_last_ns'"
    with registered.read() as unit:
        (item,) = unit.quarantine.held("ingest")
    assert (item.key, item.attempts, item.due_ns - item.last_ns) == (held.record.digest, 1, MINUTE_NS)
    with registered.engine.begin() as connection:
        connection.execute(update(table).where(table.c.reason_code == "waits_for_time").values(counts=counts))
    clock.at_ns = item.due_ns - 1
    list(receiver_on(registered, tmp_path, clock).decode_stored())
    assert (ChunkState.STORED, ReasonCode.PROCESSING_FAILED) in states(registered)
    clock.at_ns = item.due_ns
    list(receiver_on(registered, tmp_path, clock).decode_stored())
    assert (ChunkState.STORED, ReasonCode.PROCESSING_FAILED) not in states(registered)


def test_the_scheduled_job_decodes_what_is_due(registered: SqlStorage, tmp_path: Path, clock: SetClock) -> None:
    windows_away(tmp_path)
    receiver = receiver_on(registered, tmp_path, clock)
    receiver.receive_file(recording(tmp_path), VEHICLE)
    receiver.reassembler.work_off()
    (tmp_path / "data" / "windows").unlink()
    assembly = partial(assemble_windows, lambda _: receiver_on(registered, tmp_path, clock))
    job = Job("assemble_windows", "", 60.0, assembly)
    run = run_job(job, JobContext(registered, clock, "test", JobSettings()), JobTrigger.SCHEDULE)
    assert (run.outcome, run.counts["decoded"]) == ("succeeded", 1)
    assert states(registered) == [(ChunkState.DECODED, None)]


def test_a_vehicle_whose_windows_cannot_be_made_again_keeps_no_other_waiting(
    registered: SqlStorage, tmp_path: Path, clock: SetClock
) -> None:
    with registered.write() as unit:
        unit.registry.add_vehicle(VehicleRecord("N-8", "north", "multiple unit", 2, 40.0, OFFSETS_M))
        for axle in (1, 2):
            unit.registry.add_wheelset(WheelsetRecord(f"OT-{axle}", "north", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(f"OT-{axle}", "N-8", axle, 0, None, 4000.0, 100.0 * axle))
    receiver = receiver_on(registered, tmp_path, clock)
    receiver.receive_file(recording(tmp_path, 1), VEHICLE)
    digest = receiver.receive_file(recording(tmp_path, 2), "N-8").record.digest
    receiver.reassembler.work_off()
    table = table_of(ChunkRow)
    with registered.engine.begin() as connection:
        connection.execute(
            update(table).where(table.c.digest != digest).values(suffix="blf")
        )  # damaged: no file ending
    with registered.write() as unit:
        unit.connection.execute(delete(table_of(WindowRow)))
        for vehicle in (VEHICLE, "N-8"):
            unit.stale_spans.add(vehicle, None, None, "test")
    changes = receiver_on(registered, tmp_path, clock).reassembler.work_off()
    assert (changes.new, changes.quarantined) == (4, 1)
    with registered.read() as unit:
        (item,) = unit.quarantine.held("assemble_windows")
        assert {span.vehicle for span in unit.stale_spans.all()} == {VEHICLE}
    assert (item.key, item.attempts) == (VEHICLE, 1)
    assert receiver_on(registered, tmp_path, clock).reassembler.work_off().quarantined == 1
    with registered.read() as unit:
        assert unit.quarantine.held() == [item]  # not due: nothing was tried
    with registered.engine.begin() as connection:
        connection.execute(update(table).values(suffix=".blf"))
    clock.at_ns = item.due_ns
    assert receiver_on(registered, tmp_path, clock).reassembler.work_off() == SpanChanges(new=4)
    with registered.read() as unit:
        assert unit.quarantine.held() == []


def test_a_recording_whose_format_needs_an_extra_waits_for_it(
    registered: SqlStorage, tmp_path: Path, clock: SetClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "asammdf.py").write_text("raise ImportError('not installed')")
    path = tmp_path / f"{VEHICLE}__1.mf4"
    path.write_bytes(b"MDF     4.10" + bytes(200))
    with monkeypatch.context() as without:
        without.setenv("PYTHONPATH", str(tmp_path / "hidden"))  # the process that reads looks here first
        stop_server()
        receiver_on(registered, tmp_path, clock).receive_file(path, VEHICLE)
        stop_server()
    assert states(registered) == [(ChunkState.STORED, ReasonCode.WAITS_FOR_EXTRA)]
    list(receiver_on(registered, tmp_path, clock).decode_stored())
    assert states(registered) == [(ChunkState.REJECTED, ReasonCode.LOG_DAMAGED)]  # read now, and no MF4 file inside
