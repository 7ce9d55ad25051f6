"""Measures for Prometheus: of the requests as they happen, of the fleet's data when they are asked for."""

from __future__ import annotations

import logging
from collections import Counter as Tally
from collections.abc import Iterable, Mapping

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from estimation.errors import TreadwatchError
from estimation.jobs.job import Job
from estimation.values.alerts import AlertScope
from estimation.values.windows import WindowState
from fleet_db.storage import SqlStorage

_log = logging.getLogger(__name__)


class RequestMeasures:
    """Counts and durations of requests, in a registry of this app alone."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._requests = Counter(
            "treadwatch_http_requests", "Requests answered.", ["method", "route", "status"], registry=registry
        )
        self._durations = Histogram(
            "treadwatch_http_request_duration_seconds", "Time to answer.", ["method", "route"], registry=registry
        )

    def observe(self, method: str, route: str, status: int, took_s: float) -> None:
        """Count one request."""
        self._requests.labels(method, route, str(status)).inc()
        self._durations.labels(method, route).observe(took_s)


class StoredMeasures(Collector):
    """Measures read from the database when they are scraped; only ``treadwatch_database_up`` while it is down."""

    def __init__(self, storage: SqlStorage, jobs: Mapping[str, Job]) -> None:
        self._storage = storage
        self._jobs = jobs

    def describe(self) -> Iterable[Metric]:
        """Return nothing, so that registering does not ask the database."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return the measures of now."""
        up = GaugeMetricFamily("treadwatch_database_up", "Whether the database answers.")
        measures: list[Metric] = []
        try:
            measures = [self._windows(), self._alerts(), *self._runs()]
        except TreadwatchError as error:
            _log.warning("the database does not answer: %s", error)
        up.add_metric([], 1.0 if measures else 0.0)
        return [up, *measures]

    def _windows(self) -> Metric:
        family = GaugeMetricFamily("treadwatch_windows", "Windows by state.", labels=["state"])
        with self._storage.read() as unit:
            counts = unit.windows.counts()
        for state in WindowState:
            family.add_metric([state.value], counts.get(state.value, 0))
        return family

    def _alerts(self) -> Metric:
        labels = ["fleet", "kind", "severity"]
        family = GaugeMetricFamily("treadwatch_alerts_open", "Open alerts.", labels=labels)
        with self._storage.read() as unit:
            of_wheelsets = [alert for alert in unit.alerts.all_open() if alert.scope is AlertScope.WHEELSET]
            found = Tally((alert.fleet, alert.kind, alert.severity.value) for alert in of_wheelsets)
        for key, count in sorted(found.items()):
            family.add_metric(list(key), count)
        return family

    def _runs(self) -> list[Metric]:
        started = GaugeMetricFamily(
            "treadwatch_job_last_start_timestamp_seconds", "Start of the last run.", labels=["job", "outcome"]
        )
        took = GaugeMetricFamily("treadwatch_job_last_duration_seconds", "Duration of the last run.", labels=["job"])
        with self._storage.read() as unit:
            last = [run for name in self._jobs for run in unit.jobs.page(name, None, 1)]
        for run in last:
            started.add_metric([run.job, run.outcome], run.started_ns / 1e9)
            if run.finished_ns is not None:
                took.add_metric([run.job], (run.finished_ns - run.started_ns) / 1e9)
        return [started, took]
