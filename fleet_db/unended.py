"""Leases of a process whose end could not be stored, as the database was out of reach: they end with its next lease."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class UnendedLease:
    """A lease that nobody works under any more.

    Attributes:
        number: Of the lease.
        stage: Of the work.
        begun_ns: When work on each key was begun under it, ns by the clock of the claims.
    """

    number: int
    stage: str
    begun_ns: Mapping[str, int]


@dataclass(slots=True)
class UnendedLeases:
    """Those of one process; its threads may add and end them."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _left: list[UnendedLease] = field(default_factory=list)

    def add(self, lease: UnendedLease) -> None:
        """Keep a lease that could not be ended."""
        with self._lock:
            self._left.append(lease)

    def left(self) -> Sequence[UnendedLease]:
        """Return those that are to be ended."""
        with self._lock:
            return tuple(self._left)

    def ended(self, leases: Sequence[UnendedLease]) -> None:
        """Forget those that have been ended."""
        with self._lock:
            self._left = [one for one in self._left if one not in leases]
