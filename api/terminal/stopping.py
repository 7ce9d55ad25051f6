"""A process ends when it is asked to."""

from __future__ import annotations

import os
import signal
from threading import Event, Thread

STOPPING = (signal.SIGTERM, signal.SIGINT)


def stop_on_signals(stop_event: Event) -> None:
    """Set ``stop_event`` on SIGTERM and SIGINT; for the main thread of a service.

    Python runs a handler in the main thread, and not before this goes on: a signal that comes just before it waits, or
    to another thread, would be seen when the wait is over. So a thread of its own reads what C writes at once.

    A child that is forked shares the pipe, and has no thread that reads: a signal to it ends it alone.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def stop() -> None:
        while os.read(reading, 1)[0] not in STOPPING:
            continue
        stop_event.set()

    Thread(target=stop, name="stopping", daemon=True).start()
    for number in STOPPING:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    os.register_at_fork(after_in_child=_end_on_signals)


def _end_on_signals() -> None:
    signal.set_wakeup_fd(-1)
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
