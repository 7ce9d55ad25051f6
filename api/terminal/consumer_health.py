"""Health and metrics of a consumer of the topic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from api.terminal.health_server import Answer, Health, HealthAddress, json_answer, served
from ingest.topic.reference import Outcome
from ingest.topic.status import ConsumerStatus

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
    registry.register(_Measures(status))
    return registry


def _health(status: ConsumerStatus) -> Answer:
    """Whether its thread runs."""
    return json_answer(status.alive, {"thread": status.alive})


def _readiness(status: ConsumerStatus) -> Answer:
    """Whether references reach their receipts; one that waits because too much is not decoded yet is no fault."""
    facts = {"faults": status.faults, "behind": status.behind, "partitions": status.partitions}
    return json_answer(status.alive and not status.faults, facts)


class _Measures(Collector):
    def __init__(self, status: ConsumerStatus) -> None:
        self._status = status

    def collect(self) -> Iterable[Metric]:
        status = self._status
        messages = CounterMetricFamily(
            f"{PREFIX}messages", "Messages of the topic by what became of them.", labels=["outcome"]
        )
        for outcome in Outcome:
            messages.add_metric([outcome.value], status.outcomes[outcome])
        yield messages
        yield CounterMetricFamily(f"{PREFIX}chunks_decoded", "Chunks that were decoded.", value=status.decoded)
        yield CounterMetricFamily(
            f"{PREFIX}chunks_not_decoded", "Chunks that could not be decoded.", value=status.not_decoded
        )
        gauges = {
            "partitions": ("Partitions that are this consumer's.", status.partitions),
            "messages_waiting": ("Messages of these partitions that are not taken yet.", status.behind_by),
            "last_message_timestamp_seconds": (
                "When the last message was taken; 0 before the first.",
                status.last_message_s or 0.0,
            ),
            "last_reference_age_seconds": ("How old the last reference was when it was taken.", status.last_age_s),
        }
        for name, (text, value) in gauges.items():
            yield GaugeMetricFamily(f"{PREFIX}{name}", text, value=value)
        up = GaugeMetricFamily(f"{PREFIX}up", "Whether it works.", labels=["what"])
        faults = {**status.faults, **({} if status.behind is None else {"backlog": status.behind})}
        for what in ("broker", "raw", "database", "backlog"):
            up.add_metric([what], 0.0 if what in faults else 1.0)
        yield up
