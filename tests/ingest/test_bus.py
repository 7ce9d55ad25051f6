"""Live buses: the same suite over every transport that this machine has."""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest
from vehicle_bus import SECOND_NS, Run

from estimation.errors import ConflictError, ParameterError
from ingest.bus import BusListener, messages_of, open_bus, record, send
from ingest.canopen import SYNC_ID
from ingest.frames import FrameBatch, concatenate
from ingest.logs import read_log

GROUP = "239.74.163.77"
PORT = 43_117
PATIENCE_S = 60.0


def multicast_problem() -> str:
    """Why there is no multicast here; empty where there is."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            receiver.bind(("", 0))
            receiver.setsockopt(
                socket.IPPROTO_IP,
                socket.IP_ADD_MEMBERSHIP,
                socket.inet_aton(GROUP) + socket.inet_aton("0.0.0.0"),  # noqa: S104 - any interface
            )
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(b"?", (GROUP, receiver.getsockname()[1]))
            receiver.settimeout(2.0)
            receiver.recv(1)
    except OSError as error:
        return f"no multicast on this machine: {error}"
    return ""


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


def gathered(listener: BusListener, count: int) -> FrameBatch:
    """Take frames until there are so many, or none came for long."""
    batches, until = [], time.monotonic() + PATIENCE_S
    while sum(map(len, batches)) < count and time.monotonic() < until:
        batches.append(listener.take()[0])
        time.sleep(0.02)
    return concatenate(batches)


def test_what_is_sent_is_received(buses: tuple[can.BusABC, can.BusABC]) -> None:
    batch = Run(seconds=0.4).frames()
    listener = BusListener()
    notifier = can.Notifier(buses[1], [listener], timeout=0.1)
    try:
        assert send(buses[0], batch) == len(batch)
        received = gathered(listener, len(batch))
    finally:
        notifier.stop()
    assert np.array_equal(received.arbitration_id, batch.arbitration_id)
    assert np.array_equal(received.dlc, batch.dlc)
    assert np.array_equal(received.data, batch.data)
    assert abs(int(received.t_ns[0]) - time.time_ns()) < 60 * SECOND_NS


def test_a_live_bus_is_cut_into_recordings(buses: tuple[can.BusABC, can.BusABC], tmp_path: Path) -> None:
    batch = Run(seconds=1.0).frames()
    stop, chunks = threading.Event(), []

    def listen() -> None:
        for chunk in record(buses[1], tmp_path, "N-7", chunk_seconds=0.3, stop=stop):
            chunks.append(chunk)  # noqa: PERF402 - one by one, to be counted meanwhile

    listening = threading.Thread(target=listen)
    listening.start()
    send(buses[0], batch)
    until = time.monotonic() + PATIENCE_S
    while sum(chunk.frames for chunk in chunks) < len(batch) and time.monotonic() < until:
        time.sleep(0.02)
    stop.set()
    listening.join(PATIENCE_S)
    assert not listening.is_alive()
    assert len(chunks) >= 2
    assert all(chunk.dropped == 0 and chunk.path.name.startswith("N-7__") for chunk in chunks)
    received = concatenate([read_log(chunk.path) for chunk in chunks])
    assert sum(chunk.frames for chunk in chunks) == len(received)
    assert np.array_equal(received.arbitration_id, batch.arbitration_id)
    assert np.array_equal(received.data, batch.data)
    assert np.all(np.diff(received.t_ns) >= 0)


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


def test_a_full_buffer_drops_and_counts() -> None:
    listener = BusListener(limit=100)
    sent = Run(seconds=0.2).frames()
    for message in messages_of(sent):
        listener.on_message_received(message)
    batch, dropped = listener.take()
    assert (len(batch), dropped) == (100, len(sent) - 100)
    assert dropped > 0
    assert listener.take()[1] == 0


def test_a_failure_in_the_listener_is_reported_and_does_not_end_listening(buses: tuple[can.BusABC, can.BusABC]) -> None:
    listener = BusListener()
    listener.on_message_received(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
    listener.on_message_received(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8), timestamp=1.0))
    with pytest.raises(ConflictError, match="CAN FD frame"):
        listener.take()
    assert listener.take()[0].arbitration_id.tolist() == [0x181]
    notifier = can.Notifier(buses[1], [listener], timeout=0.1)
    try:
        listener.on_error(OSError("cable out"))
        with pytest.raises(ConflictError, match="cable out"):
            listener.take()
        send(buses[0], Run(seconds=0.02).frames())
        assert len(gathered(listener, 5)) >= 5
        assert notifier.exception is None
    finally:
        notifier.stop()


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
