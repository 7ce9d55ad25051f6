"""What a live receiver is doing, for its health endpoint and its messages."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from ingest.receiver import ChunkReceipt

REJECTED_IN_A_ROW = 3
"""Recordings that are rejected behind one that was decoded before the receiver is not ready; else the first one is."""


@dataclass(slots=True)
class LiveStatus:
    """What the threads of a receiver know; each field is written by one thread, and read by any.

    Attributes:
        bus_fault, spool_fault, raw_fault, database_fault: What is wrong with the bus, the disk of the spool, the raw
            store and the database; None while they work.
        frames_received, frames_unreadable, frames_spooled: Since the start; the unreadable ones are no classic CAN
            frames, the spooled ones are on the disk.
        frames_lost_by_bus: Since the start, before they came to this process: its socket was full. They are among the
            dropped ones.
        frames_dropped: Of this vehicle, also before the start.
        buffered_bytes, spool_bytes, pieces_waiting, pieces_aside: What has no receipt yet: in memory, on the disk, and
            the pieces of it.
        pieces_stored, pieces_rejected: Since the start; a rejected piece is stored too.
        frames_rejected: Frames of the rejected pieces.
        rejected_in_a_row, decoded, last_rejection: Rejected pieces since one was decoded, whether any was since the
            start, and why the last one was rejected.
        last_frame_s, last_receipt_s: Seconds since the Unix epoch, of our clock; None before the first.
        silent_since_s: When the last frame came, on a bus that has been silent for long; None on one that speaks.
    """

    bus_fault: str | None = "not opened yet"
    spool_fault: str | None = None
    raw_fault: str | None = None
    database_fault: str | None = "not asked yet"
    frames_received: int = 0
    frames_unreadable: int = 0
    frames_spooled: int = 0
    frames_lost_by_bus: int = 0
    frames_dropped: int = 0
    buffered_bytes: int = 0
    spool_bytes: int = 0
    spool_limit_bytes: int = 0
    pieces_waiting: int = 0
    pieces_aside: int = 0
    pieces_stored: int = 0
    pieces_rejected: int = 0
    frames_rejected: int = 0
    rejected_in_a_row: int = 0
    decoded: bool = False
    last_rejection: str = ""
    last_frame_s: float | None = None
    last_receipt_s: float | None = None
    silent_since_s: float | None = None
    threads: list[threading.Thread] = field(default_factory=list)

    @property
    def alive(self) -> bool:
        """Whether every thread runs."""
        return bool(self.threads) and all(thread.is_alive() for thread in self.threads)

    @property
    def faults(self) -> dict[str, str]:
        """What keeps frames from their receipts and windows, by where it is."""
        found = {
            "bus": self.bus_fault,
            "spool": self.spool_fault,
            "raw": self.raw_fault,
            "database": self.database_fault,
            "recordings": self._recordings_fault,
        }
        return {where: fault for where, fault in found.items() if fault is not None}

    @property
    def _recordings_fault(self) -> str | None:
        if self.rejected_in_a_row < (REJECTED_IN_A_ROW if self.decoded else 1):
            return None
        return f"every recording is rejected, the last {self.rejected_in_a_row}: {self.last_rejection}"


class Say(Protocol):
    """Takes one sentence for people; ``bad`` when something is wrong."""

    def __call__(self, text: str, *, bad: bool = False) -> None:
        """Say it."""


@dataclass(frozen=True, slots=True)
class Reports:
    """Where a receiver reports to, from any of its threads.

    Attributes:
        say: Sentences for people, as things happen.
        received: Every piece with its receipt, or why it was rejected.
    """

    say: Say
    received: Callable[[str, ChunkReceipt | Exception], None]
