"""A bus of one's own: another DBC file with its mapping gives windows as the shipped bus does."""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cantools
import numpy as np
import pytest
from live_listening import listening_to
from test_ingest_command import run as command
from test_receiver import CountingClock
from vehicle_bus import INTERVAL_NS, OFFSETS_M, SECOND_NS, SECTION, START_NS, VEHICLE, Run, register

from estimation.errors import CatalogueError, LogFileError
from estimation.values.arrays import FloatArray
from estimation.values.windows import Window
from fleet_db.raw import FileRawStore
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.frames import EXTENDED_FLAG, FrameBatch, between, concatenate, from_owned_arrays, sort_by_time, take
from ingest.live.listening import open_bus, send
from ingest.logs import write_blf
from ingest.own_bus.bus import OwnBus
from ingest.own_bus.loading import load_own_bus
from ingest.receiver import Receiver
from ingest.stored_settings import bus_choice

ROOT = Path(__file__).parents[2]
DBC = Path(__file__).with_name("own_vehicle.dbc")
SHIPPED = ROOT / "ingest" / "dbc" / "treadwatch.toml"
RATE_HZ = 200
G = 9.80665
LENGTH_S = 10.0


def mapping_text() -> str:
    found = re.search(r"```toml\n(.*?)```", (ROOT / "docs" / "own-bus.md").read_text(), re.DOTALL)
    assert found is not None
    return found[1].replace('vehicle_classes = ["coach"]\n', "")


def mapping(folder: Path, *changes: tuple[str, str], dbc: str | None = None) -> Path:
    text = mapping_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    (folder / "own_vehicle.dbc").write_text(DBC.read_text() if dbc is None else dbc)
    (folder / "mapping.toml").write_text(text)
    return folder / "mapping.toml"


@dataclass(frozen=True)
class OwnRun:
    """What the sensors of the vehicle measure, in the units of its DBC file."""

    seconds: float = 24.0
    start_ns: int = START_NS + 1_700_000  # the stamps have a phase of their own

    @property
    def t(self) -> FloatArray:
        return np.arange(round(self.seconds * RATE_HZ)) / RATE_HZ

    def rate(self, axle: int, tone: float) -> FloatArray:
        """Return a rate, rad/s."""
        return 0.2 * np.sin(2 * np.pi * tone * self.t + axle) + 0.02 * np.sin(2 * np.pi * 11.0 * self.t)

    def rows(self) -> dict[str, list[tuple[int, dict[str, float]]]]:
        """Return the signals of each message, by the ns since the begin of the cycle."""
        lateral = [2.0 * np.sin(2 * np.pi * 2.0 * self.t + axle) for axle in (1, 2)]
        count, rows = len(self.t), {}
        rows["AXLE_1"] = [
            (0, {"ay": lateral[0][k] / G, "ay_frame": 0.1 * lateral[0][k] / G, "count": k % 256, "state": 1}
             | {"yaw_rate": -np.rad2deg(self.rate(1, 1.5)[k])}) for k in range(count)
        ]  # fmt: skip
        yaw = np.cos(2 * np.pi * 1.5 * self.t)
        rows["AXLE_2"] = [
            (600_000, {"ay": 1e3 * lateral[1][k], "ay_frame": 100.0 * lateral[1][k], "yaw": yaw[k]})
            for k in range(count)
        ]
        rows["ROLL_1"] = [(900_000, {"axle": 1, "roll_1": self.rate(1, 2.5)[k]}) for k in range(count)]
        rows["ROLL_2"] = [(1_200_000, {"axle": 2, "roll_2": self.rate(2, 2.5)[k], "fine_2": 0.0}) for k in range(count)]
        rows["TRAIN_SPEED"] = [(1_500_000, {"v": 72.0, "fault": 0})] * count
        rows["TRAIN_PLACE"] = [
            (1_800_000, {"section": SECTION, "place": 100.0 + 20.0 * self.t[k], "km": 5000.0 + 0.02 * self.t[k]})
            for k in range(count)
        ]
        return rows

    def frames(self) -> FrameBatch:
        """Return the frames, encoded by cantools."""
        database = cantools.database.load_file(DBC)
        batches = []
        jitter = np.random.default_rng(3).integers(-200_000, 200_000, len(self.t))
        for name, rows in self.rows().items():
            message = database.get_message_by_name("ROLL" if name.startswith("ROLL") else name)
            every = 20 if name.startswith("TRAIN") else 1
            at = np.arange(len(self.t))[::every]
            payload = [message.encode(rows[k][1], strict=False).ljust(8, b"\0") for k in at]
            identifier = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
            batches.append(
                from_owned_arrays(
                    "can0",
                    self.start_ns + 5_000_000 * at + jitter[at] + rows[0][0],
                    np.full(len(at), identifier, np.uint32),
                    np.full(len(at), message.length, np.uint8),
                    np.frombuffer(b"".join(payload), np.uint8).reshape(-1, 8).copy(),
                )
            )
        return sort_by_time(concatenate(batches))


@pytest.fixture(scope="module")
def own_frames() -> FrameBatch:
    return OwnRun().frames()


@pytest.fixture
def registered(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


def receiver_on(storage: SqlStorage, folder: Path, bus: OwnBus) -> Receiver:
    choice = bus_choice(default_catalogue(), [bus])
    return Receiver(storage, FileRawStore(folder / "raw"), choice, CountingClock(), window_length_s=LENGTH_S)


def windows(storage: SqlStorage) -> dict[tuple[str, int], Window]:
    with storage.read() as unit:
        keys = [(r.wheelset, r.start_ns) for axle in (1, 2) for r in unit.windows.list(f"WS-{axle}")]
        return {key: unit.windows.load(*key) for key in keys}


def digests(storage: SqlStorage) -> dict[tuple[str, int], str]:
    with storage.read() as unit:
        return {(r.wheelset, r.start_ns): r.content_digest for axle in (1, 2) for r in unit.windows.list(f"WS-{axle}")}


def clear(storage: SqlStorage) -> None:
    with storage.engine.begin() as connection:
        for table in ("windows", "chunks"):
            connection.exec_driver_sql(f"delete from {table}")  # noqa: S608 - two names of ours


def integral(values: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 / RATE_HZ * (values[1:] + values[:-1]))])


def check_window(window: Window) -> None:
    """Compare a window with what the sensors measured."""
    run = OwnRun()
    at = np.rint((window.start_ns - run.start_ns) / 5e6 + np.arange(len(window.valid))).astype(int)
    lateral = 2.0 * np.sin(2 * np.pi * 2.0 * run.t[at] + window.axle)
    assert window.sample_interval_s == 0.005
    assert np.abs(window.lateral_acceleration - lateral).max() <= (0.0005 * G, 0.00025 + 1e-9)[window.axle - 1] + 1e-9
    assert np.abs(window.mass_lateral_acceleration - 0.1 * lateral).max() < 0.0011
    assert np.abs(window.speed - 20.0).max() < 1e-9
    assert np.abs(window.distance - (100.0 + 20.0 * run.t[at] - OFFSETS_M[window.axle - 1])).max() < 0.1 + 20 * 0.005
    rates = {"roll_acceleration": run.rate(window.axle, 2.5)[at]}
    if window.axle == 1:
        rates["yaw_acceleration"] = run.rate(1, 1.5)[at]
    for name, rate in rates.items():
        rest = integral(getattr(window, name)) - rate
        assert np.std(rest) < 2.5e-4, name  # half a count of the roll rate; nothing that grows
        assert abs(np.polyfit(np.arange(len(rest)), rest, 1)[0]) * len(rest) < 5e-4, name
    if window.axle == 2:
        assert np.abs(window.yaw_acceleration - np.cos(2 * np.pi * 1.5 * run.t[at])).max() < 6e-6


def test_a_recording_of_another_bus_gives_its_windows(
    registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch
) -> None:
    write_blf(tmp_path / f"{VEHICLE}__1.blf", own_frames)
    bus = load_own_bus(mapping(tmp_path))
    receipt = receiver_on(registered, tmp_path, bus).receive_file(tmp_path / f"{VEHICLE}__1.blf", VEHICLE)
    found = windows(registered)
    whole = [window for window in found.values() if window.quality.coverage == 1.0]
    assert {window.axle for window in whole} == {1, 2}
    for window in whole:
        check_window(window)
        assert not window.quality.sensor_fault
    assert receipt.record.counts["samples"] == 2 * 4800
    assert receipt.record.counts.get("samples_lost", 0) == receipt.record.counts.get("unknown_identifiers", 0) == 0


def test_cuts_of_a_recording_change_nothing(registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch) -> None:
    bus = load_own_bus(mapping(tmp_path))
    ends = [0, START_NS + 9_123_456_789, START_NS + 9_900_000_000, 1 << 62]
    found = []
    for number, cuts in enumerate(([0, 1 << 62], ends)):
        receiver = receiver_on(registered, tmp_path, bus)
        for low, high in reversed(list(pairwise(cuts))):
            path = tmp_path / f"{VEHICLE}__{number}{low}.blf"
            write_blf(path, between(own_frames, low, high))
            receiver.receive_file(path, VEHICLE)
        found.append(digests(registered))
        clear(registered)
    assert found[0] == found[1]
    assert len(found[0]) == 6


def test_a_live_bus_of_another_kind(registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch) -> None:
    bus = load_own_bus(mapping(tmp_path))
    frames = between(own_frames, START_NS, START_NS + 3 * SECOND_NS)
    bus_name = uuid.uuid4().hex
    with (
        listening_to(lambda: open_bus("virtual", bus_name)) as listener,
        open_bus("virtual", bus_name, preserve_timestamps=True) as theirs,
    ):
        sent = send(theirs, frames, clock_s=_scaled_time())
        received = listener.gathered(sent)
    assert sent == len(received) == len(frames)
    write_blf(tmp_path / f"{VEHICLE}__live.blf", received)
    receiver = Receiver(
        registered,
        FileRawStore(tmp_path / "raw"),
        bus_choice(default_catalogue(), [bus]),
        CountingClock(),
        window_length_s=2.0,
    )
    receiver.receive_file(tmp_path / f"{VEHICLE}__live.blf", VEHICLE)
    whole = [window for window in windows(registered).values() if window.quality.coverage > 0.95]
    assert {window.axle for window in whole} <= {1, 2}
    assert whole


def _scaled_time() -> object:
    """Return a clock that runs ten thousand times as fast as ours."""
    begin = time.monotonic()
    return lambda: begin + 1e4 * (time.monotonic() - begin)


def with_payload(frames: FrameBatch, at: np.ndarray, byte: int, value: int) -> FrameBatch:
    data = frames.data.copy()
    data[at, byte] = value
    return from_owned_arrays(frames.channel, frames.t_ns.copy(), frames.arbitration_id.copy(), frames.dlc.copy(), data)


def test_marked_lost_and_repeated_samples_are_left_out(
    registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch
) -> None:
    first = np.flatnonzero(own_frames.arbitration_id == 0x18FECA15 | EXTENDED_FLAG)
    changed = with_payload(own_frames, first[2000:2020], 7, 0x80)  # state 2
    changed = with_payload(changed, first[2100:2101], 0, 0x7F)
    changed = with_payload(changed, first[2100:2101], 1, 0xFF)  # the largest acceleration: clipped
    changed = with_payload(changed, first[2200:2201], 6, int(changed.data[first[2199], 6]))
    roll = np.flatnonzero(own_frames.arbitration_id == 0x310)
    changed = with_payload(changed, roll[3000:3002], 0, 9)  # a multiplexer value that the DBC file does not know
    kept = np.ones(len(changed), bool)
    kept[first[2300:2302]] = False
    write_blf(tmp_path / f"{VEHICLE}__1.blf", take(changed, kept))
    bus = load_own_bus(mapping(tmp_path))
    receipt = receiver_on(registered, tmp_path, bus).receive_file(tmp_path / f"{VEHICLE}__1.blf", VEHICLE)
    counts = receipt.record.counts
    assert (counts["samples_lost"], counts["counter_mismatches"], counts["unknown_identifiers"]) == (2, 1, 2)
    run = OwnRun()
    marked = {}
    for window in windows(registered).values():
        at = np.rint((window.start_ns - run.start_ns) / 5e6 + np.arange(len(window.valid))).astype(int)
        marked.update({(window.axle, int(k)): bool(good) for k, good in zip(at, window.valid, strict=True)})
    assert not any(marked[1, k] for k in range(2000, 2020))
    assert not any(marked[1, k] for k in (2100, 2200, 2300, 2301))
    assert all(marked[1, k] for k in range(2030, 2080))  # 40 ms beside what was clipped are left out with it
    assert all(marked[2, k] for k in range(2000, 2290))


def test_stamps_at_another_rate_are_rejected(registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch) -> None:
    bus = load_own_bus(mapping(tmp_path, ("rate_hz = 200", "rate_hz = 100")))
    write_blf(tmp_path / f"{VEHICLE}__1.blf", own_frames)
    with pytest.raises(LogFileError, match=r"come every 4\.999 ms, the mapping says every 10\.000 ms"):
        receiver_on(registered, tmp_path, bus).receive_file(tmp_path / f"{VEHICLE}__1.blf", VEHICLE)


def test_the_shipped_bus_is_such_a_pair(registered: SqlStorage, tmp_path: Path) -> None:
    path = tmp_path / f"{VEHICLE}__1.blf"
    write_blf(path, Run(seconds=25.0).frames())
    found = []
    for bus in (default_catalogue(), load_own_bus(SHIPPED)):
        Receiver(
            registered, FileRawStore(tmp_path / "raw"), bus, CountingClock(), window_length_s=LENGTH_S
        ).receive_file(path, VEHICLE)
        found.append(digests(registered))
        clear(registered)
    assert INTERVAL_NS == 4_000_000
    assert len(found[0]) == 6
    assert found[0] == found[1]


def test_the_class_of_a_vehicle_has_its_bus(
    registered: SqlStorage, tmp_path: Path, own_frames: FrameBatch, monkeypatch: pytest.MonkeyPatch, sqlite_url: str
) -> None:
    path = mapping(tmp_path, ("[clock]", 'vehicle_classes = ["multiple unit"]\n\n[clock]'))
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", sqlite_url)
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("TREADWATCH_CATALOGUES", str(path))
    monkeypatch.setenv("TREADWATCH_WINDOW_LENGTH_S", "10")
    write_blf(tmp_path / f"{VEHICLE}__1.blf", own_frames)
    code, said = command(str(tmp_path / f"{VEHICLE}__1.blf"))
    assert code == 0, said
    assert len(windows(registered)) == 6
    other = load_own_bus(path)
    with pytest.raises(CatalogueError, match="class 'multiple unit' is in two mapping files"):
        bus_choice(default_catalogue(), [other, other])
    assert bus_choice(default_catalogue(), [other]).of_class("tram") is default_catalogue()


BAD: list[tuple[str, str, str, str, int]] = [
    ('signal = "ay", lim', 'signal = "ax", lim', "AXLE_1 has no signal 'ax'; it has ay,", "nodes[0].lateral", 16),
    ('"AXLE_2", signal = "yaw"', '"AXLE_4", signal = "yaw"', "has no message 'AXLE_4'", "nodes[1].yaw", 27),
    ("multiplexer = 1", "multiplexer = 3", "is sent where axle is 1, not 3", "nodes[0].roll", 18),
    ('"v" }', '"v", multiplexer = 1 }', "signal v is not multiplexed", "vehicle.speed", 9),
    ('"v" }', '"v", unit = "bar" }', "'bar' is no known unit; a speed", "vehicle.speed", 9),
    ('"v" }', '"v", unit = "mm/s" }', "its range is 0 to 0.6553 in SI, 15 is needed", "vehicle.speed", 9),
    ('"AXLE_2", signal = "ay" }', '"AXLE_2", signal = "ay", unit = "g" }', "one count is 4.9", "nodes[1].lateral", 26),
    ('signal = "yaw_rate"', 'signal = "ay"', "unit of the DBC file 'g' is a unit of acceleration", "nodes[0].yaw", 17),
    ("good = 1", "good = 7", "7 is no value of signal state", "nodes[0].valid.good", 21),
    ('reference = "AXLE_1"', 'reference = "AXLES"', "has no message 'AXLES'", "clock.reference", 6),
    ('kind = "stamps"', 'kind = "canopen"', "has no meaning where the kind is 'canopen'", "clock.reference", 6),
    ("axle = 2", "axle = 1", "axle 1 is there twice", "nodes[1].axle", 25),
    (
        'sequence = { message = "AXLE_1"',
        'sequence = { message = "ROLL"',
        "must be in the message",
        "nodes[0].sequence",
        20,
    ),
]


@pytest.mark.parametrize(("old", "new", "reason", "field", "line"), BAD)
def test_mappings_that_do_not_fit_are_refused(
    tmp_path: Path, old: str, new: str, reason: str, field: str, line: int
) -> None:
    path = mapping(tmp_path, (old, new))
    with pytest.raises(CatalogueError, match=re.escape(reason)) as caught:
        load_own_bus(path)
    assert str(caught.value.field).startswith(field)
    assert (caught.value.file, caught.value.line) == (str(path), line)


DBC_CHANGES: Mapping[str, tuple[str, str, str]] = {
    "too many bits": ("ay : 0|20@1- (0.5,0)", "ay : 0|60@1- (0.5,0)", "60 bits, at most 53 are read"),
    "no scale": (
        "(0.001,0) [-32.767|32.767]",
        "(0,0) [-32.767|32.767]",
        "a scale of 0: every value would be the offset",
    ),
    "no limits": ("[-32.767|32.767]", "[5|5]", "the limits do not fit the number of bits"),
    "a small range": ("(0.001,0) [-32.767|32.767]", "(0.000001,0) [-0.03|0.03]", "+-2 is needed: a wrong unit?"),
}


@pytest.mark.parametrize("change", DBC_CHANGES.values(), ids=DBC_CHANGES)
def test_dbc_files_that_do_not_fit_are_refused(tmp_path: Path, change: tuple[str, str, str]) -> None:
    text = DBC.read_text()
    if "60@1" in change[1]:
        text = re.sub(r" SG_ (ay_frame : 20|yaw : 40).*\n", "", text)
    assert change[0] in text
    path = mapping(tmp_path, dbc=text.replace(change[0], change[1], 1))
    with pytest.raises(CatalogueError, match=re.escape(change[2])) as caught:
        load_own_bus(path)
    assert caught.value.file == str(path)


def test_a_mapping_without_its_dbc_file_is_refused(tmp_path: Path) -> None:
    path = mapping(tmp_path)
    (tmp_path / "own_vehicle.dbc").unlink()
    with pytest.raises(CatalogueError, match="No such file") as caught:
        load_own_bus(path)
    assert caught.value.file == str(tmp_path / "own_vehicle.dbc")
