"""A live bus received until a stop is requested: what happens is said at once, a summary comes at the end."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from prometheus_client.core import Metric
from rich.console import Console

from api import logs
from api.factory import SystemClock, open_store
from api.logs import start_tracing
from api.measures import counter, gauge, reference_measures
from api.pipeline import MEGABYTE, publisher
from api.pipeline import receiver as receiver_of
from api.settings import Settings, load_settings
from api.terminal.health_server import Answer, HealthAddress, json_answer, served
from api.terminal.ingest import Outcome, load_and_say, print_outcomes
from api.terminal.stopping import stop_on_signals
from fleet_db.migrate import check_head
from fleet_db.storage import SqlStorage
from ingest.live.listening import BusSource, open_bus
from ingest.live.receiver import LiveSettings, ReceivedBus, receive_buses
from ingest.live.status import LiveStatus, Reports, Say
from ingest.live.storing import Stores
from ingest.receipts import to_nobody
from ingest.receiver import ChunkReceipt, Receiver

REMEMBERED = 1000  # recordings that the summary at the end covers

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
    """Receive live buses until SIGTERM or SIGINT, and print a summary; exit 1 where a recording was rejected."""
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
            more = [] if references is None else [lambda: reference_measures(references)]
            port = stack.enter_context(serving_health(health, statuses, more))
            say(f"health and metrics at http://{health.host}:{port}")
        receive_buses(
            [
                _received_bus(
                    settings,
                    bus,
                    Stores(stores.connect, stores.check),
                    statuses[bus.vehicle],
                    Reports(say if len(buses) == 1 else partial(_say_of, say, bus.vehicle), received),
                )
                for bus in buses
            ],
            stop,
        )
    print_outcomes(list(outcomes), console)


def _say_of(say: Say, vehicle: str, text: str, *, bad: bool = False) -> None:
    say(f"{vehicle}: {text}", bad=bad)


class _Stores:
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
            return receiver_of(self._settings, self._storage, SystemClock(), self._catalogues, announce=announce)

    def check(self) -> None:
        if self._storage is not None:
            check_head(self._storage.engine)

    def close(self) -> None:
        if self._storage is not None:
            self._storage.close()


def _received_bus(
    settings: Settings, bus: LiveBus, stores: Stores, status: LiveStatus, reports: Reports
) -> ReceivedBus:
    live = LiveSettings(
        vehicle=bus.vehicle,
        spool_dir=settings.spool_dir,
        spool_bytes=settings.spool_mb * MEGABYTE,
        memory_bytes=settings.spool_memory_mb * MEGABYTE,
        piece_seconds=bus.chunk_seconds,
        shutdown_s=settings.shutdown_timeout_s,
    )
    name = f"{bus.interface} {bus.channel} for {bus.vehicle}"
    source = BusSource(name, partial(open_bus, bus.interface, bus.channel))
    return ReceivedBus(live, source, stores, status, reports)


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


PREFIX = "treadwatch_live_"

COUNTERS: Mapping[str, str] = {
    "frames_received": "Frames taken off the bus.",
    "frames_unreadable": "Frames left out because they are none of a classic CAN bus.",
    "frames_spooled": "Frames that reached the disk.",
    "frames_lost_by_bus": "Frames dropped before they came to this process, since its start.",
    "frames_dropped": "Frames of this vehicle that were dropped, also before this start.",
    "frames_rejected": "Frames of pieces that were rejected, so that no window is made of them.",
    "pieces_stored": "Pieces that have their receipt.",
    "pieces_rejected": "Pieces that were stored and rejected.",
}
GAUGES: Mapping[str, str] = {
    "buffered_bytes": "Frames in memory that are not on the disk yet.",
    "spool_bytes": "Frames on the disk without a receipt.",
    "spool_limit_bytes": "How much the spool may hold.",
    "pieces_waiting": "Pieces without a receipt.",
    "rejected_in_a_row": "Pieces rejected since one was decoded.",
    "pieces_aside": "Pieces that could not be stored whatever was tried.",
}
TIMES: Mapping[str, str] = {
    "last_frame": "When the last frame came; 0 before the first.",
    "last_receipt": "When the last receipt was committed; 0 before the first.",
    "silent_since": "When the last frame came on a bus that is silent; 0 on one that speaks.",
}


@contextmanager
def serving_health(
    address: HealthAddress, statuses: Mapping[str, LiveStatus], more: Sequence[Callable[[], Iterable[Metric]]] = ()
) -> Iterator[int]:
    """Serve health and measures of receivers, by the vehicle, and ``more`` measures; yield the port."""
    read = partial(live_measures, statuses)
    with served(address, partial(_health, statuses), partial(_readiness, statuses), [read, *more]) as port:
        yield port


def _health(statuses: Mapping[str, LiveStatus]) -> Answer:
    alive = all(status.alive for status in statuses.values())
    threads = {
        vehicle: {thread.name: thread.is_alive() for thread in status.threads} for vehicle, status in statuses.items()
    }
    return json_answer(alive, {"threads": threads})


def _readiness(statuses: Mapping[str, LiveStatus]) -> Answer:
    """Whether frames reach their receipts and can be used; a silent bus is no fault, a vehicle may be switched off."""
    faults = {vehicle: status.faults for vehicle, status in statuses.items()}
    alive = all(status.alive for status in statuses.values())
    since_s = {vehicle: status.silent_since_s for vehicle, status in statuses.items()}
    silent_s = {v: None if s is None else round(max(0.0, time.time() - s), 1) for v, s in since_s.items()}
    bad = {vehicle: fault for vehicle, fault in faults.items() if fault}
    return json_answer(alive and not bad, {"faults": bad, "silent_for_s": silent_s})


def live_measures(statuses: Mapping[str, LiveStatus]) -> Iterator[Metric]:
    """Yield the measures of receivers, by the vehicle."""

    def of_all(name: str) -> dict[str, float]:
        return {vehicle: getattr(status, name) or 0.0 for vehicle, status in statuses.items()}

    for name, text in COUNTERS.items():
        yield counter(f"{PREFIX}{name}", text, "vehicle", of_all(name))
    for name, text in GAUGES.items():
        yield gauge(f"{PREFIX}{name}", text, "vehicle", of_all(name))
    for name, text in TIMES.items():
        yield gauge(f"{PREFIX}{name}_timestamp_seconds", text, "vehicle", of_all(f"{name}_s"))
    up = {
        (vehicle, what): 0.0 if what in status.faults else 1.0
        for vehicle, status in statuses.items()
        for what in ("bus", "spool", "raw", "database", "recordings")
    }
    yield gauge(f"{PREFIX}up", "Whether it works.", "vehicle what", up)
