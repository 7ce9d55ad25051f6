"""One live receiver as a process of its own, and a vehicle that transmits to it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event, Thread

import numpy as np

from api.settings import Settings
from bench.chaos.small_deployment import until
from bench.service_environment import environment_of
from estimation.values.units import SECOND_NS
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.frames import FrameBatch, concatenate, sort_by_time, take
from ingest.live.listening import open_bus, send
from ingest.logs import read_log
from tests.ingest.vehicle_bus import VEHICLE, Run

CHANNEL = "239.74.163.91"
PATIENCE_S = 120.0
OTHERS = 0x500
"""Identifiers from here on are those of other devices on a busy bus, which nobody decodes."""


@dataclass
class LiveRound:
    """One deployment with its receiver, and what was transmitted to it.

    Attributes:
        away_ns: When no process received.
    """

    settings: Settings
    log: Path
    process: subprocess.Popen[bytes] | None = None
    sent: list[FrameBatch] = field(default_factory=list)
    sent_ns: list[int] = field(default_factory=list)
    away_ns: list[tuple[int, int]] = field(default_factory=list)

    def start(self) -> None:
        """Start a receiver and wait until it listens."""
        arguments = ["ingest", "--interface", "udp_multicast", "--channel", CHANNEL, "--vehicle", VEHICLE]
        before = self.said().count("listening")
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(  # noqa: S603 - our own command
                [sys.executable, "-c", "from api.cli import main; main()", *arguments, "--chunk-seconds", "1"],
                env=environment_of(self.settings),
                stdout=log,
                stderr=log,
            )
        assert until(lambda: self.said().count("listening") > before, PATIENCE_S) is not None, self.said()

    def kill(self) -> None:
        """Kill the receiver and start it again; what is transmitted meanwhile reaches nobody."""
        assert self.process is not None
        self.process.send_signal(signal.SIGKILL)
        begin = time.time_ns()
        self.process.wait()
        self.start()
        self.away_ns.append((begin, time.time_ns()))

    def end(self, patience_s: float = PATIENCE_S) -> None:
        """End the receiver once nothing waits in its spool, or after some patience."""
        assert self.process is not None
        until(lambda: not any(self.spool()), patience_s)
        self.process.terminate()
        self.process.wait(PATIENCE_S)

    def said(self) -> str:
        """Return what the receivers have written."""
        return self.log.read_text() if self.log.exists() else ""

    def spool(self) -> list[Path]:
        """Return the pieces in the spool."""
        found = []
        for path in (self.settings.spool_dir / VEHICLE).glob("*.*"):
            with suppress(FileNotFoundError):  # it has its receipt by now
                found += [path] if path.stat().st_size else []
        return found


@contextmanager
def transmitting(one: LiveRound, busy: int = 1) -> Iterator[None]:
    """Transmit without an end, a second at a time; every payload is known by its batch.

    Args:
        busy: How many times the acceleration frames are on the bus: again under identifiers of other devices.
    """
    stop = Event()

    def transmit() -> None:
        with open_bus("udp_multicast", CHANNEL) as bus:
            while not stop.is_set():
                begin_ns = time.time_ns() // SECOND_NS * SECOND_NS
                batch = _busy(Run(seconds=1.0, start_ns=begin_ns, seed=len(one.sent)).frames(), busy)
                one.sent_ns.append(time.time_ns())
                one.sent.append(batch)
                send(bus, batch)

    thread = Thread(target=transmit)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def stored_frames(one: LiveRound, storage: SqlStorage) -> FrameBatch:
    """Return all frames that have a receipt."""
    with storage.read() as unit:
        records = [record for state in ChunkState for record in unit.chunks.with_state(state, limit=100_000)]
    raw = FileRawStore(one.settings.data_dir / "raw")
    return concatenate([read_log(raw.path(record.digest, record.suffix)) for record in records])


def acceleration_frames(batch: FrameBatch) -> np.ndarray:
    """Return which frames are those of acceleration, whose payloads are drawn: no two are the same."""
    return np.isin(batch.arbitration_id, (0x181, 0x182))


def _busy(batch: FrameBatch, busy: int) -> FrameBatch:
    own = take(batch, acceleration_frames(batch))
    others = [replace(own, arbitration_id=own.arbitration_id - 0x181 + OTHERS + 2 * n) for n in range(busy - 1)]
    return sort_by_time(concatenate([batch, *others])) if others else batch
