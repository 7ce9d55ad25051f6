"""Measures for Prometheus: of the requests as they happen, of the fleet's data when they are asked for."""

from __future__ import annotations

import logging
from collections import Counter as Tally
from collections.abc import Callable, Iterable

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from api.services import Services
from api.webhooks.measures import webhook_measures
from estimation.errors import TreadwatchError
from estimation.values.alerts import AlertScope
from estimation.values.runs import TRIED_AGAIN, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.receipts import ChunkState
from fleet_db.stores.backlog import Backlog, backlog_of

SILENT_AFTER_NS = 86_400 * 1_000_000_000
"""A vehicle without data for longer is counted as silent."""


def backlog_measures(services: Services) -> list[Metric]:
    """Return what waits, since when, and how many vehicles of each fleet are silent."""
    with services.storage.read() as unit:
        found = backlog_of(unit.connection)
    return [_recordings(found), _oldest(found), *_vehicles(found, services.clock.now_ns())]


def _recordings(found: Backlog) -> Metric:
    family = GaugeMetricFamily("treadwatch_recordings", "Recordings by state.", labels=["state"])
    for state in ChunkState:
        family.add_metric([state.value], found.recordings.get(state, 0))
    return family


def _oldest(found: Backlog) -> Metric:
    text = "Since when the oldest waits that is not decoded or estimated; 0 where none waits."
    family = GaugeMetricFamily("treadwatch_oldest_waiting_timestamp_seconds", text, labels=["what"])
    for what, at_ns in (("recording", found.oldest_recording_ns), ("window", found.oldest_window_ns)):
        family.add_metric([what], 0.0 if at_ns is None else at_ns / 1e9)
    return family


def _vehicles(found: Backlog, now_ns: int) -> list[Metric]:
    vehicles = GaugeMetricFamily("treadwatch_vehicles", "Vehicles with a mounted wheelset.", labels=["fleet"])
    silent = GaugeMetricFamily(
        "treadwatch_vehicles_silent", "Those of them without data for more than a day.", labels=["fleet"]
    )
    every = Tally(fleet for fleet, _ in found.last_data)
    quiet = Tally(fleet for fleet, at_ns in found.last_data if at_ns is None or at_ns < now_ns - SILENT_AFTER_NS)
    for fleet, count in sorted(every.items()):
        vehicles.add_metric([fleet], count)
        silent.add_metric([fleet], quiet[fleet])
    return [vehicles, silent]


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

    def __init__(self, services: Callable[[], Services | None]) -> None:
        self._services = services

    def describe(self) -> Iterable[Metric]:
        """Return nothing, so that registering does not ask the database."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return the measures of now."""
        up = GaugeMetricFamily("treadwatch_database_up", "Whether the database answers.")
        measures: list[Metric] = []
        services = self._services()
        try:
            if services is not None:
                measures = [
                    _windows(services),
                    _alerts(services),
                    *_runs(services),
                    _quarantined(services),
                    *backlog_measures(services),
                    *webhook_measures(services.storage),
                ]
        except TreadwatchError as error:
            _log.warning("the database does not answer: %s", error)
        up.add_metric([], 1.0 if measures else 0.0)
        return [up, *measures]


def _windows(services: Services) -> Metric:
    family = GaugeMetricFamily("treadwatch_windows", "Windows by state.", labels=["state"])
    with services.storage.read() as unit:
        counts = unit.windows.counts()
    for state in WindowState:
        family.add_metric([state.value], counts.get(state.value, 0))
    return family


def _quarantined(services: Services) -> Metric:
    labels = ["kind", "reason_code"]
    family = GaugeMetricFamily("treadwatch_quarantined", "What failed by itself and waits.", labels=labels)
    with services.storage.read() as unit:
        counts = unit.quarantine.counts()
    for kind in SubjectKind:
        for code in sorted({*TRIED_AGAIN, *(code for of, code in counts if of is kind)}):
            family.add_metric([kind.value, code.value], counts.get((kind, code), 0))
    return family


def _alerts(services: Services) -> Metric:
    labels = ["fleet", "kind", "severity"]
    family = GaugeMetricFamily("treadwatch_alerts_open", "Open alerts.", labels=labels)
    with services.storage.read() as unit:
        of_wheelsets = [alert for alert in unit.alerts.all_open() if alert.scope is AlertScope.WHEELSET]
        found = Tally((alert.fleet, alert.kind, alert.severity.value) for alert in of_wheelsets)
    for key, count in sorted(found.items()):
        family.add_metric(list(key), count)
    return family


def _runs(services: Services) -> list[Metric]:
    started = GaugeMetricFamily(
        "treadwatch_job_last_start_timestamp_seconds", "Start of the last run.", labels=["job", "outcome"]
    )
    took = GaugeMetricFamily("treadwatch_job_last_duration_seconds", "Duration of the last run.", labels=["job"])
    with services.storage.read() as unit:
        last = [run for name in services.jobs for run in unit.jobs.page(name, None, 1)]
    for run in last:
        started.add_metric([run.job, run.outcome], run.started_ns / 1e9)
        if run.finished_ns is not None:
            took.add_metric([run.job], (run.finished_ns - run.started_ns) / 1e9)
    return [started, took]
