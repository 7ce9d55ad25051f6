"""Measures of uploads, and of what of them waits to be decoded."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from api.services import Services
from api.uploads.taking import NO_STORAGE, UPLOADS_FULL, Taken
from estimation.errors import TreadwatchError
from ingest.intake.backlog import Limit, free_bytes

_log = logging.getLogger(__name__)


class UploadMeasures(Collector):
    """Measures of this process's uploads, and of the backlog of all.

    Args:
        services: Returns those of the process; None while the database is waited for.
    """

    def __init__(self, services: Callable[[], Services | None]) -> None:
        self._services = services

    def describe(self) -> Iterable[Metric]:
        """Return nothing, so that registering does not ask the database."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return the measures of now."""
        services = self._services()
        if services is None:
            return []
        measures = _counted(services)
        try:
            measures += _waiting(services)
        except TreadwatchError as error:
            _log.warning("the backlog of chunks cannot be measured: %s", error)
        return measures


def _counted(services: Services) -> list[Metric]:
    uploads = services.uploads
    running = GaugeMetricFamily("treadwatch_uploads_running", "Chunks that are being received.")
    running.add_metric([], uploads.running)
    ended = CounterMetricFamily("treadwatch_uploads", "Uploads by how they ended.", labels=["outcome"])
    for outcome in Taken:
        ended.add_metric([outcome.value], uploads.ended[outcome])
    refused = CounterMetricFamily("treadwatch_uploads_behind", "Uploads refused with 503.", labels=["limit"])
    for limit in (*(one.value for one in Limit), UPLOADS_FULL, NO_STORAGE):
        refused.add_metric([limit], uploads.refused[limit])
    stored = CounterMetricFamily("treadwatch_upload_bytes", "Bytes of new chunks that have their receipt.")
    stored.add_metric([], uploads.bytes_stored)
    return [running, ended, refused, stored]


def _waiting(services: Services) -> list[Metric]:
    watch = services.uploads.backlog
    with watch.storage.read() as unit:
        found = unit.chunks.undecoded_size()
    values = {
        "treadwatch_chunks_waiting": ("Chunks with a receipt that wait to be decoded.", found.count),
        "treadwatch_chunks_waiting_bytes": ("Their size.", found.size_bytes),
        "treadwatch_chunks_waiting_limit": ("How many may.", watch.limits.chunks),
        "treadwatch_chunks_waiting_limit_bytes": ("How large they may be.", watch.limits.size_bytes),
        "treadwatch_raw_free_bytes": ("Room on the disk on which chunks are received.", free_bytes(watch.folder)),
        "treadwatch_raw_free_limit_bytes": ("How much of it stays free.", watch.limits.free_bytes),
    }
    return [GaugeMetricFamily(name, text, value=value) for name, (text, value) in values.items()]
