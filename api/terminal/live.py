"""A live bus received until a stop is requested: what happens is said at once, a summary comes at the end."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from api import factory, logs
from api.factory import SystemClock, open_store
from api.measures import Measured, reference_measures
from api.settings import Settings, load_settings
from api.terminal.health_server import HealthAddress
from api.terminal.ingest import Outcome, load_and_say, print_outcomes
from api.terminal.live_health import serving_health
from api.topic import publisher
from api.tracing import start_tracing
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.migrate import check_head
from fleet_db.storage import SqlStorage
from ingest.bus import open_bus
from ingest.live.listening import BusSource
from ingest.live.receiver import LiveSettings, ReceivedBus, receive_buses
from ingest.live.status import LiveStatus, Reports, Say
from ingest.live.storing import Stores
from ingest.receipts import to_nobody
from ingest.receiver import ChunkReceipt, Receiver

REMEMBERED = 1000
"""Recordings that the summary at the end covers."""

MEGABYTE = 1_000_000

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LiveBus:
    """A bus to listen to: interface and channel of python-can, its vehicle, and the length of a recording, s."""

    interface: str
    channel: str
    vehicle: str
    chunk_seconds: float


def receive_and_report(
    buses: Sequence[LiveBus], registry: Path | None, catalogues: Sequence[Path], health: HealthAddress | None
) -> None:
    """Receive live buses until SIGTERM or SIGINT, and print a summary.

    Raises:
        typer.Exit: Code 1: a recording was rejected.
    """
    settings = load_settings()
    console = Console(stderr=True)
    say = _say(settings, console)
    statuses, stop = {bus.vehicle: LiveStatus() for bus in buses}, threading.Event()
    outcomes: deque[Outcome] = deque(maxlen=REMEMBERED)

    def received(name: str, outcome: ChunkReceipt | Exception) -> None:
        outcomes.append((Path(name), outcome))

    stop_on_signals(stop)
    with ExitStack() as stack:
        stores = _Stores(settings, catalogues, registry, console)
        stack.callback(stores.close)
        references = stores.references
        if references is not None:
            stack.callback(references.close)
        if health is not None:
            more = [] if references is None else [Measured(lambda: reference_measures(references))]
            port = stack.enter_context(serving_health(health.host, health.port, statuses, more))
            say(f"health and metrics at http://{health.host}:{port}")
        receive_buses(
            [
                ReceivedBus(
                    _live_settings(settings, bus),
                    _source(bus),
                    Stores(stores.connect, stores.check),
                    statuses[bus.vehicle],
                    Reports(say if len(buses) == 1 else _of_vehicle(say, bus.vehicle), received),
                )
                for bus in buses
            ],
            stop,
        )
    print_outcomes(list(outcomes), console)


class _Stores:
    """Database and raw store, opened when they are there."""

    def __init__(self, settings: Settings, catalogues: Sequence[Path], registry: Path | None, console: Console) -> None:
        self._settings = settings
        self._catalogues = catalogues
        self._registry = registry
        self._console = console
        self._storage: SqlStorage | None = None
        self._opening = threading.Lock()  # each bus has a thread that asks
        self.references = publisher(settings, lambda: self._storage)

    def connect(self) -> Receiver:
        with self._opening:
            if self._storage is None:
                self._storage = open_store(self._settings)
            if self._registry is not None:
                load_and_say(self._registry, self._storage, self._console)
                self._registry = None
            announce = to_nobody if self.references is None else self.references.publish
            return factory.receiver(self._settings, self._storage, SystemClock(), self._catalogues, announce=announce)

    def check(self) -> None:
        if self._storage is not None:
            check_head(self._storage.engine)

    def close(self) -> None:
        if self._storage is not None:
            self._storage.close()


def _source(bus: LiveBus) -> BusSource:
    name = f"{bus.interface} {bus.channel} for {bus.vehicle}"
    return BusSource(name, partial(open_bus, bus.interface, bus.channel))


def _of_vehicle(say: Say, vehicle: str) -> Say:
    """Return what says which vehicle a sentence is about."""

    def say_of_vehicle(text: str, *, bad: bool = False) -> None:
        say(f"{vehicle}: {text}", bad=bad)

    return say_of_vehicle


def _live_settings(settings: Settings, bus: LiveBus) -> LiveSettings:
    return LiveSettings(
        vehicle=bus.vehicle,
        spool_dir=settings.spool_dir,
        spool_bytes=settings.spool_mb * MEGABYTE,
        memory_bytes=settings.spool_memory_mb * MEGABYTE,
        piece_seconds=bus.chunk_seconds,
        shutdown_s=settings.shutdown_timeout_s,
    )


def _say(settings: Settings, console: Console) -> Say:
    """Return what says things for people: on the terminal, bad ones in red, or as lines of the log."""
    logs.configure(settings)
    start_tracing()
    if settings.log_format == "json":

        def log(text: str, *, bad: bool = False) -> None:
            _log.log(logging.WARNING if bad else logging.INFO, "%s", text)

        return log

    def say(text: str, *, bad: bool = False) -> None:
        with suppress(OSError, ValueError):  # a terminal that is gone does not end the receiver
            console.print(text, style="red" if bad else None, markup=False, highlight=False, soft_wrap=True)

    return say
