"""A live bus into a real database that goes away, and a receiver that is killed: nothing lost, nothing doubled."""

from __future__ import annotations

import json
import os
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from live_listening import eventually
from postgres_server import PostgresServer, stoppable_server
from test_live_spool import packed
from test_receiver import CountingClock
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run, register

from api.terminal.health_server import HealthAddress
from api.terminal.live import serving_health
from estimation.errors import ConflictError, MigrationError
from fleet_db.migrate import upgrade
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.frames import FrameBatch, concatenate, merge
from ingest.live import storing
from ingest.live.listening import BusSource, open_bus, send
from ingest.live.receiver import LiveSettings, ReceivedBus, receive_live
from ingest.live.spool import Record, Spool, spool_folder
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import Stores
from ingest.logs import read_log
from ingest.receiver import ChunkReceipt, Receiver

PAGE = Path(__file__).parents[2] / "docs" / "live-receiver.md"


@dataclass
class Live:
    """A live receiver in threads of this process, with what it said."""

    storage: SqlStorage
    folder: Path
    channel: str
    status: LiveStatus = field(default_factory=LiveStatus)
    said: list[str] = field(default_factory=list)
    outcomes: list[ChunkReceipt | Exception] = field(default_factory=list)
    connect: Callable[[], Receiver] | None = None
    refused: list[Exception] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)
    piece_seconds: float = 0.5

    @property
    def raw(self) -> FileRawStore:
        return FileRawStore(self.folder / "raw")

    def receiver(self) -> Receiver:
        return Receiver(self.storage, self.raw, default_catalogue(), CountingClock(), window_length_s=2.0)

    def run(self) -> None:
        settings = LiveSettings(VEHICLE, self.folder / "spool", 1 << 24, 1 << 20, self.piece_seconds, 20.0)
        try:
            bus = ReceivedBus(
                settings,
                BusSource("a bus", partial(open_bus, "virtual", self.channel)),
                Stores(self.connect or self.receiver, lambda: None),
                self.status,
                Reports(
                    lambda text, *, bad=False: self.said.append(f"{'bad: ' if bad else ''}{text}"),
                    lambda _, outcome: self.outcomes.append(outcome),
                ),
            )
            receive_live(bus, self.stop)
        except Exception as error:  # noqa: BLE001 - for the test to look at
            self.refused.append(error)

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self.run)
        thread.start()
        try:
            eventually(lambda: any("listening" in text for text in self.said) or not thread.is_alive())
            yield
        finally:
            self.stop.set()
            thread.join(60.0)
            assert not thread.is_alive()

    def stored(self) -> list[ChunkRecord]:
        with self.storage.read() as unit:
            found = [r for state in ChunkState for r in unit.chunks.with_state(state, limit=1000)]
        return list({record.digest: record for record in found}.values())

    def frames(self) -> FrameBatch:
        """Every frame that has a receipt, as often as it has."""
        return concatenate([read_log(self.raw.path(record.digest, record.suffix)) for record in self.stored()])


@pytest.fixture
def live(sqlite_storage: SqlStorage, tmp_path: Path) -> Live:
    with sqlite_storage.write() as unit:
        register(unit)
    return Live(sqlite_storage, tmp_path / "live", f"live-{os.getpid()}-{id(tmp_path)}")


@contextmanager
def transmitting(channel: str) -> Iterator[Callable[[FrameBatch], int]]:
    with open_bus("virtual", channel, preserve_timestamps=True) as bus:
        yield lambda batch: send(bus, batch, clock_s=count(0.0, 1000.0).__next__)


def spooled(live: Live, content: bytes, spool_bytes: int = 1 << 20) -> None:
    """Leave a piece in the spool, as an earlier process did."""
    with closing(Spool(spool_folder(live.folder / "spool", VEHICLE), spool_bytes)) as spool:
        spool.take_over()
        spool.append(Record(content))


def test_every_frame_of_a_bus_has_its_receipt_once(live: Live) -> None:
    batch = Run(seconds=2.0).frames()
    with live.running(), transmitting(live.channel) as transmit:
        transmit(batch)
        eventually(lambda: live.status.frames_received == len(batch))
    assert_each_once(live.frames(), batch)
    assert list((live.folder / "spool" / VEHICLE).glob("*.frames")) == []
    assert any("frames stored, 0 dropped" in text for text in live.said)
    assert (live.status.pieces_stored, live.status.frames_dropped) == (len(live.outcomes), 0)


@pytest.mark.slow
def test_a_database_that_goes_away_is_waited_for(tmp_path: Path) -> None:
    with stoppable_server() as server:
        upgrade(server.url)
        with closing(SqlStorage(database_engine(server.url), tmp_path / "data")) as storage:
            with storage.write() as unit:
                register(unit)
            live = Live(storage, tmp_path / "live", f"away-{os.getpid()}")
            whole = Run(seconds=3.0).frames()
            parts = [replace_frames(whole, slice(at, at + 500)) for at in range(0, len(whole), 500)]
            with live.running(), transmitting(live.channel) as transmit:
                outage(live, server, transmit, parts)
            assert_each_once(live.frames(), whole)
        said = "\n".join(live.said)
        assert "bad: pieces wait in the spool, they cannot be stored now" in said
        assert "receipts are committed again" in said
        assert live.status.database_fault is None
        assert live.status.frames_dropped == live.status.pieces_rejected == live.status.pieces_aside == 0


def test_no_commit_is_acknowledged_that_a_crash_of_the_server_undoes(postgres_url: str) -> None:
    url = f"{postgres_url}{'&' if '?' in postgres_url else '?'}options=-csynchronous_commit%3Doff"
    with closing(SqlStorage(database_engine(url), Path())) as storage, storage.read() as unit:
        assert unit.connection.exec_driver_sql("SHOW synchronous_commit").scalar_one() == "on"


def assert_each_once(stored: FrameBatch, sent: FrameBatch) -> None:
    """Compare frames as sets, each as often as it is there; python-can's stamps are seconds in double precision."""
    as_received = replace(sent, t_ns=np.rint(sent.t_ns / 1e9 * 1e9).astype(np.int64))
    ours, theirs = merge([stored]), merge([as_received])
    assert len(stored) == len(sent)
    assert np.array_equal(ours.t_ns, theirs.t_ns)
    assert np.array_equal(ours.arbitration_id, theirs.arbitration_id)
    assert np.array_equal(ours.data, theirs.data)


def outage(live: Live, server: PostgresServer, transmit: Callable[[FrameBatch], int], parts: list[FrameBatch]) -> None:
    """Send frames before, during and after an outage, and wait until all have their receipts."""
    transmit(parts[0])
    eventually(lambda: len(live.outcomes) == live.status.pieces_stored > 0 == live.status.spool_bytes)
    server.stop()
    for part in parts[1:-1]:
        transmit(part)
    eventually(lambda: live.status.database_fault is not None and live.status.pieces_waiting > 0)
    with serving_health(HealthAddress("127.0.0.1", 0), {VEHICLE: live.status}) as port:
        code, body = get(port, "/readyz")
        assert (code, list(json.loads(body)["faults"][VEHICLE])) == (503, ["database"])
        assert get(port, "/healthz")[0] == 200
    server.start()
    transmit(parts[-1])
    sent = sum(map(len, parts))
    eventually(lambda: live.status.frames_spooled == sent and live.status.spool_bytes == 0)
    eventually(lambda: all(record.state is ChunkState.DECODED for record in live.stored()))


def replace_frames(batch: FrameBatch, part: slice) -> FrameBatch:
    columns = {name: getattr(batch, name)[part] for name in ("t_ns", "arbitration_id", "dlc", "data")}
    return replace(batch, **columns)


def test_a_raw_store_that_takes_nothing_is_waited_for(live: Live) -> None:
    live.folder.mkdir()
    live.raw.directory.touch()  # where the folder should be
    batch = Run(seconds=1.0).frames()
    with live.running(), transmitting(live.channel) as transmit:
        transmit(batch)
        eventually(lambda: live.status.raw_fault is not None)
        assert live.stored() == []
        live.raw.directory.unlink()
        eventually(lambda: live.status.pieces_stored > 0 and live.status.spool_bytes == 0)
        assert live.status.raw_fault is None
    assert_each_once(live.frames(), batch)


def test_a_piece_that_had_its_receipt_before_the_kill_is_stored_once(live: Live) -> None:
    spooled(live, packed(Run(seconds=2.0).frames()))
    piece = next((live.folder / "spool" / VEHICLE).glob("*.frames"))
    content = piece.read_bytes()
    with live.running():
        eventually(lambda: live.status.pieces_stored == 1)
    piece.write_bytes(content)  # as if the process had ended between receipt and removal
    again = replace(live, status=LiveStatus(), said=[], stop=threading.Event())
    with again.running():
        eventually(lambda: again.status.pieces_stored == 1)
    assert len(live.stored()) == 1
    assert not piece.exists()
    assert "1 pieces of an earlier start wait in the spool" in again.said


def test_a_rejected_piece_is_said_at_once_and_the_others_go_on(live: Live) -> None:
    other_rate = Run(seconds=2.0).frames()
    spooled(live, packed(replace(other_rate, t_ns=other_rate.t_ns[0] + 2 * (other_rate.t_ns - other_rate.t_ns[0]))))
    spooled(live, packed(Run(seconds=2.0, start_ns=START_NS + 3600 * SECOND_NS).frames()))
    with live.running():
        eventually(lambda: live.status.pieces_stored == 2 and len(live.outcomes) == 2)
        assert live.status.pieces_rejected == 1
        said = [text for text in live.said if "rejected" in text]
        assert len(said) == 1
        assert said[0].startswith(f"bad: rejected {VEHICLE}__")
        assert "SYNC" in said[0]
    assert sorted(record.state for record in live.stored()) == [ChunkState.DECODED, ChunkState.REJECTED]


def test_a_piece_that_can_never_be_stored_is_set_aside(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storing, "FIRST_DELAY_S", 0.01)
    spooled(live, packed(Run(seconds=2.0).frames()))
    spooled(live, packed(Run(seconds=2.0, start_ns=START_NS + 3600 * SECOND_NS).frames()))
    first = min((live.folder / "spool" / VEHICLE).glob("*.frames"))
    recording = storing.read_piece(first)
    assert recording is not None
    live.receiver().keep(recording.content, ".blf", "L-2", "another vehicle")
    with live.running():
        eventually(lambda: live.status.pieces_stored == 1 and live.status.pieces_aside == 1)
    assert any("set aside" in text and "received from vehicle L-2" in text for text in live.said)
    assert first.with_suffix(".aside").exists()


def test_dropped_frames_are_on_the_receipt(live: Live) -> None:
    with closing(Spool(spool_folder(live.folder / "spool", VEHICLE), 1 << 24)) as spool:
        spool.take_over()
        spool.append(Record(packed(Run(seconds=2.0).frames()), 321, 321))
    with live.running():
        eventually(lambda: len(live.outcomes) == 1)
    (record,) = live.stored()
    assert record.counts["frames_dropped"] == 321
    assert any(text.startswith("bad: ") and "321 dropped" in text for text in live.said)
    assert live.status.frames_dropped == 321


def test_stores_that_refuse_for_good_end_the_receiver(live: Live) -> None:
    def refuse() -> Receiver:
        raise MigrationError("0001", "0002")

    live.connect = refuse
    with live.running():
        eventually(lambda: bool(live.refused))
    assert isinstance(live.refused[0], MigrationError)


def test_a_second_receiver_of_a_vehicle_is_refused(live: Live) -> None:
    with live.running():
        second = replace(live, said=[], status=LiveStatus(), stop=threading.Event())
        second.run()
    assert isinstance(second.refused[0], ConflictError)


def get(port: int, path: str) -> tuple[int, str]:
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}")
    try:
        with urllib.request.urlopen(request, timeout=10.0) as answer:  # noqa: S310 - the same
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_health_and_metrics_have_a_port_of_their_own(live: Live) -> None:
    with serving_health(HealthAddress("127.0.0.1", 0), {VEHICLE: live.status}) as port:
        assert get(port, "/healthz")[0] == 503
        assert get(port, "/nothing")[0] == 404
        with live.running(), transmitting(live.channel) as transmit:
            transmit(Run(seconds=1.0).frames())
            eventually(lambda: get(port, "/readyz")[0] == 200)
            eventually(lambda: live.status.pieces_stored > 0)
            _, text = get(port, "/metrics")
            assert (
                f'treadwatch_live_frames_received_total{{vehicle="{VEHICLE}"}} {live.status.frames_received:.1f}'
                in text
            )
            assert f'treadwatch_live_up{{vehicle="{VEHICLE}",what="database"}} 1.0' in text
            live.status.spool_fault = "no space"
            assert f'treadwatch_live_up{{vehicle="{VEHICLE}",what="spool"}} 0.0' in get(port, "/metrics")[1]
            assert json.loads(get(port, "/readyz")[1])["faults"] == {VEHICLE: {"spool": "no space"}}
            live.status.spool_fault = None
        described = PAGE.read_text()
        for line in text.splitlines():
            if not line.startswith("#") and "_created" not in line:
                assert f"`{line.split('{')[0].split(' ')[0]}" in described, line


def test_a_receiver_whose_recordings_are_all_rejected_is_not_ready_and_says_why(live: Live) -> None:
    other_rate = Run(seconds=2.0).frames()
    spooled(live, packed(replace(other_rate, t_ns=other_rate.t_ns[0] + 2 * (other_rate.t_ns - other_rate.t_ns[0]))))
    with serving_health(HealthAddress("127.0.0.1", 0), {VEHICLE: live.status}) as port, live.running():
        eventually(lambda: live.status.pieces_rejected == 1)
        code, text = get(port, "/readyz")
        assert code == 503
        assert json.loads(text)["faults"][VEHICLE]["recordings"].startswith(
            "every recording is rejected, the last 1: SYNC"
        )
        measured = get(port, "/metrics")[1]
        assert f'treadwatch_live_frames_rejected_total{{vehicle="{VEHICLE}"}} {float(len(other_rate))}' in measured
        assert f'treadwatch_live_up{{vehicle="{VEHICLE}",what="recordings"}} 0.0' in measured
        live.status.silent_since_s = time.time() - 90.0
        assert 90.0 <= json.loads(get(port, "/readyz")[1])["silent_for_s"][VEHICLE] < 3600.0
        live.status.decoded = True  # one bad piece among good ones is no reason to restart a receiver
        assert "recordings" not in live.status.faults
        live.status.rejected_in_a_row = 3
        assert "recordings" in live.status.faults
