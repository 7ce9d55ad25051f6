"""The topic of references consumed until a stop is requested; what happens is logged."""

from __future__ import annotations

import logging
import os
import threading
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial

from api import logs
from api.factory import (
    RECEIPT_PATIENCE_S,
    SystemClock,
    backlog_watch,
    once_the_database_answers,
    open_store,
    process_name,
    raw_store,
    receiver,
)
from api.settings import PREFIX, Settings, load_settings
from api.terminal.consumer_health import serving_consumer_health
from api.terminal.health_server import HealthAddress
from api.topic import topic_of, with_named_setting
from api.tracing import start_tracing
from estimation.errors import ParameterError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.storage import SqlStorage
from ingest.live.backoff import Backoff
from ingest.topic.client import Topic
from ingest.topic.consuming import Consuming, Decoding
from ingest.topic.reading import TopicReader
from ingest.topic.reference import ConsumerStatus
from ingest.topic.taking import ReferenceTaking

WATCH_EVERY_S = 0.2
FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 30.0
_log = logging.getLogger(__name__)


def consume(health: HealthAddress | None) -> None:
    """Consume the topic."""
    settings = load_settings()
    logs.configure(settings)
    start_tracing()
    topic = topic_of(settings)
    if topic is None:
        raise ParameterError(
            "is needed: brokers as host:port, with commas between them", field=f"{PREFIX}KAFKA_SERVERS"
        )
    stopping, status = threading.Event(), ConsumerStatus()
    stop_on_signals(stopping)
    opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
    if opened is None:
        return
    reader = with_named_setting(lambda: TopicReader(topic, status))
    work = _Work(settings, opened, topic, status, stopping)
    status.thread = threading.Thread(target=work.run, args=(reader,), name="consumer", daemon=True)
    with ExitStack() as stack:
        if health is not None:
            port = stack.enter_context(serving_consumer_health(health, status))
            _log.info("health and metrics at http://%s:%d", health.host, port)
        status.thread.start()
        while not stopping.wait(WATCH_EVERY_S) and status.alive:
            pass
        status.thread.join(settings.shutdown_timeout_s)
    if status.alive:  # what it works at has no offset yet, and comes again
        _log.warning("the consumer ends in the middle of a chunk, after %d s", settings.shutdown_timeout_s)
        logging.shutdown()
        os._exit(0)
    if work.failure is not None:
        raise work.failure


class _Work:
    """The thread of a consumer, with the store that it owns."""

    def __init__(
        self, settings: Settings, storage: SqlStorage, topic: Topic, status: ConsumerStatus, stopping: threading.Event
    ) -> None:
        self._settings = settings
        self._storage = storage
        self._topic = topic
        self._status = status
        self._stopping = stopping
        self.failure: Exception | None = None

    def run(self, reader: TopicReader) -> None:
        """Consume until a stop; a client that refuses everything from now on is replaced."""
        with closing(self._storage):
            try:
                self._consume(reader)
            except Exception as error:  # noqa: BLE001 - raised by the main thread
                self.failure = error

    def _consume(self, reader: TopicReader) -> None:
        from confluent_kafka import KafkaException  # noqa: PLC0415 - an extra, imported where it is used

        delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
        decoder = receiver(self._settings, self._storage, SystemClock())
        while True:
            with closing(reader):
                try:
                    self._consuming(reader, Decoding(self._storage, decoder, process_name())).run()
                except KafkaException as error:
                    _log.warning("the consumer begins again: %s", error)
                else:
                    return
            if self._stopping.wait(delays.failed()):
                return
            reader = TopicReader(self._topic, self._status)

    def _consuming(self, reader: TopicReader, decoding: Decoding) -> Consuming:
        patient = replace(self._storage, patience_s=RECEIPT_PATIENCE_S)
        raw = raw_store(self._settings)
        backlog = backlog_watch(self._settings, self._storage, raw)
        sender = f"topic {self._topic.name}"
        taking = ReferenceTaking(patient, raw, SystemClock(), backlog, sender)
        return Consuming(reader, taking, decoding, self._status, self._stopping.is_set)
