"""Live buses: the same suite over every transport that this machine has."""

from __future__ import annotations

import errno
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import can
import numpy as np
import pytest
from live_listening import eventually, frames_in, listening_to
from multicast import GROUP, multicast_problem
from vehicle_bus import SECOND_NS, Run

from estimation.errors import ParameterError
from ingest.catalogue import SYNC_ID
from ingest.live import listening
from ingest.live.listening import open_bus, send
from ingest.live.spool import FRAME_BYTES, FrameBuffer, pack_frame
from ingest.live.status import Backoff, LiveStatus, Reports

PORT = 43_117


@pytest.fixture(params=["virtual", "udp_multicast"])
def buses(request: pytest.FixtureRequest) -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """Yield two ends of one bus."""
    options: dict[str, object] = {}
    channel = uuid.uuid4().hex
    if request.param == "udp_multicast":
        problem = multicast_problem()
        if problem:
            pytest.skip(problem)
        channel, options = GROUP, {"port": PORT, "fd": False}
    with open_bus(request.param, channel, **options) as one, open_bus(request.param, channel, **options) as other:
        yield one, other


@pytest.fixture
def other_end(buses: tuple[can.BusABC, can.BusABC]) -> Callable[[], can.BusABC]:
    """Return what opens the other end, the listening thread closes it."""
    return lambda: buses[1]


def test_what_is_sent_is_received(buses: tuple[can.BusABC, can.BusABC], other_end: Callable[[], can.BusABC]) -> None:
    batch = Run(seconds=0.4).frames()
    with listening_to(other_end) as listener:
        assert send(buses[0], batch) == len(batch)
        received = listener.gathered(len(batch))
    assert np.array_equal(received.arbitration_id, batch.arbitration_id)
    assert np.array_equal(received.dlc, batch.dlc)
    assert np.array_equal(received.data, batch.data)
    assert abs(int(received.t_ns[0]) - time.time_ns()) < 60 * SECOND_NS
    assert listener.said == ["listening to a bus; stop with Ctrl-C"]


def test_frames_wait_in_the_socket_while_nobody_listens() -> None:
    """As much as the kernel grants: where that is less than asked for, it is more than by default still."""
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        default = plain.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    with (
        open_bus("udp_multicast", GROUP, port=PORT, fd=False) as bus,
        socket.socket(fileno=os.dup(bus.fileno())) as end,
    ):
        assert end.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) > default


def test_a_full_buffer_drops_the_newest_and_counts(
    buses: tuple[can.BusABC, can.BusABC], other_end: Callable[[], can.BusABC]
) -> None:
    sent = Run(seconds=0.2).frames()
    with listening_to(other_end, limit_bytes=100 * FRAME_BYTES) as listener:
        send(buses[0], sent)
        eventually(lambda: listener.status.frames_received == len(sent))
        frames, dropped = listener.buffer.take(1 << 20)
        assert (len(frames), dropped) == (100 * FRAME_BYTES, len(sent) - 100)
        assert np.array_equal(frames_in(frames).data, sent.data[:100])
        assert listener.buffer.dropped == dropped > 0
        assert listener.buffer.take(1 << 20) == (b"", 0)


def test_drops_are_handed_over_behind_the_last_frame_before_them() -> None:
    buffer = FrameBuffer(2 * FRAME_BYTES)
    for number in range(5):
        buffer.add(pack_frame(number, 0x181, 8, bytes(8)))
    assert buffer.take(FRAME_BYTES)[1] == 0
    assert buffer.take(FRAME_BYTES)[1] == 3
    buffer.count_dropped(4)
    assert buffer.take(FRAME_BYTES) == (b"", 0)
    buffer.add(pack_frame(9, 0x181, 8, bytes(8)))
    assert buffer.take(FRAME_BYTES)[1] == 4


def test_a_frame_that_cannot_be_read_is_counted_and_the_others_go_on() -> None:
    channel = uuid.uuid4().hex
    with open_bus("virtual", channel) as bus, listening_to(lambda: open_bus("virtual", channel)) as listener:
        bus.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
        bus.send(can.Message(arbitration_id=2, is_fd=True, data=bytes(12)))
        bus.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
        assert listener.gathered(1).arbitration_id.tolist() == [0x181]
        assert listener.status.frames_unreadable == 2
        assert listener.status.bus_fault is None
    assert len([text for text in listener.said if "a CAN FD frame on a classic CAN bus" in text]) == 1


class Unplugged(can.BusABC):
    """A bus whose interface is down."""

    def __init__(self) -> None:
        super().__init__("unplugged")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002 - python-can's
        raise OSError(errno.ENETDOWN, "Network is down")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError


def test_delays_grow_until_an_attempt_succeeds() -> None:
    delays = Backoff(0.5, 3.0)
    assert [delays.failed() for _ in range(5)] == [0.5, 1.0, 2.0, 3.0, 3.0]
    delays.succeeded()
    assert delays.failed() == 0.5


def test_a_bus_that_goes_away_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "FIRST_DELAY_S", 0.05)
    channel, attempts = uuid.uuid4().hex, []

    def opened() -> can.BusABC:
        attempts.append(time.monotonic())
        if len(attempts) == 1:
            return Unplugged()
        if len(attempts) < 5:
            return open_bus("socketcan", "nocan77")
        return open_bus("virtual", channel)

    with open_bus("virtual", channel) as bus, listening_to(opened) as listener:
        eventually(lambda: len(attempts) == 5 and listener.status.bus_fault is None)
        bus.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
        assert listener.gathered(1).arbitration_id.tolist() == [0x181]
    assert any("bad: the bus failed: OSError: [Errno 100] Network is down" in text for text in listener.said)
    assert any("nocan77" in text for text in listener.said)


def test_a_bus_that_can_never_be_opened_is_refused() -> None:
    with listening_to(lambda: open_bus("virtual", uuid.uuid4().hex)):
        pass
    refused = listening.Listening(
        listening.BusSource("a bus", lambda: open_bus("carrier_pigeon", "1")),
        FrameBuffer(1),
        LiveStatus(),
        Reports(lambda _text, **_: None, lambda *_: None),
    )
    refused.run()
    assert isinstance(refused.refused, ParameterError)


def test_a_silent_bus_is_said_once_and_so_is_its_return(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "SILENT_S", 0.3)
    channel = uuid.uuid4().hex
    with open_bus("virtual", channel) as bus, listening_to(lambda: open_bus("virtual", channel)) as listener:
        eventually(lambda: listener.status.silent_since_s is not None)
        bus.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
        listener.gathered(1)
        assert listener.status.silent_since_s is None
    assert [text for text in listener.said if "silent" in text or "again" in text] == [
        "bad: no frame for 0.3 s: the bus is silent",
        "frames come again",
    ]


def test_frames_that_the_kernel_dropped_are_counted() -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    options = {"port": PORT + 1, "fd": False}
    with open_bus("udp_multicast", GROUP, **options) as bus, open_bus("udp_multicast", GROUP, **options) as ours:
        with socket.socket(fileno=os.dup(ours.fileno())) as end:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        losses = listening._Losses(ours)
        if losses._end is None:
            pytest.skip("this kernel does not count what a socket drops")
        for _ in range(200):
            bus.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
        waiting = 0
        while ours.recv(0.5) is not None:
            waiting += 1
        assert losses.new() == 200 - waiting > 0
        losses.close()


def test_frames_are_sent_at_their_pace_until_a_stop_is_requested() -> None:
    channel = uuid.uuid4().hex
    with open_bus("virtual", channel) as bus, open_bus("virtual", channel) as other:
        batch = Run(seconds=0.3).frames()
        begin = time.monotonic()
        send(bus, batch)
        last_sync = batch.t_ns[batch.arbitration_id == SYNC_ID][-1]
        assert time.monotonic() - begin >= (int(last_sync) - int(batch.t_ns[0])) * 1e-9
        stop = threading.Event()
        stop.set()
        assert send(bus, batch, stop=stop) == 0
        stamps = []
        while (message := other.recv(0)) is not None:
            stamps.append(message.timestamp)
        assert len(stamps) == len(batch)


@pytest.mark.parametrize(("interface", "channel"), [("carrier_pigeon", "1"), ("socketcan", "nocan77")])
def test_a_bus_that_is_not_there_is_named(interface: str, channel: str) -> None:
    with pytest.raises(ParameterError, match=f"{interface}|{channel}"):
        open_bus(interface, channel)


def test_two_receivers_on_one_machine_do_not_hear_each_others_bus() -> None:
    problem = multicast_problem()
    if problem:
        pytest.skip(problem)
    groups, options = (GROUP, "239.74.163.78"), {"port": PORT + 2, "fd": False}
    with ExitStack() as stack:
        ours, senders = (
            [stack.enter_context(open_bus("udp_multicast", group, **options)) for group in groups] for _ in range(2)
        )
        for number in range(50):
            for place, sender in enumerate(senders):
                sender.send(can.Message(arbitration_id=0x181 + place, is_extended_id=False, data=bytes([number])))
        for place, bus in enumerate(ours):
            received = []
            while (message := bus.recv(0.3)) is not None:
                received.append((message.arbitration_id, message.data[0]))
            assert received == [(0x181 + place, number) for number in range(50)]
