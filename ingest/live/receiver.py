"""The live receiver of one vehicle: one thread listens, one writes to the spool, one stores; none waits for another."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path

from ingest.live.buffer import FrameBuffer
from ingest.live.listening import BusSource, Listening
from ingest.live.spool import Spool, spool_folder
from ingest.live.spooling import Spooling
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import Stores, Storing

WATCH_EVERY_S = 0.2


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """Of a live receiver.

    Attributes:
        vehicle: Code of the vehicle on the bus.
        spool_dir: Folder of all spools.
        spool_bytes, memory_bytes: How much may wait on the disk, and in memory while the disk takes nothing.
        piece_seconds: Length of a piece, s.
        shutdown_s: How long storing may go on after a stop is requested, s.
    """

    vehicle: str
    spool_dir: Path
    spool_bytes: int
    memory_bytes: int
    piece_seconds: float
    shutdown_s: float


def receive_live(
    settings: LiveSettings,
    source: BusSource,
    stores: Stores,
    status: LiveStatus,
    reports: Reports,
    stop: threading.Event,
) -> None:
    """Receive a bus until ``stop`` is set. What has no receipt then stays in the spool for the next start.

    Args:
        settings: Which vehicle, and how much may wait.
        stop: Set by whoever ends it; set here where bus or stores refuse for good.

    Raises:
        ConflictError: Another process receives this vehicle.
        StorageError: The folder of the spool cannot be used.
        TreadwatchError: Bus or stores refused for good.
    """
    spool = Spool(spool_folder(settings.spool_dir, settings.vehicle), settings.spool_bytes)
    buffer = FrameBuffer(settings.memory_bytes)
    listening = Listening(source, buffer, status, reports)
    spooling = Spooling(spool, buffer, settings.piece_seconds, status, reports)
    storing = Storing(spool, settings.vehicle, stores, status, reports)
    status.spool_limit_bytes = settings.spool_bytes
    status.threads = [
        threading.Thread(target=work.run, name=type(work).__name__.lower(), daemon=True)
        for work in (listening, spooling, storing)
    ]
    for thread in status.threads:
        thread.start()
    while not stop.wait(WATCH_EVERY_S):
        if listening.refused is not None or storing.refused is not None:
            stop.set()
    deadline = time.monotonic() + settings.shutdown_s
    ends = (listening.end, spooling.end, storing.end)
    for end, thread in zip(ends, status.threads, strict=True):  # in the order in which frames go
        end()
        thread.join(max(deadline - time.monotonic(), WATCH_EVERY_S))
    if not status.threads[1].is_alive():
        spool.close()
    left = spool.pieces_waiting
    if left:
        reports.say(f"{left} pieces wait in the spool for the next start")
    for work in (listening, storing):
        if work.refused is not None:
            raise work.refused
