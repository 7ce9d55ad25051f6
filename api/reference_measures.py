"""Measures of references to received chunks, as this process publishes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ingest.topic.publishing import Publisher, Sent


class ReferenceMeasures(Collector):
    """Measures of a publisher.

    Args:
        publisher: Returns it; None where no topic is set.
    """

    def __init__(self, publisher: Callable[[], Publisher | None]) -> None:
        self._publisher = publisher

    def collect(self) -> Iterable[Metric]:
        """Return the measures of now."""
        publisher = self._publisher()
        ended = CounterMetricFamily(
            "treadwatch_references", "References to received chunks by how they ended.", labels=["outcome"]
        )
        waiting = GaugeMetricFamily("treadwatch_references_waiting", "References that wait for a broker.")
        for outcome in Sent:
            ended.add_metric([outcome.value], 0 if publisher is None else publisher.ended[outcome])
        waiting.add_metric([], 0 if publisher is None else publisher.waiting)
        return [ended, waiting]
