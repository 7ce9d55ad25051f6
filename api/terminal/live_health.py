"""Health and metrics of a live receiver, on a port of its own: plain HTTP for a probe and for Prometheus."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import MappingProxyType

from prometheus_client import CollectorRegistry
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from api.measures import Measured, counter, gauge
from api.terminal.health_server import Answer, Health, json_answer, served
from ingest.live.status import LiveStatus

PREFIX = "treadwatch_live_"

COUNTERS: Mapping[str, str] = MappingProxyType(
    {
        "frames_received": "Frames taken off the bus.",
        "frames_unreadable": "Frames left out because they are none of a classic CAN bus.",
        "frames_spooled": "Frames that reached the disk.",
        "frames_lost_by_bus": "Frames dropped before they came to this process, since its start.",
        "frames_dropped": "Frames of this vehicle that were dropped, also before this start.",
        "frames_rejected": "Frames of pieces that were rejected, so that no window is made of them.",
        "pieces_stored": "Pieces that have their receipt.",
        "pieces_rejected": "Pieces that were stored and rejected.",
    }
)
GAUGES: Mapping[str, str] = MappingProxyType(
    {
        "buffered_bytes": "Frames in memory that are not on the disk yet.",
        "spool_bytes": "Frames on the disk without a receipt.",
        "spool_limit_bytes": "How much the spool may hold.",
        "pieces_waiting": "Pieces without a receipt.",
        "rejected_in_a_row": "Pieces rejected since one was decoded.",
        "pieces_aside": "Pieces that could not be stored whatever was tried.",
    }
)
TIMES: Mapping[str, str] = MappingProxyType(
    {
        "last_frame": "When the last frame came; 0 before the first.",
        "last_receipt": "When the last receipt was committed; 0 before the first.",
        "silent_since": "When the last frame came on a bus that is silent; 0 on one that speaks.",
    }
)


@contextmanager
def serving_health(
    host: str, port: int, statuses: Mapping[str, LiveStatus], more: Sequence[Collector] = ()
) -> Iterator[int]:
    """Serve ``/healthz``, ``/readyz`` and ``/metrics`` from threads of their own; yield the port.

    Args:
        host, port: Where; port 0 takes a free one.
        statuses: What is served, by the vehicle.
        more: Measures beside those of the vehicles.

    Raises:
        ParameterError: Nobody can listen there.
    """
    registry = registered(statuses)
    for collector in more:
        registry.register(collector)
    with served(host, port, Health(partial(_health, statuses), partial(_readiness, statuses), registry)) as taken:
        yield taken


def registered(statuses: Mapping[str, LiveStatus]) -> CollectorRegistry:
    """Return the measures of a receiver.

    Args:
        statuses: What is measured, by the vehicle.
    """
    registry = CollectorRegistry()
    registry.register(Measured(partial(_measures, statuses)))
    return registry


def _health(statuses: Mapping[str, LiveStatus]) -> Answer:
    """Whether every thread runs."""
    alive = all(status.alive for status in statuses.values())
    threads = {
        vehicle: {thread.name: thread.is_alive() for thread in status.threads} for vehicle, status in statuses.items()
    }
    return json_answer(alive, {"threads": threads})


def _readiness(statuses: Mapping[str, LiveStatus]) -> Answer:
    """Whether frames reach their receipts and can be used; a silent bus is no fault, a vehicle may be switched off."""
    faults = {vehicle: status.faults for vehicle, status in statuses.items()}
    alive = all(status.alive for status in statuses.values())
    silent_s = {vehicle: _silent_s(status) for vehicle, status in statuses.items()}
    bad = {vehicle: found for vehicle, found in faults.items() if found}
    return json_answer(alive and not bad, {"faults": bad, "silent_for_s": silent_s})


def _silent_s(status: LiveStatus) -> float | None:
    since_s = status.silent_since_s
    return None if since_s is None else round(max(0.0, time.time() - since_s), 1)


def _measures(statuses: Mapping[str, LiveStatus]) -> Iterator[Metric]:
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
