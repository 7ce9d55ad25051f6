"""Health and metrics of a consumer of the topic."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from api.measures import Measured, counter, gauge
from api.terminal.health_server import Answer, Health, HealthAddress, json_answer, served
from ingest.topic.reference import ConsumerStatus, Outcome

PREFIX = "treadwatch_consumer_"


@contextmanager
def serving_consumer_health(address: HealthAddress, status: ConsumerStatus) -> Iterator[int]:
    """Serve ``/healthz``, ``/readyz`` and ``/metrics`` of a consumer; yield the port.

    Raises:
        ParameterError: Nobody can listen there.
    """
    health = Health(partial(_health, status), partial(_readiness, status), registered(status))
    with served(address.host, address.port, health) as port:
        yield port


def registered(status: ConsumerStatus) -> CollectorRegistry:
    """Return the measures of a consumer."""
    registry = CollectorRegistry()
    registry.register(Measured(partial(_measures, status)))
    return registry


def _health(status: ConsumerStatus) -> Answer:
    """Whether its thread runs."""
    return json_answer(status.alive, {"thread": status.alive})


def _readiness(status: ConsumerStatus) -> Answer:
    """Whether references reach their receipts; one that waits because too much is not decoded yet is no fault."""
    facts = {"faults": status.faults, "behind": status.behind, "partitions": status.partitions}
    return json_answer(status.alive and not status.faults, facts)


def _measures(status: ConsumerStatus) -> list[Metric]:
    outcomes = {outcome.value: status.outcomes[outcome] for outcome in Outcome}
    gauges = {
        "partitions": ("Partitions that are this consumer's.", status.partitions),
        "messages_waiting": ("Messages of these partitions that are not taken yet.", status.behind_by),
        "last_message_timestamp_seconds": (
            "When the last message was taken; 0 before the first.",
            status.last_message_s or 0.0,
        ),
        "last_reference_age_seconds": ("How old the last reference was when it was taken.", status.last_age_s),
    }
    faults = {**status.faults, **({} if status.behind is None else {"backlog": status.behind})}
    up = {what: 0.0 if what in faults else 1.0 for what in ("broker", "raw", "database", "backlog")}
    failed = "Chunks that could not be decoded."
    return [
        counter(f"{PREFIX}messages", "Messages of the topic by what became of them.", "outcome", outcomes),
        CounterMetricFamily(f"{PREFIX}chunks_decoded", "Chunks that were decoded.", value=status.decoded),
        CounterMetricFamily(f"{PREFIX}chunks_not_decoded", failed, value=status.not_decoded),
        *(GaugeMetricFamily(f"{PREFIX}{name}", text, value=value) for name, (text, value) in gauges.items()),
        gauge(f"{PREFIX}up", "Whether it works.", "what", up),
    ]
