"""The receiver on real stores: durable first, the same windows however a recording was cut, and nothing half-stored."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from vehicle_bus import INTERVAL_NS, SECOND_NS, START_NS, VEHICLE, Run, register
from waiting_windows import waiting_windows

from estimation.errors import ConflictError, LogFileError, NotFoundError
from estimation.storage import UnitOfWork
from estimation.values.windows import WindowState
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.assembly import WAITING
from ingest.catalogue import ACCELERATION, SYNC_ID, TIME_ID, default_catalogue
from ingest.frames import FrameBatch, concatenate, sort_by_time, take
from ingest.logs import write_blf
from ingest.receiver import ChunkReceipt, Receiver
from ingest.vehicle_class_schema import shipped_class

LENGTH_S = 10.0


class CountingClock:
    """Ours: every look at it is a nanosecond later."""

    def __init__(self) -> None:
        self._count = itertools.count(1_800_000_000 * SECOND_NS)

    def now_ns(self) -> int:
        return next(self._count)


def receiver_on(storage: SqlStorage, directory: Path) -> Receiver:
    return Receiver(
        storage, FileRawStore(directory / "raw"), default_catalogue(), CountingClock(), window_length_s=LENGTH_S
    )


@pytest.fixture
def registered(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


def content(unit: UnitOfWork) -> dict[tuple[str, int], tuple[str, float]]:
    """Return what the windows hold: digests of their samples, and mileages."""
    return {
        (record.wheelset, record.start_ns): (record.content_digest, record.mileage_km)
        for axle in (1, 2)
        for record in unit.windows.list(f"WS-{axle}")
    }


def clear(storage: SqlStorage) -> None:
    """Forget windows and receipts, so that one database serves many examples."""
    with storage.engine.begin() as connection:
        for table in ("window_bin_tables", "windows", "chunks"):
            connection.execute(sqlalchemy.delete(sqlalchemy.table(table)))


def files_of(pieces: list[FrameBatch], directory: Path) -> list[Path]:
    paths = []
    for piece in pieces:
        name = hashlib.sha256(piece.t_ns.tobytes() + piece.data.tobytes()).hexdigest()[:12]
        paths.append(directory / f"{VEHICLE}__{name}.blf")
        write_blf(paths[-1], piece)
    return paths


def broken_run() -> FrameBatch:
    """Return what real buses give: lost SYNCs, lost TIMEs, a gap, a clock that jumps, two frames at one instant."""
    first = Run(seconds=14.0)
    late = first.recorder_offset_ns - 2 * SECOND_NS  # the vehicle's clock jumps by 2 s in a gap of 1 s
    second = Run(seconds=9.0, start_ns=START_NS + 17 * SECOND_NS, recorder_offset_ns=late, seed=4)
    batch = concatenate([first.frames(), second.frames()])
    rng = np.random.default_rng(9)
    keep = rng.random(len(batch)) > 0.01
    keep[np.flatnonzero(batch.arbitration_id == TIME_ID)[[3, 12]]] = False
    batch = take(batch, keep)
    at = np.flatnonzero(batch.arbitration_id == 0x182)[[50, 1400]]
    other = FrameBatch("can0", batch.t_ns[at] + 7, batch.arbitration_id[at], batch.dlc[at], batch.data[at] ^ 1)
    return sort_by_time(concatenate([batch, other]))


RUN = broken_run()


@pytest.fixture(scope="module")
def whole() -> dict[str, object]:
    """Return where the first example leaves what the uncut recording gives."""
    return {}


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_cutting_in_any_order_repeated_or_late_gives_the_same_windows(
    registered: SqlStorage, tmp_path: Path, whole: dict[str, object], data: st.DataObject
) -> None:
    if not whole:
        clear(registered)
        receiver_on(registered, tmp_path).receive_file(files_of([RUN], tmp_path)[0], VEHICLE)
        with registered.read() as unit:
            whole["content"] = content(unit)
    clear(registered)
    cuts = data.draw(st.lists(st.integers(1, len(RUN) - 1), max_size=7, unique=True).map(sorted), label="cuts")
    overlap = data.draw(st.sampled_from([0, 0, 700]), label="overlap")
    edges = [0, *cuts, len(RUN)]
    pieces = [take(RUN, slice(max(a - overlap, 0), b)) for a, b in itertools.pairwise(edges)]
    order = data.draw(st.permutations(range(len(pieces))), label="order")
    repeats = data.draw(st.lists(st.sampled_from(order), max_size=2), label="repeats")
    paths = files_of(pieces, tmp_path)
    receiver = receiver_on(registered, tmp_path)
    for position in [*order, *repeats]:
        receiver.receive_file(paths[position], VEHICLE)
    with registered.read() as unit:
        assert content(unit) == whole["content"]
        assert not unit.chunks.with_state(ChunkState.STORED), "no piece is left waiting"


def test_tiny_pieces_without_time_wait_for_their_neighbours(registered: SqlStorage, tmp_path: Path) -> None:
    run = Run(seconds=6.0).frames()
    times = np.flatnonzero(run.arbitration_id == TIME_ID)
    pieces = [
        take(run, slice(0, times[2] + 1)),
        take(run, slice(times[2] + 1, times[3])),
        take(run, slice(times[3], None)),
    ]
    paths = files_of(pieces, tmp_path)
    receiver = receiver_on(registered, tmp_path)
    receipt = receiver.receive_file(paths[1], VEHICLE)
    assert (receipt.record.state, receipt.record.reason) == ("stored", WAITING)
    assert receipt.windows_changed == 0
    receiver.receive_file(paths[2], VEHICLE)
    receiver.receive_file(paths[0], VEHICLE)
    with registered.read() as unit:
        found = content(unit)
        middle = unit.chunks.get(receipt.record.digest)
    assert middle is not None
    assert middle.state == "decoded"
    assert middle.first_ns is not None
    clear(registered)
    receiver_on(registered, tmp_path).receive_file(files_of([run], tmp_path)[0], VEHICLE)
    with registered.read() as unit:
        assert content(unit) == found


def test_a_recorder_whose_clock_was_set_back_mixes_nothing_up(registered: SqlStorage, tmp_path: Path) -> None:
    run = Run(seconds=25.0, recorder_offset_ns=0).frames()
    half = np.flatnonzero(run.arbitration_id == SYNC_ID)[3111]
    first, second = take(run, slice(0, half)), take(run, slice(half, None))
    back = FrameBatch(
        "can0", second.t_ns - second.t_ns[0] + first.t_ns[0] + 1_234_567, second.arbitration_id, second.dlc, second.data
    )
    receiver = receiver_on(registered, tmp_path)
    for path in files_of([back, first], tmp_path):
        receiver.receive_file(path, VEHICLE)
    with registered.read() as unit:
        found = content(unit)
    clear(registered)
    receiver_on(registered, tmp_path).receive_file(files_of([run], tmp_path)[0], VEHICLE)
    with registered.read() as unit:
        assert content(unit) == found


def test_both_databases_give_the_same_windows(storage: SqlStorage, tmp_path: Path) -> None:
    with storage.write() as unit:
        register(unit)
    receipt = receiver_on(storage, tmp_path).receive_file(files_of([Run().frames()], tmp_path)[0], VEHICLE)
    assert receipt.windows_changed == 6
    with storage.read() as unit:
        for axle in (1, 2):
            records = unit.windows.list(f"WS-{axle}")
            expected = (
                700.0 * axle + (5000.0 - 4000.0) + 0.02 * (np.array([r.start_ns for r in records]) - START_NS) / 1e9
            )
            assert np.allclose([r.mileage_km for r in records], expected, atol=1e-3)
            assert {r.state for r in records} == {WindowState.PENDING}
            window = unit.windows.load(f"WS-{axle}", records[1].start_ns)
            lateral = Run().accelerations(axle)["lateral_acceleration"]
            at = records[1].start_ns // INTERVAL_NS - int(Run().ticks[0])
            assert np.array_equal(window.lateral_acceleration, lateral[at : at + len(window.valid)])


def test_the_same_recording_again_changes_nothing(registered: SqlStorage, tmp_path: Path) -> None:
    path = files_of([Run().frames()], tmp_path)[0]
    receiver = receiver_on(registered, tmp_path)
    first = receiver.receive_file(path, VEHICLE)
    with registered.write() as unit:
        for key in content(unit):
            unit.windows.mark(*key, WindowState.ESTIMATED)
    second = receiver.receive_file(path, VEHICLE)
    assert (first.known, second.known, second.windows_changed) == (False, True, 0)
    assert second.record == first.record
    with registered.read() as unit:
        assert unit.windows.counts()["estimated"] == 6
    with pytest.raises(ConflictError, match=f"received from vehicle {VEHICLE}"):
        receiver.receive_file(path, "N-8")


def test_a_late_piece_makes_only_its_windows_pending_again(registered: SqlStorage, tmp_path: Path) -> None:
    run = Run(seconds=60.0).frames()
    late = (run.t_ns >= run.t_ns[0] + 29 * SECOND_NS) & (run.t_ns < run.t_ns[0] + 31 * SECOND_NS)
    paths = files_of([take(run, ~late), take(run, late)], tmp_path)
    receiver = receiver_on(registered, tmp_path)
    receiver.receive_file(paths[0], VEHICLE)
    with registered.write() as unit:
        before = content(unit)
        for key in before:
            unit.windows.mark(*key, WindowState.ESTIMATED)
    receipt = receiver.receive_file(paths[1], VEHICLE)
    assert receipt.windows_changed == 2
    with registered.read() as unit:
        after = content(unit)
        pending = {(r.wheelset, r.start_ns) for r in waiting_windows(unit)}
    assert pending == {key for key in after if after[key] != before[key]}
    assert pending == {(f"WS-{axle}", START_NS + 27 * SECOND_NS) for axle in (1, 2)}


@pytest.mark.parametrize(("code", "again"), [("coach", {"WS-1", "WS-2"}), ("paper", {"WS-2"})])
def test_a_late_piece_of_one_axle_lets_the_other_axle_of_its_bogie_wait_too(
    registered: SqlStorage, tmp_path: Path, code: str, again: set[str]
) -> None:
    run = Run(seconds=60.0).frames()
    acceleration = run.arbitration_id == default_catalogue().find(ACCELERATION, 2).arbitration_id
    late = acceleration & (run.t_ns >= run.t_ns[0] + 29 * SECOND_NS) & (run.t_ns < run.t_ns[0] + 31 * SECOND_NS)
    paths = files_of([take(run, ~late), take(run, late)], tmp_path)
    receiver = receiver_on(registered, tmp_path)
    receiver.receive_file(paths[0], VEHICLE)
    with registered.write() as unit:
        unit.registry.add_vehicle_class(replace(shipped_class(code), code="multiple unit"), 1)
        for key in content(unit):
            unit.windows.mark(*key, WindowState.ESTIMATED)
    receiver.receive_file(paths[1], VEHICLE)
    with registered.read() as unit:
        assert {(r.wheelset, r.start_ns) for r in waiting_windows(unit)} == {
            (serial, START_NS + 27 * SECOND_NS) for serial in again
        }


def test_a_corrupt_recording_is_kept_rejected_and_named(registered: SqlStorage, tmp_path: Path) -> None:
    path = files_of([Run().frames()], tmp_path)[0]
    path.write_bytes(path.read_bytes()[:-5000])
    receiver = receiver_on(registered, tmp_path)
    for _ in range(2):
        with pytest.raises(LogFileError) as caught:
            receiver.receive_file(path, VEHICLE)
        assert caught.value.file == str(path)
        assert "truncated" in caught.value.reason
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    with registered.read() as unit:
        record = unit.chunks.get(digest)
        assert content(unit) == {}
    assert record is not None
    assert (record.state, "truncated" in str(record.reason)) == ("rejected", True)
    assert FileRawStore(tmp_path / "raw").path(digest, ".blf").read_bytes() == path.read_bytes()


def test_one_bad_file_does_not_stop_the_others(registered: SqlStorage, tmp_path: Path) -> None:
    good = files_of(
        [Run(seconds=9.0).frames(), Run(seconds=9.0, start_ns=START_NS + 3600 * SECOND_NS).frames()], tmp_path
    )
    bad, text = tmp_path / "bad.blf", tmp_path / "notes.txt"
    bad.write_bytes(b"no log at all")
    text.write_text("hello")
    paths = [good[0], bad, text, tmp_path / "nowhere.blf", good[1]]
    outcomes = dict(receiver_on(registered, tmp_path).receive_files((path, VEHICLE) for path in paths))
    assert list(outcomes) == paths
    assert [isinstance(outcome, ChunkReceipt) for outcome in outcomes.values()] == [True, False, False, False, True]
    for path in paths[1:4]:
        assert str(path) in str(outcomes[path])


class Crash(BaseException):
    """The process dies here."""


@pytest.mark.parametrize("moment", ["before decoding", "while windows are stored"])
def test_a_crash_after_the_receipt_is_made_good(
    registered: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    path = files_of([Run().frames()], tmp_path)[0]
    receiver = receiver_on(registered, tmp_path)

    def crash(*_: object) -> None:
        raise Crash

    with monkeypatch.context() as patch:
        if moment == "before decoding":
            patch.setattr(Receiver, "_decode", crash)
        else:
            from fleet_db.stores.chunks import ChunkStore  # noqa: PLC0415 - only here: the last step of the commit

            patch.setattr(ChunkStore, "update", crash)
        with pytest.raises(Crash):
            receiver.receive_file(path, VEHICLE)
    with registered.read() as unit:
        assert content(unit) == {}, "nothing half-stored"
        assert [record.state for record in unit.chunks.with_state(ChunkState.STORED)] == ["stored"]
    path.unlink()
    outcomes = list(receiver_on(registered, tmp_path).decode_stored())
    assert [isinstance(outcome, ChunkReceipt) and outcome.windows_changed for outcome in outcomes] == [6]
    assert list(receiver_on(registered, tmp_path).decode_stored()) == []


def test_a_recording_of_an_unknown_vehicle_waits_for_the_registry(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    path = files_of([Run().frames()], tmp_path)[0]
    receiver = receiver_on(sqlite_storage, tmp_path)
    with pytest.raises(NotFoundError, match=f"no vehicle '{VEHICLE}'"):
        receiver.receive_file(path, VEHICLE)
    with sqlite_storage.read() as unit:
        (record,) = unit.chunks.with_state(ChunkState.STORED)
    assert VEHICLE in str(record.reason)
    with sqlite_storage.write() as unit:
        register(unit)
    (outcome,) = receiver.decode_stored()
    assert isinstance(outcome, ChunkReceipt)
    assert outcome.windows_changed == 6


def test_counts_of_a_recording_are_on_its_receipt(registered: SqlStorage, tmp_path: Path) -> None:
    batch = Run().frames()
    identifier, dlc = batch.arbitration_id.copy(), batch.dlc.copy()
    at = np.flatnonzero(identifier == 0x181)
    identifier[at[0]] = 0x7AA
    dlc[at[1]] = 5
    strange = FrameBatch("can0", batch.t_ns, identifier, dlc, np.where(np.arange(8) < dlc[:, None], batch.data, 0))
    receipt = receiver_on(registered, tmp_path).receive_file(files_of([strange], tmp_path)[0], VEHICLE)
    counts = receipt.record.counts
    assert (counts["frames"], counts["decoded"]) == (len(batch), len(batch) - 2)
    assert (counts["unknown_identifiers"], counts["wrong_lengths"]) == (1, 1)
    assert counts["windows"] == 6
    assert receipt.record.first_ns == pytest.approx(START_NS, abs=5_000_000)


def test_a_lost_raw_file_of_a_neighbour_is_no_fault_of_the_newcomer(registered: SqlStorage, tmp_path: Path) -> None:
    run = Run().frames()
    half = len(run) // 2
    paths = files_of([take(run, slice(0, half)), take(run, slice(half, None))], tmp_path)
    first = receiver_on(registered, tmp_path).receive_file(paths[0], VEHICLE)
    FileRawStore(tmp_path / "raw").path(first.record.digest, ".blf").unlink()
    second = receiver_on(registered, tmp_path).receive_file(paths[1], VEHICLE)
    assert second.record.reason is not None
    assert second.record.reason.code == "waits_for_storage"
    assert "lost or damaged" in second.record.reason.text
    with registered.read() as unit:
        assert [record.state for record in unit.chunks.with_state(ChunkState.STORED)] == ["stored"]


@pytest.fixture(autouse=True)
def _no_files_left(tmp_path: Path) -> Iterator[None]:
    yield
    assert not list(tmp_path.rglob(".incoming-*"))
