"""SIGTERM and SIGINT as an event that services wait for."""

from __future__ import annotations

import signal
from queue import SimpleQueue
from threading import Event, Thread


def stop_on_signals(stop_event: Event) -> None:
    """Set ``stop_event`` on SIGTERM and SIGINT; for the main thread of a service.

    The handler only leaves a note, in a queue that may be entered twice by one thread: it may run while the main thread
    holds the lock of ``stop_event``, where to set it would wait for ever.

    Args:
        stop_event: Set soon after the signal, by a thread of its own.
    """
    notes: SimpleQueue[int] = SimpleQueue()

    def stop() -> None:
        notes.get()
        stop_event.set()

    Thread(target=stop, name="stopping", daemon=True).start()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _frame: notes.put(number))
