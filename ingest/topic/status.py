"""What a consumer is doing, for its health endpoint."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, field

from ingest.topic.reference import Outcome


@dataclass(slots=True)
class ConsumerStatus:
    """What a consumer knows; written by its thread, and read by any.

    Attributes:
        broker_fault, raw_fault, database_fault: What is wrong with the brokers or the topic, the raw store and the
            database; None while they work.
        behind: Which limit keeps new receipts out; None where none does.
        outcomes: Messages by what became of them, since the start.
        decoded, not_decoded: Chunks that were decoded, and that could not be, since the start.
        partitions: How many are this consumer's.
        behind_by: Messages of these partitions that are not taken yet, as far as the brokers have said.
        last_message_s: When the last message was taken, seconds since the Unix epoch; None before the first.
        last_age_s: How old its reference was then, s.
    """

    broker_fault: str | None = "not asked yet"
    raw_fault: str | None = None
    database_fault: str | None = "not asked yet"
    behind: str | None = None
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    decoded: int = 0
    not_decoded: int = 0
    partitions: int = 0
    behind_by: int = 0
    last_message_s: float | None = None
    last_age_s: float = 0.0
    thread: threading.Thread | None = None

    @property
    def alive(self) -> bool:
        """Whether its thread runs."""
        return self.thread is not None and self.thread.is_alive()

    @property
    def faults(self) -> dict[str, str]:
        """What keeps references from their receipts, by where it is."""
        found = {"broker": self.broker_fault, "raw": self.raw_fault, "database": self.database_fault}
        return {where: fault for where, fault in found.items() if fault is not None}
