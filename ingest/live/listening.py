"""Live buses through python-can: opened, sent on at the pace of the stamps, and listened to.

The thread that listens takes frames off a bus into memory, and opens a bus that went away again. ``virtual`` works
inside one process, ``udp_multicast`` between processes and machines, ``socketcan`` on a vehicle.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Any

import can
import numpy as np

from estimation.errors import ConflictError, ParameterError
from estimation.values.runs import first_line
from ingest.catalogue import SYNC_ID
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG, FrameBatch
from ingest.live.spool import FrameBuffer, pack_frame
from ingest.live.status import Backoff, LiveStatus, Reports

PATIENCE_S = 0.2
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 30.0

SILENT_S = 10.0  # after so long without a frame the bus is called silent
REOPENED_AFTER_S = 60.0
"""A silent bus is opened again so often: an interface that went down and up may have left its group."""

UNREADABLE_IN_A_ROW = 1000
"""Frames that cannot be read are those of others; so many one after the other are a fault of the bus."""

DRAINED_FOR_S = 1.0
LOSSES_EVERY_S = 0.5

_SO_MEMINFO, _MEMINFO = 55, struct.Struct("9I")  # linux/sock_diag.h
_DROPS = 8


@dataclass(frozen=True, slots=True)
class BusSource:
    """A bus to listen to."""

    name: str
    open: Callable[[], can.BusABC]  # opens it; raises ParameterError where it cannot


class Listening:
    """Listens until asked to end; nothing that the bus does can end it.

    An error at opening the bus that does not pass is kept as ``refused``.
    """

    def __init__(self, source: BusSource, buffer: FrameBuffer, status: LiveStatus, reports: Reports) -> None:
        self._source = source
        self._buffer = buffer
        self._status = status
        self._reports = reports
        self._ending = threading.Event()
        self._delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
        self._last_frame_at = time.monotonic()
        self.refused: ParameterError | None = None

    def end(self) -> None:
        """Make :meth:`run` return."""
        self._ending.set()

    def run(self) -> None:
        """Listen."""
        while not self._ending.is_set():
            bus = self._opened()
            if self.refused is not None:
                return
            if bus is None:
                self._ending.wait(self._delays.failed())
                continue
            with closing(_Losses(bus)) as losses:
                fault = self._receive(bus, losses)
            with suppress(Exception):  # a bus that is gone may fail here too
                bus.shutdown()
            if fault is not None:
                self._failed(fault)
                self._ending.wait(self._delays.failed())

    def _opened(self) -> can.BusABC | None:
        try:
            bus = self._source.open()
        except Exception as error:  # noqa: BLE001 - it may be there later
            cause = error.__cause__
            passing = isinstance(cause, OSError | can.CanError) and not isinstance(cause, NotImplementedError)
            if isinstance(error, ParameterError) and not passing:
                self.refused = error
            else:
                self._failed(first_line(error))
            return None
        if self._status.bus_fault is not None:
            self._reports.say(f"listening to {self._source.name}; stop with Ctrl-C")
        self._status.bus_fault = None
        return bus

    def _failed(self, fault: str) -> None:
        if fault != self._status.bus_fault:
            self._reports.say(f"the bus failed: {fault}; it is opened again", bad=True)
        self._status.bus_fault = fault

    def _receive(self, bus: can.BusABC, losses: _Losses) -> str | None:
        """Take frames until the bus fails (return why), was silent for long, or an end is requested."""
        opened_at, unreadable = time.monotonic(), 0
        leave_at = float("inf")  # once an end is requested, what waits in the socket is taken
        while time.monotonic() < leave_at:
            if self._ending.is_set():
                leave_at = min(leave_at, time.monotonic() + DRAINED_FOR_S)
            try:
                message = bus.recv(0.0 if self._ending.is_set() else PATIENCE_S)
                frame = None if message is None else packed(message)
            except Exception as error:  # noqa: BLE001 - whatever python-can raises, other frames are to be received
                unreadable += 1
                if (
                    isinstance(error, OSError)
                    or isinstance(error.__cause__, OSError)
                    or unreadable >= UNREADABLE_IN_A_ROW
                ):
                    return first_line(error)  # the interface is gone, or nothing on it is a frame
                if self._status.frames_unreadable == 0:
                    self._reports.say(f"a frame cannot be read, it is left out and counted: {error}", bad=True)
                self._status.frames_unreadable += 1
                continue
            lost = losses.new()
            self._status.frames_lost_by_bus += lost
            self._buffer.count_dropped(lost)
            if frame is not None:
                unreadable = 0
                self._take(frame)
            elif self._ending.is_set() or (
                self._silent() > REOPENED_AFTER_S and time.monotonic() - opened_at > REOPENED_AFTER_S
            ):
                return None
        return None

    def _take(self, frame: bytes) -> None:
        self._buffer.add(frame)
        self._status.frames_received += 1
        self._status.last_frame_s = time.time()
        self._last_frame_at = time.monotonic()
        if self._status.silent_since_s is not None:
            self._status.silent_since_s = None
            self._reports.say("frames come again")
        self._delays.succeeded()

    def _silent(self) -> float:
        silent_s = time.monotonic() - self._last_frame_at
        if silent_s > SILENT_S and self._status.silent_since_s is None:
            self._status.silent_since_s = time.time() - silent_s
            self._reports.say(f"no frame for {SILENT_S:g} s: the bus is silent", bad=True)
        return silent_s


def packed(message: can.Message) -> bytes:
    """Return a frame of python-can as bytes of the spool."""
    if message.is_fd or message.dlc > DATA_BYTES:
        raise ValueError("a CAN FD frame on a classic CAN bus")
    identifier = message.arbitration_id
    identifier |= EXTENDED_FLAG if message.is_extended_id and not message.is_error_frame else 0
    identifier |= REMOTE_FLAG if message.is_remote_frame else 0
    identifier |= ERROR_FLAG if message.is_error_frame else 0
    return pack_frame(round(message.timestamp * 1e9), identifier, message.dlc, bytes(message.data[:DATA_BYTES]))


class _Losses:
    """Frames that the kernel dropped because this process was held up and the socket was full."""

    def __init__(self, bus: can.BusABC) -> None:
        self._next_look = 0.0
        self._last = 0
        self._end: socket.socket | None = None
        try:
            self._end = socket.socket(fileno=os.dup(bus.fileno()))
            self._last = self._count()
        except (OSError, NotImplementedError, struct.error):
            self.close()  # a bus without a socket, or a kernel that does not count

    def new(self) -> int:
        """Return how many since it was last asked; it looks once a second."""
        now = time.monotonic()
        if self._end is None or now < self._next_look:
            return 0
        self._next_look = now + LOSSES_EVERY_S
        before, self._last = self._last, self._count()
        return (self._last - before) % (1 << 32)

    def close(self) -> None:
        """Let go of the socket."""
        if self._end is not None:
            self._end.close()
            self._end = None

    def _count(self) -> int:
        assert self._end is not None
        return int(_MEMINFO.unpack(self._end.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[_DROPS])


VIRTUAL = "virtual"
MULTICAST = "udp_multicast"
INTERFACES = (VIRTUAL, MULTICAST, "socketcan")

RECEIVE_BYTES = 1 << 22
"""Of the socket: seconds of frames wait there while this process is held up. The kernel may grant less."""


_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h
_SO_RCVBUFFORCE = 33  # asm-generic/socket.h: beyond net.core.rmem_max, where this process may


def open_bus(interface: str, channel: str, **options: Any) -> can.BusABC:  # noqa: ANN401 - python-can's own options
    """Open a bus; use it as a context manager."""
    if interface not in INTERFACES:
        raise ParameterError(f"is {interface!r}; known are {', '.join(INTERFACES)}", field="interface")
    try:
        bus = can.Bus(channel=channel, interface=interface, **options)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        raise ParameterError(f"{interface} bus {channel!r} cannot be opened: {error}", field="channel") from error
    if interface != VIRTUAL:
        with socket.socket(fileno=os.dup(bus.fileno())) as end:
            try:
                end.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BYTES)
            except OSError:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
            if interface == MULTICAST:
                _hear_own_group_alone(end)
    return bus


def _hear_own_group_alone(end: socket.socket) -> None:
    """Leave out what is sent to groups that other sockets of this machine have joined on the same port.

    Linux hands a datagram of any joined group to every socket on its port unless this is switched off.
    """
    if not sys.platform.startswith("linux"):
        return
    if end.family == socket.AF_INET6:
        end.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
    else:
        end.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


def send(
    bus: can.BusABC,
    batch: FrameBatch,
    *,
    stop: threading.Event | None = None,
    clock_s: Callable[[], float] = time.monotonic,
) -> int:
    """Send frames at the pace of their time stamps, the first at once; return how many were sent.

    The frames of a cycle go out right behind their SYNC: a pause between them could grow beyond the cycle.
    """
    if len(batch) == 0:
        return 0
    begin, ended = clock_s(), stop or threading.Event()
    due = begin + (batch.t_ns - batch.t_ns[0]) * 1e-9
    sync = np.maximum.accumulate(np.where(batch.arbitration_id == SYNC_ID, np.arange(len(batch)), -1))
    due[sync >= 0] = due[sync[sync >= 0]]
    for position, message in enumerate(messages_of(batch)):
        ahead = float(due[position]) - clock_s()
        if ahead > 0.0:
            ended.wait(ahead)
        if ended.is_set():
            return position
        try:
            bus.send(message)
        except can.CanError as error:
            raise ConflictError(f"the bus refused a frame: {error}", kind="bus") from error
    return len(batch)


def messages_of(batch: FrameBatch) -> Iterator[can.Message]:
    """Yield the frames of a batch as python-can's messages."""
    columns = (batch.t_ns.tolist(), batch.arbitration_id.tolist(), batch.dlc.tolist(), batch.data)
    for t_ns, identifier, length, data in zip(*columns, strict=True):
        remote = bool(identifier & REMOTE_FLAG)
        yield can.Message(
            timestamp=t_ns / 1e9,
            arbitration_id=identifier & IDENTIFIER_BITS,
            is_extended_id=bool(identifier & EXTENDED_FLAG),
            is_remote_frame=remote,
            is_error_frame=bool(identifier & ERROR_FLAG),
            dlc=length,
            data=None if remote else data[:length].tobytes(),
        )
