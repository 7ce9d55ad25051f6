"""What a live receiver is doing, for its health endpoint and its messages, and how long it waits between attempts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # who waits for something else than recordings does not import what receives them
    from ingest.receiver import ChunkReceipt

REJECTED_IN_A_ROW = 3
"""Recordings that are rejected behind one that was decoded before the receiver is not ready; else the first one is."""


@dataclass(slots=True)
class LiveStatus:
    """What the threads of a receiver know; each field is written by one thread, and read by any.

    Counts of frames and pieces are since the start, but for the dropped frames; faults are None while all works. Times
    are seconds since the Unix epoch, of our clock; None before the first.
    """

    bus_fault: str | None = "not opened yet"
    spool_fault: str | None = None
    raw_fault: str | None = None
    database_fault: str | None = "not asked yet"
    frames_received: int = 0
    frames_unreadable: int = 0  # no classic CAN frames
    frames_spooled: int = 0  # on the disk
    frames_lost_by_bus: int = 0  # before they came to this process: its socket was full; among the dropped ones
    frames_dropped: int = 0  # of this vehicle, also before the start
    buffered_bytes: int = 0  # without a receipt, in memory
    spool_bytes: int = 0  # on the disk
    spool_limit_bytes: int = 0
    pieces_waiting: int = 0
    pieces_aside: int = 0
    pieces_stored: int = 0
    pieces_rejected: int = 0  # they are stored too
    frames_rejected: int = 0
    rejected_in_a_row: int = 0
    decoded: bool = False  # whether any piece was
    last_rejection: str = ""
    last_frame_s: float | None = None
    last_receipt_s: float | None = None
    silent_since_s: float | None = None  # None where the bus has not been silent for long
    threads: list[threading.Thread] = field(default_factory=list)

    @property
    def alive(self) -> bool:
        """Whether every thread runs."""
        return bool(self.threads) and all(thread.is_alive() for thread in self.threads)

    @property
    def faults(self) -> dict[str, str]:
        """What keeps frames from their receipts and windows, by where it is."""
        faults = {
            "bus": self.bus_fault,
            "spool": self.spool_fault,
            "raw": self.raw_fault,
            "database": self.database_fault,
        }
        if self.rejected_in_a_row >= (REJECTED_IN_A_ROW if self.decoded else 1):
            faults["recordings"] = (
                f"every recording is rejected, the last {self.rejected_in_a_row}: {self.last_rejection}"
            )
        return {where: fault for where, fault in faults.items() if fault is not None}


class Say(Protocol):
    """Takes one sentence for people; ``bad`` when something is wrong."""

    def __call__(self, text: str, *, bad: bool = False) -> None:
        """Say it."""


@dataclass(frozen=True, slots=True)
class Reports:
    """Where a receiver reports to, from any of its threads."""

    say: Say  # sentences for people, as things happen
    received: Callable[[str, ChunkReceipt | Exception], None]  # every piece with its receipt, or why it was rejected


class Backoff:
    """Delays that double from attempt to attempt, until one succeeds."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s = first_s
        self._longest_s = longest_s
        self._next_s = first_s

    def failed(self) -> float:
        """Return how long to wait after an attempt that failed, s."""
        delay_s = self._next_s
        self._next_s = min(2.0 * delay_s, self._longest_s)
        return delay_s

    def succeeded(self) -> None:
        """Begin with the first delay again."""
        self._next_s = self._first_s
