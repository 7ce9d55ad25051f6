"""Measures of references to received chunks, as this process publishes them."""

from __future__ import annotations

from prometheus_client.core import GaugeMetricFamily, Metric

from api.measures import counter
from ingest.topic.publishing import Publisher, Sent


def reference_measures(publisher: Publisher | None) -> list[Metric]:
    """Return the measures of a publisher; None where no topic is set."""
    ended = {outcome.value: 0 if publisher is None else publisher.ended[outcome] for outcome in Sent}
    waiting, text = 0 if publisher is None else publisher.waiting, "References that wait for a broker."
    return [
        counter("treadwatch_references", "References to received chunks by how they ended.", "outcome", ended),
        GaugeMetricFamily("treadwatch_references_waiting", text, value=waiting),
    ]
