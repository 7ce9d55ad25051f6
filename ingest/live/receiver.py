"""The live receiver of one vehicle: one thread listens, one writes to the spool, one stores; none waits for another."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from estimation.errors import StorageError
from ingest.live.listening import BusSource, Listening
from ingest.live.spool import FRAME_BYTES, DropCount, FrameBuffer, Record, Spool, spool_folder
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import Stores, Storing

EVERY_S = 0.5  # between two writes: with the fsync behind it, a frame is on the disk within a second of its reception
RECORD_FRAMES = 40_000
PIECE_BYTES = 1 << 24  # a piece is closed early when it is as large: it is held in memory while it is stored
REPORT_EVERY_S = 60.0  # drops that go on are reported so often, and at least once a piece


class Spooling:
    """Writes what is in the buffer until asked to end, then the rest of it."""

    def __init__(
        self, spool: Spool, buffer: FrameBuffer, piece_seconds: float, status: LiveStatus, reports: Reports
    ) -> None:
        self._spool = spool
        self._buffer = buffer
        self._piece_seconds = piece_seconds
        self._status = status
        self._reports = reports
        self._ending = threading.Event()
        self._frames, self._dropped = b"", 0  # taken from the buffer and not on the disk yet
        self._piece_begun: float | None = None
        self._piece_bytes = 0
        self._before = 0  # frames dropped before this process that a record mentions
        self._recorded = 0
        self._reported, self._reported_at = 0, -REPORT_EVERY_S

    def end(self) -> None:
        """Make :meth:`run` write the rest and return."""
        self._ending.set()

    def run(self) -> None:
        """Write."""
        while not self._take_over():
            if self._ending.wait(EVERY_S):
                return
        while not self._ending.wait(EVERY_S):
            self._step()
        self._step()
        self._spool.close_piece()
        if lost := (len(self._frames) + self._buffer.size_bytes) // FRAME_BYTES:  # they cannot be written any more
            self._buffer.count_dropped(lost)
            self._reported_at = -REPORT_EVERY_S
            self._count_dropped()

    def _take_over(self) -> bool:
        try:
            left = self._spool.take_over()
        except (OSError, StorageError) as error:
            self._fault(error)
            return False
        count = self._spool.drop_count
        self._before = self._recorded = count.recorded
        self._buffer.count_dropped(count.total - count.recorded)  # the next record mentions them
        self._status.frames_dropped = self._reported = count.total
        if left.pieces:
            torn = f", {left.torn_bytes:,} bytes of a torn record were cut" if left.torn_bytes else ""
            self._reports.say(f"{left.pieces} pieces of an earlier start wait in the spool{torn}")
        if left.damaged_bytes:
            self._reports.say(f"{left.damaged_bytes:,} bytes in the spool are damaged and left out", bad=True)
        return True

    def _step(self) -> None:
        try:
            while self._write():
                continue
            self._count_dropped()
        except Exception as error:  # noqa: BLE001 - whatever it is, the frames that come next are to be written
            self._fault(error)
        begun = self._piece_begun
        if begun is not None and (time.monotonic() - begun >= self._piece_seconds or self._piece_bytes >= PIECE_BYTES):
            self._spool.close_piece()
            self._piece_begun, self._piece_bytes = None, 0
        self._status.buffered_bytes = self._buffer.size_bytes + len(self._frames)
        self._status.spool_bytes = self._spool.size_bytes
        self._status.pieces_waiting = self._spool.pieces_waiting
        self._status.pieces_aside = self._spool.pieces_aside

    def _write(self) -> bool:
        if not self._frames:
            self._frames, self._dropped = self._buffer.take(RECORD_FRAMES * FRAME_BYTES)
        if not self._frames:
            return False
        try:
            self._spool.append(Record(self._frames, self._dropped, self._recorded + self._dropped))
        except (OSError, StorageError) as error:
            self._fault(error)
            self._spool.close_piece()  # what waits for its receipt makes room
            self._piece_begun = None
            return False
        self._recorded += self._dropped
        if self._piece_begun is None:
            self._piece_begun, self._piece_bytes = time.monotonic(), 0
        self._piece_bytes += len(self._frames)
        self._status.frames_spooled += len(self._frames) // FRAME_BYTES
        self._frames, self._dropped = b"", 0
        if self._status.spool_fault is not None:
            self._reports.say("frames reach the spool again")
            self._status.spool_fault = None
        return True

    def _count_dropped(self) -> None:
        total = self._before + self._buffer.dropped
        self._status.frames_dropped = total
        try:
            self._spool.count_dropped(DropCount(total, self._recorded))
        except OSError as error:
            self._fault(error)
        now = time.monotonic()
        if total > self._reported and now - self._reported_at >= min(REPORT_EVERY_S, self._piece_seconds):
            why = self._status.spool_fault or "this machine was held up, and the socket was full"
            self._reports.say(f"{total - self._reported:,} frames dropped: {why}", bad=True)
            self._reported, self._reported_at = total, now

    def _fault(self, error: Exception) -> None:
        fault = str(error)
        if self._status.spool_fault is None:
            self._reports.say(f"frames wait in memory, they cannot be written: {fault}", bad=True)
        self._status.spool_fault = fault


WATCH_EVERY_S = 0.2


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """Of a live receiver."""

    vehicle: str
    spool_dir: Path
    spool_bytes: int  # that may wait on the disk
    memory_bytes: int  # that may wait in memory while the disk takes nothing
    piece_seconds: float
    shutdown_s: float  # how long storing may go on after a stop is requested, s


@dataclass(frozen=True, slots=True)
class ReceivedBus:
    """A bus with all that receiving it takes."""

    settings: LiveSettings
    source: BusSource
    stores: Stores
    status: LiveStatus
    reports: Reports


def receive_live(bus: ReceivedBus, stop: threading.Event) -> None:
    """Receive a bus until ``stop`` is set. What has no receipt then stays in the spool for the next start.

    ``stop`` is set here where bus or stores refuse for good, which is raised.
    """
    spool = Spool(spool_folder(bus.settings.spool_dir, bus.settings.vehicle), bus.settings.spool_bytes)
    buffer = FrameBuffer(bus.settings.memory_bytes)
    listening = Listening(bus.source, buffer, bus.status, bus.reports)
    spooling = Spooling(spool, buffer, bus.settings.piece_seconds, bus.status, bus.reports)
    storing = Storing(spool, bus.settings.vehicle, bus.stores, bus.status, bus.reports)
    bus.status.spool_limit_bytes = bus.settings.spool_bytes
    bus.status.threads = [
        threading.Thread(target=work.run, name=type(work).__name__.lower(), daemon=True)
        for work in (listening, spooling, storing)
    ]
    for thread in bus.status.threads:
        thread.start()
    while not stop.wait(WATCH_EVERY_S):
        if listening.refused is not None or storing.refused is not None:
            stop.set()
    deadline = time.monotonic() + bus.settings.shutdown_s
    ends = (listening.end, spooling.end, storing.end)
    for end, thread in zip(ends, bus.status.threads, strict=True):  # in the order in which frames go
        end()
        thread.join(max(deadline - time.monotonic(), WATCH_EVERY_S))
    if not bus.status.threads[1].is_alive():
        spool.close()
    waiting = spool.pieces_waiting
    if waiting:
        bus.reports.say(f"{waiting} pieces wait in the spool for the next start")
    for work in (listening, storing):
        if work.refused is not None:
            raise work.refused


def receive_buses(buses: Sequence[ReceivedBus], stop: threading.Event) -> None:
    """Receive buses until ``stop`` is set, or one of them is refused for good, which ends all of them and is raised.

    What the other buses had received is stored then, or in their spools.
    """
    failures: list[Exception] = []

    def receive(bus: ReceivedBus) -> None:
        try:
            receive_live(bus, stop)
        except Exception as error:  # noqa: BLE001 - whatever it is, the others end in order, then it is raised
            failures.append(error)
            stop.set()

    threads = [
        threading.Thread(target=receive, args=(bus,), name=f"receiver of {bus.settings.vehicle}") for bus in buses
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]
