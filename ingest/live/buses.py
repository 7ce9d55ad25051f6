"""Several buses in one process: each has its threads, its spool and its counts; they share nothing but the stores."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

from ingest.live.listening import BusSource
from ingest.live.receiver import LiveSettings, receive_live
from ingest.live.status import LiveStatus, Reports
from ingest.live.storing import Stores


@dataclass(frozen=True, slots=True)
class ReceivedBus:
    """A bus with all that receiving it takes; the attributes are the parameters of :func:`receive_live`."""

    settings: LiveSettings
    source: BusSource
    stores: Stores
    status: LiveStatus
    reports: Reports


def receive_buses(buses: Sequence[ReceivedBus], stop: threading.Event) -> None:
    """Receive buses until ``stop`` is set, or one of them is refused for good, which ends all of them.

    Raises:
        ConflictError: Another process receives one of the vehicles.
        StorageError: The folder of a spool cannot be used.
        TreadwatchError: A bus or the stores refused for good. What the other buses had received is stored, or in their
            spools.
    """
    failures: list[Exception] = []

    def receive(bus: ReceivedBus) -> None:
        try:
            receive_live(bus.settings, bus.source, bus.stores, bus.status, bus.reports, stop)
        except Exception as error:  # noqa: BLE001 - whatever it is, the others end in order, then it is raised
            failures.append(error)
            stop.set()

    threads = [
        threading.Thread(target=receive, args=(bus,), name=f"receiver of {bus.settings.vehicle}") for bus in buses
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]
