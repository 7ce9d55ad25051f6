"""The thread that listens: takes frames off a bus into memory, and opens a bus that went away again."""

from __future__ import annotations

import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass

import can

from estimation.errors import ParameterError
from estimation.values.runs import first_line
from ingest.frames import DATA_BYTES, ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from ingest.live.records import FrameBuffer, pack_frame
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
