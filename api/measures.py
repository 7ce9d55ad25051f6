"""Measures for Prometheus, as values: a family from its numbers, and what is read when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ingest.topic.references import Publisher, Sent

Numbers = Mapping[str, float] | Mapping[tuple[str, str], float] | Mapping[tuple[str, str, str], float]


class Measured(Collector):
    """Measures that a function reads when they are asked for."""

    def __init__(self, read: Callable[[], Iterable[Metric]]) -> None:
        self._read = read

    def describe(self) -> Iterable[Metric]:
        """Return nothing: nothing is to be read before it is asked for."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return the measures of now."""
        return self._read()


def gauge(name: str, text: str, labels: str, numbers: Numbers) -> Metric:
    """Return a gauge."""
    return _filled(GaugeMetricFamily(name, text, labels=labels.split()), numbers)


def counter(name: str, text: str, labels: str, numbers: Numbers) -> Metric:
    """Return a counter, as :func:`gauge` does."""
    return _filled(CounterMetricFamily(name, text, labels=labels.split()), numbers)


def _filled(family: GaugeMetricFamily | CounterMetricFamily, numbers: Numbers) -> Metric:
    for key, number in numbers.items():
        family.add_metric([key] if isinstance(key, str) else list(key), number)
    return family


def reference_measures(publisher: Publisher | None) -> list[Metric]:
    """Return the measures of a publisher; None where no topic is set."""
    ended = {outcome.value: 0 if publisher is None else publisher.ended[outcome] for outcome in Sent}
    waiting, text = 0 if publisher is None else publisher.waiting, "References that wait for a broker."
    return [
        counter("treadwatch_references", "References to received chunks by how they ended.", "outcome", ended),
        GaugeMetricFamily("treadwatch_references_waiting", text, value=waiting),
    ]
