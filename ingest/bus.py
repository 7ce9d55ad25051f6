"""Live buses through python-can: listen without falling behind, cut into recordings, send at the pace of the stamps.

``virtual`` works inside one process, ``udp_multicast`` between processes and machines, ``socketcan`` on a vehicle.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np

from estimation.errors import ConflictError, ParameterError
from ingest.canopen import SYNC_ID
from ingest.frames import (
    DATA_BYTES,
    DEFAULT_CHANNEL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    REMOTE_FLAG,
    FrameBatch,
    empty_batch,
    from_owned_arrays,
    sort_by_time,
)
from ingest.logs import write_blf

VIRTUAL = "virtual"
INTERFACES = (VIRTUAL, "udp_multicast", "socketcan")

BUFFERED_FRAMES = 2_000_000
"""Frames that may wait to be taken; what comes after is dropped and counted."""

RECEIVE_BYTES = 1 << 22
"""Of the socket: seconds of frames wait there while this process is held up. The kernel may grant less."""

PATIENCE_S = 0.2
IDENTIFIER_BITS = 0x1FFF_FFFF

_Row = tuple[int, int, int, bytes]


def open_bus(interface: str, channel: str, **options: Any) -> can.BusABC:  # noqa: ANN401 - python-can's own options
    """Open a bus; use it as a context manager.

    Parameters
    ----------
    interface
        One of ``INTERFACES``.
    channel
        Channel of the interface, such as can0.
    options
        Options of python-can.

    Raises
    ------
    ParameterError
        No such interface, or it cannot be opened on this machine.
    """
    if interface not in INTERFACES:
        raise ParameterError(f"is {interface!r}; known are {', '.join(INTERFACES)}", field="interface")
    try:
        bus = can.Bus(channel=channel, interface=interface, **options)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        raise ParameterError(f"{interface} bus {channel!r} cannot be opened: {error}", field="channel") from error
    if interface != VIRTUAL:
        with socket.socket(fileno=os.dup(bus.fileno())) as end:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
    return bus


class BusListener(can.Listener):
    """Takes frames off a bus into a bounded buffer; nothing raised in it can stop the thread that feeds it."""

    def __init__(self, limit: int = BUFFERED_FRAMES) -> None:
        self._limit = limit
        self._lock = threading.Lock()
        self._rows: list[_Row] = []
        self._dropped = 0
        self._failure: Exception | None = None

    def on_message_received(self, msg: can.Message) -> None:
        """Keep a frame, or count it as dropped when the buffer is full."""
        try:
            row = _row(msg)
        except Exception as error:  # noqa: BLE001 - python-can would end its thread for good
            self._failure = error
            return
        with self._lock:
            if len(self._rows) < self._limit:
                self._rows.append(row)
            else:
                self._dropped += 1

    def on_error(self, exc: Exception) -> None:
        """Keep what the bus itself raised."""
        self._failure = exc

    def take(self) -> tuple[FrameBatch, int]:
        """Return the frames since the last call, and how many were dropped since then.

        Raises
        ------
        ConflictError
            The bus or a frame of it failed since the last call; frames so far are kept for the next call.
        """
        failure, self._failure = self._failure, None
        if failure is not None:
            raise ConflictError(f"the bus failed: {type(failure).__name__}: {failure}", kind="bus")
        with self._lock:
            rows, self._rows = self._rows, []
            dropped, self._dropped = self._dropped, 0
        return _batch(rows), dropped


@dataclass(frozen=True, slots=True)
class LiveChunk:
    """A piece of a live bus, written as a log file."""

    path: Path
    frames: int
    dropped: int


def record(
    bus: can.BusABC,
    directory: Path,
    name: str,
    *,
    chunk_seconds: float,
    stop: threading.Event,
    limit: int = BUFFERED_FRAMES,
) -> Iterator[LiveChunk]:
    """Listen to a bus and yield log files of ``chunk_seconds`` each, until ``stop`` is set.

    Files are called ``<name>__<first stamp in ns>.blf``. A bus without frames gives no files; the frames received when
    ``stop`` is set become the last one.

    Parameters
    ----------
    bus
        An open bus.
    directory
        Folder of the files.
    name
        First part of their names.
    chunk_seconds
        Length of a file, s.
    stop
        Ends the recording when set.
    limit
        Frames that may wait to be written.

    Raises
    ------
    ConflictError
        The bus failed; what was received before has been yielded.
    """
    if chunk_seconds <= 0.0:
        raise ParameterError(f"is {chunk_seconds:g}; a chunk has a length", field="chunk seconds")
    listener = BusListener(limit)
    notifier = can.Notifier(bus, [listener], timeout=PATIENCE_S)
    try:
        while not stop.is_set():
            stop.wait(chunk_seconds)
            yield from _written(listener, directory, name)
    finally:
        notifier.stop()
    yield from _written(listener, directory, name)


def _written(listener: BusListener, directory: Path, name: str) -> Iterator[LiveChunk]:
    try:
        batch, dropped = listener.take()
    except ConflictError:
        batch, dropped = listener.take()
        yield from _write(batch, dropped, directory, name)
        raise
    yield from _write(batch, dropped, directory, name)


def _write(batch: FrameBatch, dropped: int, directory: Path, name: str) -> Iterator[LiveChunk]:
    if len(batch):
        path = directory / f"{name}__{int(batch.t_ns[0])}.blf"
        write_blf(path, batch)
        yield LiveChunk(path, len(batch), dropped)


def send(
    bus: can.BusABC,
    batch: FrameBatch,
    *,
    stop: threading.Event | None = None,
    clock_s: Callable[[], float] = time.monotonic,
) -> int:
    """Send frames at the pace of their time stamps, the first at once; return how many were sent.

    The frames of a cycle go out right behind their SYNC: a pause between them could grow beyond the cycle.

    Parameters
    ----------
    bus
        An open bus.
    batch
        Frames in the order of time.
    stop
        Ends the sending when set, within a frame.
    clock_s
        A clock that runs in seconds.

    Raises
    ------
    ConflictError
        The bus refused a frame.
    """
    if len(batch) == 0:
        return 0
    begin = clock_s()
    due = begin + (batch.t_ns - batch.t_ns[0]) * 1e-9
    sync = np.maximum.accumulate(np.where(batch.arbitration_id == SYNC_ID, np.arange(len(batch)), -1))
    due[sync >= 0] = due[sync[sync >= 0]]
    for position, message in enumerate(messages_of(batch)):
        ahead = float(due[position]) - clock_s()
        if ahead > 0.0:
            _pause(stop, ahead)
        if stop is not None and stop.is_set():
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


def _pause(stop: threading.Event | None, seconds: float) -> None:
    if stop is None:
        time.sleep(seconds)
    else:
        stop.wait(seconds)


def _row(message: can.Message) -> _Row:
    if message.is_fd:
        raise ValueError("a CAN FD frame on a classic CAN bus")
    identifier = message.arbitration_id
    identifier |= EXTENDED_FLAG if message.is_extended_id and not message.is_error_frame else 0
    identifier |= REMOTE_FLAG if message.is_remote_frame else 0
    identifier |= ERROR_FLAG if message.is_error_frame else 0
    data = bytes(message.data[:DATA_BYTES])
    return round(message.timestamp * 1e9), identifier, message.dlc, data.ljust(DATA_BYTES, b"\0")


def _batch(rows: list[_Row]) -> FrameBatch:
    if not rows:
        return empty_batch()
    t_ns, identifier, length, data = zip(*rows, strict=True)
    frames = from_owned_arrays(
        DEFAULT_CHANNEL,
        np.array(t_ns, dtype=np.int64),
        np.array(identifier, dtype=np.uint32),
        np.array(length, dtype=np.uint8),
        np.frombuffer(b"".join(data), dtype=np.uint8).reshape(-1, DATA_BYTES).copy(),
    )
    return sort_by_time(frames)
