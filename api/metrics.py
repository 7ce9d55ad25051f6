"""Measures of requests as they happen; of data, uploads and webhooks when they are asked for."""

from __future__ import annotations

import logging
from collections import Counter as Tally
from collections.abc import Iterable, Sequence

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from api.measures import counter, gauge
from api.services import Services
from api.uploads import NO_STORAGE, UPLOADS_FULL, Taken
from estimation.errors import TreadwatchError
from estimation.values.alerts import AlertScope
from estimation.values.runs import TRIED_AGAIN, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.records import ChunkState, Webhook, WebhookState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.window_counts import backlog_of
from ingest.intake.backlog import Limit, free_bytes

SILENT_AFTER_NS = 86_400 * 1_000_000_000  # a vehicle without data for longer is counted as silent


def _waiting(unit: SqlUnitOfWork, now_ns: int) -> list[Metric]:
    """Return what waits, since when, and how many vehicles of each fleet are silent."""
    backlog = backlog_of(unit.connection)
    states = {state.value: backlog.recordings.get(state, 0) for state in ChunkState}
    oldest = {"recording": backlog.oldest_recording_ns, "window": backlog.oldest_window_ns}
    since = {what: 0.0 if at_ns is None else at_ns / 1e9 for what, at_ns in oldest.items()}
    long_ago_ns = now_ns - SILENT_AFTER_NS
    every = Tally(fleet for fleet, _ in backlog.last_data)
    quiet = Tally(fleet for fleet, at_ns in backlog.last_data if at_ns is None or at_ns < long_ago_ns)
    silent = {fleet: quiet[fleet] for fleet in sorted(every)}
    text = "Since when the oldest waits that is not decoded or estimated; 0 where none waits."
    return [
        gauge("treadwatch_recordings", "Recordings by state.", "state", states),
        gauge("treadwatch_oldest_waiting_timestamp_seconds", text, "what", since),
        gauge("treadwatch_vehicles", "Vehicles with a mounted wheelset.", "fleet", dict(sorted(every.items()))),
        gauge("treadwatch_vehicles_silent", "Those of them without data for more than a day.", "fleet", silent),
    ]


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


def stored_measures(services: Services | None) -> list[Metric]:
    """Return what is read from the database; only ``treadwatch_database_up`` while it is down."""
    up = GaugeMetricFamily("treadwatch_database_up", "Whether the database answers.")
    measures: list[Metric] = []
    try:
        if services is not None:
            with services.storage.read() as unit:
                counts = unit.windows.counts()
                numbers = {state.value: counts.get(state.value, 0) for state in WindowState}
                stored = [
                    gauge("treadwatch_windows", "Windows by state.", "state", numbers),
                    _alerts(unit),
                    *_runs(unit, services.jobs),
                    _quarantined(unit),
                    *_waiting(unit, services.clock.now_ns()),
                ]
            measures = [*stored, *webhook_measures(services.storage)]
    except TreadwatchError as error:
        _log.warning("the database does not answer: %s", error)
    up.add_metric([], 1.0 if measures else 0.0)
    return [up, *measures]


def _quarantined(unit: SqlUnitOfWork) -> Metric:
    counts = unit.quarantine.counts()
    numbers = {
        (kind.value, code.value): counts.get((kind, code), 0)
        for kind in SubjectKind
        for code in sorted({*TRIED_AGAIN, *(code for of, code in counts if of is kind)})
    }
    return gauge("treadwatch_quarantined", "What failed by itself and waits.", "kind reason_code", numbers)


def _alerts(unit: SqlUnitOfWork) -> Metric:
    of_wheelsets = [alert for alert in unit.alerts.all_open() if alert.scope is AlertScope.WHEELSET]
    open_alerts = Tally((alert.fleet, alert.kind, alert.severity.value) for alert in of_wheelsets)
    return gauge("treadwatch_alerts_open", "Open alerts.", "fleet kind severity", dict(sorted(open_alerts.items())))


def _runs(unit: SqlUnitOfWork, jobs: Iterable[str]) -> list[Metric]:
    last = [run for name in jobs for run in unit.jobs.page(name, None, 1)]
    started = {(run.job, run.outcome.value): run.started_ns / 1e9 for run in last}
    took = {run.job: (run.finished_ns - run.started_ns) / 1e9 for run in last if run.finished_ns is not None}
    return [
        gauge("treadwatch_job_last_start_timestamp_seconds", "Start of the last run.", "job outcome", started),
        gauge("treadwatch_job_last_duration_seconds", "Duration of the last run.", "job", took),
    ]


def upload_measures(services: Services | None) -> list[Metric]:
    """Return the measures of this process's uploads, and of the backlog of all."""
    if services is None:
        return []
    uploads = services.uploads
    ended = {outcome.value: uploads.ended[outcome] for outcome in Taken}
    limits = (*(limit.value for limit in Limit), UPLOADS_FULL, NO_STORAGE)
    refused = {limit: uploads.refused[limit] for limit in limits}
    text = "Bytes of new chunks that have their receipt."
    measures = [
        GaugeMetricFamily("treadwatch_uploads_running", "Chunks that are being received.", value=uploads.running),
        counter("treadwatch_uploads", "Uploads by how they ended.", "outcome", ended),
        counter("treadwatch_uploads_behind", "Uploads refused with 503.", "limit", refused),
        CounterMetricFamily("treadwatch_upload_bytes", text, value=uploads.bytes_stored),
    ]
    try:
        watch = services.uploads.backlog
        with watch.storage.read() as unit:
            undecoded = unit.chunks.undecoded_size()
        values = {
            "treadwatch_chunks_waiting": ("Chunks with a receipt that wait to be decoded.", undecoded.count),
            "treadwatch_chunks_waiting_bytes": ("Their size.", undecoded.size_bytes),
            "treadwatch_chunks_waiting_limit": ("How many may.", watch.limits.chunks),
            "treadwatch_chunks_waiting_limit_bytes": ("How large they may be.", watch.limits.size_bytes),
            "treadwatch_raw_free_bytes": ("Room on the disk on which chunks are received.", free_bytes(watch.folder)),
            "treadwatch_raw_free_limit_bytes": ("How much of it stays free.", watch.limits.free_bytes),
        }
        measures += [GaugeMetricFamily(name, text, value=value) for name, (text, value) in values.items()]
    except TreadwatchError as error:
        _log.warning("the backlog of chunks cannot be measured: %s", error)
    return measures


def webhook_measures(storage: SqlStorage) -> list[Metric]:
    """Return how many webhooks are in which state, how their attempts ended, and since when the oldest event waits."""
    with storage.read() as unit:
        counts = unit.webhooks.counts()
    in_state = Tally(count.webhook.state for count in counts)
    states = {state.value: in_state[state] for state in WebhookState}
    attempts = {
        (str(counted.webhook.webhook_id), outcome): count
        for counted in counts
        for outcome, count in (("delivered", counted.delivered), ("failed", counted.failed))
    }
    return [
        gauge("treadwatch_webhooks", "Webhooks by state.", "state", states),
        counter("treadwatch_webhook_attempts", "Attempts to hand over an event.", "webhook outcome", attempts),
        _oldest_undelivered(storage, [counted.webhook for counted in counts]),
    ]


def _oldest_undelivered(storage: SqlStorage, webhooks: Sequence[Webhook]) -> Metric:
    """Return since when events wait, also where no process delivers; of active webhooks alone."""
    text = "When the oldest event was recorded that an active webhook has not delivered; 0 where none waits."
    numbers = {}
    for webhook in webhooks:
        if webhook.state is not WebhookState.ACTIVE:
            continue
        with storage.seen_by(webhook.bound).read() as unit:
            chosen = {"fleets": webhook.fleets, "kinds": webhook.kinds, "severities": webhook.severities}
            waits = unit.alerts.feed(webhook.position, 1, **chosen)
        numbers[str(webhook.webhook_id)] = waits[0].recorded_ns / 1e9 if waits else 0.0
    return gauge("treadwatch_webhook_oldest_undelivered_timestamp_seconds", text, "webhook", numbers)
