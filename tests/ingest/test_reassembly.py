"""Windows are what recordings and registry give: a change of either, or a lost file, makes them again."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_receiver import CountingClock, content, files_of
from vehicle_bus import OFFSETS_M, SECOND_NS, SECTION, START_NS, VEHICLE, Run, register

from bench.put_values import put_mountings
from estimation.errors import NotFoundError, StoppedError, StorageError
from estimation.jobs.job import JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import WindowPosition, WindowState
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest import reassembly
from ingest.assembly import Assembler, SpanAssembly
from ingest.catalogue import default_catalogue
from ingest.frames import FrameBatch, take
from ingest.receiver import ChunkReceipt, Receiver
from ingest.span_commit import NO_CHANGES, SpanChanges

LENGTH_S = 10.0
LENGTH_NS = 10 * SECOND_NS
Windows = dict[tuple[str, int], tuple[str, float]]


def receiver_on(storage: SqlStorage, directory: Path, length_s: float = LENGTH_S) -> Receiver:
    raw = FileRawStore(directory / "raw")
    return Receiver(storage, raw, default_catalogue(), CountingClock(), window_length_s=length_s)


def pieces_of(run: Run, *seconds: float) -> list[FrameBatch]:
    """Return a run in pieces that end after so many seconds."""
    batch = run.frames()
    edges = [0, *np.searchsorted(batch.t_ns, batch.t_ns[0] + np.array(seconds) * 1e9).tolist(), len(batch)]
    return [take(batch, slice(a, b)) for a, b in itertools.pairwise(edges)]


def received(storage: SqlStorage, directory: Path, pieces: Sequence[FrameBatch]) -> Receiver:
    """Return the receiver that has taken in the pieces of a run."""
    receiver = receiver_on(storage, directory)
    receiver.reassembler.work_off()  # as every start of an ingest does
    for path in files_of(list(pieces), directory):
        receiver.receive_file(path, VEHICLE)
    return receiver


def made_of(storage: SqlStorage) -> Windows:
    with storage.read() as unit:
        return content(unit)


@pytest.fixture
def expected(migrated_sqlite_file: Path, tmp_path: Path) -> Windows:
    """Return the windows of the run where the registry was right from the beginning."""
    folder = tmp_path / "expected"
    folder.mkdir()
    shutil.copyfile(migrated_sqlite_file, folder / "treadwatch.sqlite3")
    storage = SqlStorage(database_engine(f"sqlite:///{folder / 'treadwatch.sqlite3'}"), folder)
    with storage.write() as unit:
        register(unit)
    received(storage, folder, pieces_of(Run(), 11.0))
    found = made_of(storage)
    storage.close()
    assert len(found) == 6
    return found


def bare(storage: SqlStorage) -> None:
    """Register vehicle and wheelsets, but neither mountings nor the section."""
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("north", "North"))
        unit.registry.add_vehicle(VehicleRecord(VEHICLE, "north", "multiple unit", 2, 40.0, OFFSETS_M))
        for axle in (1, 2):
            unit.registry.add_wheelset(WheelsetRecord(f"WS-{axle}", "north", "P8", 0.45, None))


def mounting(axle: int, serial: str | None = None, from_ns: int = 0, to_ns: int | None = None) -> Mounting:
    return Mounting(serial or f"WS-{axle}", VEHICLE, axle, from_ns, to_ns, 4000.0, 700.0 * axle)


SECTION_RECORD = TrackSectionRecord("KM12", SECTION, "km 12", "56E1", 0.05, 1.435, 20_000.0)


def test_mountings_entered_after_the_recordings_give_their_windows(
    storage: SqlStorage, tmp_path: Path, expected: Windows
) -> None:
    bare(storage)
    with storage.write() as unit:
        unit.tracks.add_section(SECTION_RECORD)
    receiver = received(storage, tmp_path, pieces_of(Run(), 11.0))
    assert made_of(storage) == {}
    with storage.write() as unit:
        for axle in (1, 2):
            unit.registry.add_mounting(mounting(axle))
    assert receiver.reassembler.work_off() == SpanChanges(new=6)
    assert made_of(storage) == expected
    assert receiver.reassembler.work_off() == NO_CHANGES


def test_a_section_entered_after_the_recordings_is_in_their_windows(
    storage: SqlStorage, tmp_path: Path, expected: Windows
) -> None:
    bare(storage)
    with storage.write() as unit:
        for axle in (1, 2):
            unit.registry.add_mounting(mounting(axle))
    receiver = received(storage, tmp_path, pieces_of(Run(), 11.0))
    with storage.write() as unit:
        assert {record.track_section for record in unit.windows.list("WS-1")} == {None}
        for key in content(unit):
            unit.windows.mark(*key, WindowState.REFUSED, Reason(ReasonCode.SECTION_UNKNOWN, "on no section"))
        unit.tracks.add_section(SECTION_RECORD)
    assert receiver.reassembler.work_off() == SpanChanges(changed=6)
    assert made_of(storage) == expected
    with storage.read() as unit:
        assert unit.windows.counts()["pending"] == 6


def test_wheelsets_that_were_swapped_in_the_registry_get_their_own_windows(
    storage: SqlStorage, tmp_path: Path, expected: Windows
) -> None:
    bare(storage)
    with storage.write() as unit:
        unit.tracks.add_section(SECTION_RECORD)
        put_mountings(unit, [mounting(1, "WS-2"), mounting(2, "WS-1")])  # each under the other's name
    receiver = received(storage, tmp_path, pieces_of(Run(), 11.0))
    assert made_of(storage) != expected
    with storage.write() as unit:
        put_mountings(unit, [mounting(1), mounting(2)])
    assert receiver.reassembler.work_off() == SpanChanges(changed=6)
    assert made_of(storage) == expected


def test_a_mounting_that_ends_later_leaves_its_windows_and_takes_those_behind_its_end(
    storage: SqlStorage, tmp_path: Path, expected: Windows
) -> None:
    with storage.write() as unit:
        register(unit)
    receiver = received(storage, tmp_path, pieces_of(Run(), 11.0))
    end_ns = START_NS + 12 * SECOND_NS
    with storage.write() as unit:
        unit.registry.add_mounting(mounting(1, to_ns=end_ns))
        (span,) = [one for one in unit.stale_spans.all() if one.from_ns > 0]
        assert (span.vehicle, span.from_ns, span.cause) == (VEHICLE, end_ns, "mounting of wheelset WS-1")
    changes = receiver.reassembler.work_off()
    left = made_of(storage)
    assert set(left) == {key for key in expected if key[0] == "WS-2" or key[1] + LENGTH_NS <= end_ns}
    assert changes.removed == len(expected) - len(left) == 2
    with storage.write() as unit:
        unit.registry.add_mounting(mounting(1))
    assert receiver.reassembler.work_off() == SpanChanges(new=2)
    assert made_of(storage) == expected


def test_other_axle_offsets_move_the_windows_along_the_section(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
        right = unit.registry.vehicle(VEHICLE)
    receiver = received(storage, tmp_path, pieces_of(Run(), 11.0))
    before = made_of(storage)
    for vehicle, moved in ((replace(right, axle_offsets_m=(3.0, 5.5)), True), (right, False)):
        with storage.write() as unit:
            unit.registry.add_vehicle(vehicle)
        assert receiver.reassembler.work_off().changed == 6
        assert (made_of(storage) == before) is not moved


def test_a_recording_of_an_unknown_vehicle_is_decoded_when_the_vehicle_comes(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    (path,) = files_of([Run().frames()], tmp_path)
    receiver = receiver_on(sqlite_storage, tmp_path)
    with pytest.raises(NotFoundError):
        receiver.receive_file(path, VEHICLE)
    with sqlite_storage.read() as unit:
        assert unit.chunks.of_known_vehicles() == []
    with sqlite_storage.write() as unit:
        register(unit)
        (waiting,) = unit.chunks.of_known_vehicles()
    (receipt,) = receiver.decode([waiting])
    assert isinstance(receipt, ChunkReceipt)
    assert receipt.windows_changed == 6


def test_lost_windows_are_made_again_when_their_recordings_are_received_again(
    storage: SqlStorage, tmp_path: Path
) -> None:
    with storage.write() as unit:
        register(unit)
    pieces = pieces_of(Run(), 11.0)
    receiver = received(storage, tmp_path, pieces)
    before = made_of(storage)
    with storage.write() as unit:
        position = {"version": None, "offset_m": 1.0, "scale": 0.0, "middle_m": 0.0}
        for serial, start_ns in before:
            digest = before[serial, start_ns][0]
            if serial == "WS-1":
                reason = Reason(ReasonCode.FILE_DAMAGED, "lost")
                unit.windows.mark(serial, start_ns, WindowState.REFUSED, reason)
            else:
                unit.windows.mark(serial, start_ns, WindowState.ESTIMATED)
            unit.tracks.put_positions([WindowPosition(serial, start_ns, digest, **position)])
    shutil.rmtree(storage.data_dir / "windows")
    receipts = [receiver.receive_file(path, VEHICLE) for path in files_of(pieces, tmp_path)]
    assert [receipt.known for receipt in receipts] == [True, True]
    assert sum(receipt.windows_changed for receipt in receipts) == len(before)
    assert made_of(storage) == before
    with storage.read() as unit:
        for serial, start_ns in before:
            assert unit.windows.load(serial, start_ns).start_ns == start_ns
            state, placed = unit.windows.get(serial, start_ns), unit.tracks.position(serial, start_ns)
            assert state is not None
            assert (state.state, placed is None) == (
                (WindowState.PENDING, True) if serial == "WS-1" else (WindowState.ESTIMATED, False)
            )
    assert receiver.receive_file(files_of(pieces, tmp_path)[0], VEHICLE).windows_changed == 0


def test_a_damaged_window_is_written_again_by_hand(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    receiver = received(sqlite_storage, tmp_path, [Run().frames()])
    file = sorted((sqlite_storage.data_dir / "windows").rglob("*.window"))[2]
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert receiver.reassembler.reassemble(VEHICLE, None, None) == SpanChanges(healed=1)
    assert file.read_bytes() == whole
    assert receiver.reassembler.reassemble(VEHICLE, None, None) == NO_CHANGES
    with pytest.raises(NotFoundError):
        receiver.reassembler.reassemble("N-8", None, None)


def test_only_the_windows_of_the_span_are_looked_at(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    receiver = received(sqlite_storage, tmp_path, [Run().frames()])
    starts = sorted({start_ns for _, start_ns in made_of(sqlite_storage)})
    shutil.rmtree(sqlite_storage.data_dir / "windows")
    assert receiver.reassembler.reassemble(VEHICLE, starts[1], starts[1] + 1) == SpanChanges(healed=2)
    assert receiver.reassembler.reassemble(VEHICLE, None, starts[1]) == SpanChanges(healed=2)


def test_a_long_span_is_worked_off_in_pieces_of_which_a_crash_costs_one(
    sqlite_storage: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare(sqlite_storage)
    receiver = received(sqlite_storage, tmp_path, pieces_of(Run(seconds=62.0), 11.0, 20.0, 33.0, 34.0, 52.0))
    with sqlite_storage.write() as unit:
        unit.tracks.add_section(SECTION_RECORD)
        put_mountings(unit, [mounting(1), mounting(2)])
    monkeypatch.setattr(reassembly, "MOST_FRAMES", 12_000)  # some ten seconds

    class Crash(BaseException):
        """The process dies here."""

    pieces = []
    assemble = Assembler.assemble

    def crash(self: Assembler, unit: SqlUnitOfWork, *given: object, **named: bool) -> SpanAssembly:
        pieces.append(len(content(unit)))
        if pieces[-1]:
            raise Crash
        return assemble(self, unit, *given, **named)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(Assembler, "assemble", crash)
        with pytest.raises(Crash):
            receiver.reassembler.work_off()
    assert 0 < pieces[-1] < 14
    asked = iter((False, True))
    stopping = JobContext(sqlite_storage, CountingClock(), "", JobSettings(), stopping=lambda: next(asked))
    with pytest.raises(StoppedError):
        run(receiver.reassembler.stage, stopping)
    stopped = len(made_of(sqlite_storage))
    assert pieces[-1] < stopped < 14
    assert receiver.reassembler.work_off() == SpanChanges(new=14 - stopped)
    found = made_of(sqlite_storage)
    with sqlite_storage.read() as unit:
        assert unit.stale_spans.all() == []
    monkeypatch.undo()
    assert receiver.reassembler.reassemble(VEHICLE, None, None) == NO_CHANGES
    assert made_of(sqlite_storage) == found


def test_what_is_stored_of_a_recording_that_is_lost_stays(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    pieces = [Run().frames(), Run(start_ns=START_NS + 3600 * SECOND_NS, seed=3).frames()]
    receiver = received(sqlite_storage, tmp_path, pieces)
    with sqlite_storage.read() as unit:
        lost, _ = unit.chunks.with_state(ChunkState.DECODED)
        kept = {key for key in content(unit) if key[1] < START_NS + 1800 * SECOND_NS}
    FileRawStore(tmp_path / "raw").path(lost.digest, lost.suffix).unlink()
    with sqlite_storage.write() as unit:
        unit.registry.add_mounting(mounting(1, to_ns=1))
    receiver = receiver_on(sqlite_storage, tmp_path)
    assert receiver.reassembler.work_off() == SpanChanges(removed=3)
    assert {key for key in made_of(sqlite_storage) if key[0] == "WS-1"} == {key for key in kept if key[0] == "WS-1"}
    shutil.move(tmp_path / "raw", tmp_path / "elsewhere")
    with pytest.raises(StorageError):
        receiver_on(sqlite_storage, tmp_path).reassembler.reassemble(VEHICLE, None, None)
    with sqlite_storage.read() as unit:
        assert [span.cause for span in unit.stale_spans.all()] == ["asked for"], "it is tried again"


@pytest.mark.parametrize("moved_s", [13.0, 17.0])
@pytest.mark.parametrize("later", [0, 1])
def test_a_wheelset_that_changes_vehicles_within_a_window_has_one_window_then_in_any_order(
    sqlite_storage: SqlStorage, tmp_path: Path, moved_s: float, later: int
) -> None:
    start_ns = START_NS // LENGTH_NS * LENGTH_NS
    moved_ns = start_ns + round(moved_s * SECOND_NS)
    with sqlite_storage.write() as unit:
        register(unit)
        unit.registry.add_vehicle(VehicleRecord("N-8", "north", "multiple unit", 2, 40.0, OFFSETS_M))
        unit.registry.add_mounting(mounting(1, to_ns=moved_ns))
        unit.registry.add_mounting(Mounting("WS-1", "N-8", 1, moved_ns, None, 4000.0, 1700.0))
    before = Run(start_ns=start_ns, seconds=moved_s - 0.1).frames()
    after = Run(start_ns=moved_ns + SECOND_NS // 10, seconds=20.0 - moved_s, seed=5).frames()
    receiver = receiver_on(sqlite_storage, tmp_path)
    runs = [(before, VEHICLE), (after, "N-8")]
    for batch, vehicle in (runs[later], runs[1 - later]):
        receiver.receive_file(*files_of([batch], tmp_path), vehicle)
    for vehicle in (VEHICLE, "N-8", VEHICLE):
        assert receiver.reassembler.reassemble(vehicle, None, None) == NO_CHANGES
    with sqlite_storage.read() as unit:
        found = {record.start_ns: record.vehicle for record in unit.windows.list("WS-1")}
    assert found == {start_ns: VEHICLE, start_ns + LENGTH_NS: VEHICLE if moved_s > 15.0 else "N-8"}
