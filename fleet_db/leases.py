"""A lease for as long as a block lasts: a thread prolongs it, and stands still when the process does."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from estimation.errors import StorageError

PROLONGED_A_LEASE = 4
"""How often a lease is prolonged during its length."""


@dataclass(frozen=True, slots=True)
class Lease:
    """The lease under which a process stores results."""

    number: int
    holder: str
    length_s: float


_log = logging.getLogger(__name__)


@contextmanager
def prolonged(prolong: Callable[[], bool], length_s: float) -> Iterator[None]:
    """Prolong a lease until the block ends.

    Args:
        prolong: Prolongs it, in a transaction of its own; returns whether it was still there.
        length_s: Of the lease, s.
    """
    over = threading.Event()
    thread = threading.Thread(target=_prolong, args=(prolong, length_s, over), name="lease", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _prolong(prolong: Callable[[], bool], length_s: float, over: threading.Event) -> None:
    while not over.wait(length_s / PROLONGED_A_LEASE):
        try:
            if not prolong():
                return  # what is committed next finds that out
        except StorageError as error:
            _log.warning("a lease could not be prolonged: %s", error)
