"""Several buses in one process: each vehicle gets its own frames; what one of them drops is counted for it alone."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path

import pytest
from live_listening import eventually
from multicast import multicast_problem
from test_live_receiver import assert_each_once
from test_receiver import CountingClock
from vehicle_bus import VEHICLE, Run, register

from api.commands.receiving import ingest
from api.terminal.health_server import registry_of
from api.terminal.live import live_measures
from estimation.errors import ConflictError, ParameterError, StorageError
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.frames import OVERFLOW_ID, FrameBatch, concatenate
from ingest.live.listening import BusSource, open_bus, send
from ingest.live.receiver import LiveSettings, ReceivedBus, receive_buses
from ingest.live.spool import Spool, spool_folder
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import Stores
from ingest.logs import read_log
from ingest.receiver import Receiver

OTHER = "L-OTHER"
GROUPS = ("239.74.163.81", "239.74.163.82")


@dataclass
class Buses:
    """Two live buses of one process."""

    storage: SqlStorage
    folder: Path
    interface: str
    channels: dict[str, str]
    statuses: dict[str, LiveStatus] = field(default_factory=lambda: {VEHICLE: LiveStatus(), OTHER: LiveStatus()})
    said: list[str] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)
    away: set[str] = field(default_factory=set)
    waiting_bytes: dict[str, int] = field(default_factory=dict)
    failures: list[Exception] = field(default_factory=list)

    def receiver(self, vehicle: str) -> Receiver:
        if vehicle in self.away:
            raise StorageError("the stores are away")
        raw = FileRawStore(self.folder / "raw")
        return Receiver(self.storage, raw, default_catalogue(), CountingClock(), window_length_s=2.0)

    def bus(self, vehicle: str) -> ReceivedBus:
        most = self.waiting_bytes.get(vehicle, 1 << 24)
        return ReceivedBus(
            LiveSettings(vehicle, self.folder / "spool", 5 * most, most, 0.5, 20.0),
            BusSource(vehicle, partial(open_bus, self.interface, self.channels[vehicle])),
            Stores(partial(self.receiver, vehicle), lambda: None),
            self.statuses[vehicle],
            Reports(lambda text, *, bad=False: self.said.append(f"{vehicle} {bad} {text}"), lambda *_: None),
        )

    def run(self) -> None:
        try:
            receive_buses([self.bus(vehicle) for vehicle in self.channels], self.stop)
        except Exception as error:  # noqa: BLE001 - for the test to look at
            self.failures.append(error)

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self.run)
        thread.start()
        try:
            eventually(lambda: sum("listening" in text for text in self.said) == 2 or not thread.is_alive())
            yield
        finally:
            self.stop.set()
            thread.join(60.0)
            assert not thread.is_alive()

    def frames(self, vehicle: str) -> FrameBatch:
        with self.storage.read() as unit:
            found = [r for state in ChunkState for r in unit.chunks.with_state(state, limit=1000)]
        mine = {r.digest: r for r in found if r.vehicle == vehicle}
        return concatenate(
            [read_log(FileRawStore(self.folder / "raw").path(r.digest, r.suffix)) for r in mine.values()]
        )

    def transmit(self, vehicle: str, batch: FrameBatch) -> None:
        options = {"preserve_timestamps": True} if self.interface == "virtual" else {}
        fast = self.interface == "virtual"
        with open_bus(self.interface, self.channels[vehicle], **options) as bus:
            send(bus, batch, clock_s=count(0.0, 1000.0).__next__) if fast else send(bus, batch)


def measured(buses: Buses, name: str) -> dict[str, float]:
    registry = registry_of(partial(live_measures, buses.statuses))
    return {
        one: registry.get_sample_value(f"treadwatch_live_{name}", {"vehicle": one}) or 0.0 for one in buses.channels
    }


@pytest.fixture
def buses(sqlite_storage: SqlStorage, tmp_path: Path) -> Buses:
    with sqlite_storage.write() as unit:
        register(unit)
    channels = {VEHICLE: f"one-{os.getpid()}-{id(tmp_path)}", OTHER: f"two-{os.getpid()}-{id(tmp_path)}"}
    return Buses(sqlite_storage, tmp_path / "live", "virtual", channels)


def test_every_frame_of_each_bus_has_its_receipt_once_under_its_vehicle(buses: Buses) -> None:
    sent = {VEHICLE: Run(seconds=2.0).frames(), OTHER: Run(seconds=1.0, seed=7).frames()}
    with buses.running():
        senders = [threading.Thread(target=buses.transmit, args=one) for one in sent.items()]
        for sender in senders:
            sender.start()
        for sender in senders:
            sender.join(60.0)
        eventually(lambda: all(buses.statuses[one].frames_received == len(sent[one]) for one in sent))
    for vehicle, batch in sent.items():
        assert_each_once(buses.frames(vehicle), batch)
    assert measured(buses, "frames_received_total") == {one: len(batch) for one, batch in sent.items()}
    assert measured(buses, "frames_dropped_total") == {VEHICLE: 0.0, OTHER: 0.0}
    assert buses.failures == []


@pytest.mark.usefixtures("live_bus")
def test_each_group_of_a_multicast_bus_goes_to_its_own_vehicle(buses: Buses) -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    buses.interface, buses.channels = "udp_multicast", dict(zip((VEHICLE, OTHER), GROUPS, strict=True))
    sent = {VEHICLE: Run(seconds=0.6).frames(), OTHER: Run(seconds=0.3, seed=7).frames()}
    with buses.running():
        for vehicle, batch in sent.items():
            buses.transmit(vehicle, batch)
        eventually(
            lambda: all(
                buses.statuses[one].frames_received + buses.statuses[one].frames_lost_by_bus == len(sent[one])
                for one in sent
            )
        )
    for vehicle, batch in sent.items():
        status, stored = buses.statuses[vehicle], buses.frames(vehicle)
        assert sum(stored.arbitration_id != OVERFLOW_ID) == status.frames_received
        assert status.frames_received + measured(buses, "frames_lost_by_bus_total")[vehicle] == len(batch)


def test_what_a_bus_that_is_behind_drops_is_counted_for_it_alone(buses: Buses) -> None:
    buses.away.add(OTHER)
    buses.waiting_bytes[OTHER] = 4_000
    sent = Run(seconds=2.0).frames()
    with buses.running():
        for vehicle in buses.channels:
            buses.transmit(vehicle, sent)
        eventually(lambda: all(status.frames_received == len(sent) for status in buses.statuses.values()))
        behind = buses.statuses[OTHER]
        eventually(lambda: behind.frames_dropped > 0)
    assert_each_once(buses.frames(VEHICLE), sent)
    assert buses.statuses[VEHICLE].frames_dropped == 0
    assert behind.frames_spooled > 0
    assert behind.frames_spooled + behind.frames_dropped == len(sent)
    assert any(text.startswith(f"{OTHER} True") and "dropped" in text for text in buses.said)
    buses.away.clear()  # the next start stores what waited, with the number of those dropped on its receipt
    buses.stop, buses.said = threading.Event(), []
    buses.statuses = {vehicle: LiveStatus() for vehicle in buses.channels}
    waited = behind.frames_spooled
    with buses.running():
        eventually(lambda: buses.statuses[OTHER].spool_bytes == 0)
    stored = buses.frames(OTHER)
    assert sum(stored.arbitration_id != OVERFLOW_ID) == waited


def test_a_vehicle_that_another_process_receives_ends_all_in_order(buses: Buses) -> None:
    spool = Spool(spool_folder(buses.folder / "spool", OTHER), 1 << 20)
    spool.take_over()
    try:
        thread = threading.Thread(target=buses.run)
        thread.start()
        thread.join(60.0)
        assert not thread.is_alive()
    finally:
        with suppress(OSError):
            spool.close()
    assert [type(error) for error in buses.failures] == [ConflictError]


@pytest.mark.parametrize(
    ("bus", "channel", "reason"),
    [
        (["can0"], None, "is CHANNEL=VEHICLE"),
        (["can0=L-1", "can0=L-2"], None, "there twice"),
        (["can0=L-1", "can1=L-1"], None, "there twice"),
        (["can0=L-1"], "can1", "leave --channel and --vehicle out"),
        ([], "can1", "needs --channel and --vehicle, or --bus"),
    ],
)
def test_buses_that_make_no_sense_are_refused(bus: list[str], channel: str | None, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        ingest(interface="virtual", bus=bus, channel=channel)
