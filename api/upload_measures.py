"""Measures of uploads, and of what of them waits to be decoded."""

from __future__ import annotations

import logging

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from api.measures import counter
from api.services import Services
from api.uploads.taking import NO_STORAGE, UPLOADS_FULL, Taken
from estimation.errors import TreadwatchError
from ingest.intake.backlog import Limit, free_bytes

_log = logging.getLogger(__name__)


def upload_measures(services: Services | None) -> list[Metric]:
    """Return the measures of this process's uploads, and of the backlog of all."""
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
    ended = {outcome.value: uploads.ended[outcome] for outcome in Taken}
    limits = (*(one.value for one in Limit), UPLOADS_FULL, NO_STORAGE)
    refused = {limit: uploads.refused[limit] for limit in limits}
    text = "Bytes of new chunks that have their receipt."
    return [
        GaugeMetricFamily("treadwatch_uploads_running", "Chunks that are being received.", value=uploads.running),
        counter("treadwatch_uploads", "Uploads by how they ended.", "outcome", ended),
        counter("treadwatch_uploads_behind", "Uploads refused with 503.", "limit", refused),
        CounterMetricFamily("treadwatch_upload_bytes", text, value=uploads.bytes_stored),
    ]


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
