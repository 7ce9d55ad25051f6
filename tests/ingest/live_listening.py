"""The listening end of a live bus, on its own: what it takes, and what it says."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import can
import numpy as np

from ingest.frames import FrameBatch, from_owned_arrays, sort_by_time
from ingest.live.listening import BusSource, Listening
from ingest.live.spool import FRAME, FRAME_BYTES, FrameBuffer
from ingest.live.status import LiveStatus, Reports

PATIENCE_S = 60.0


@dataclass
class Listener:
    """A thread that listens, with what it has said."""

    buffer: FrameBuffer
    status: LiveStatus
    listening: Listening
    said: list[str] = field(default_factory=list)

    def gathered(self, count: int) -> FrameBatch:
        """Take frames until there are so many, or none came for long."""
        content, until = b"", time.monotonic() + PATIENCE_S
        while len(content) < count * FRAME_BYTES and time.monotonic() < until:
            content += self.buffer.take(1 << 20)[0]
            time.sleep(0.02)
        return frames_in(content)


@contextmanager
def listening_to(open_bus: Callable[[], can.BusABC], limit_bytes: int = 1 << 24) -> Iterator[Listener]:
    """Listen to a bus from a thread; the bus is open at the begin."""
    buffer, status, said = FrameBuffer(limit_bytes), LiveStatus(), []
    opened = threading.Event()

    def say(text: str, *, bad: bool = False) -> None:
        said.append(f"{'bad: ' if bad else ''}{text}")
        opened.set()

    listening = Listening(BusSource("a bus", open_bus), buffer, status, Reports(say, lambda *_: None))
    thread = threading.Thread(target=listening.run, daemon=True)
    thread.start()
    assert opened.wait(PATIENCE_S)
    try:
        yield Listener(buffer, status, listening, said)
    finally:
        listening.end()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def frames_in(content: bytes) -> FrameBatch:
    """Return packed frames as a batch."""
    rows = np.frombuffer(content, FRAME)
    columns = [np.ascontiguousarray(rows[name]) for name in ("t_ns", "arbitration_id", "dlc", "data")]
    return sort_by_time(from_owned_arrays("can0", *(column.copy() for column in columns)))


def eventually(done: Callable[[], bool]) -> None:
    """Wait until something is so."""
    until = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < until
        time.sleep(0.02)
