"""The topic of references consumed until a stop is requested; what happens is logged."""

from __future__ import annotations

import logging
import os
import threading
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from api.factory import (
    RECEIPT_PATIENCE_S,
    SystemClock,
    backlog_watch,
    process_name,
    raw_store,
    receiver,
    topic_of,
    with_named_setting,
)
from api.measures import counter, gauge
from api.settings import PREFIX, Settings, load_settings
from api.terminal.health_server import Answer, HealthAddress, json_answer, served
from api.terminal.store import begun, store_once_it_answers
from estimation.errors import ParameterError
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import decode_received
from ingest.live.status import Backoff
from ingest.topic.client import ConsumerStatus, Outcome, Topic, TopicReader
from ingest.topic.consuming import Consuming, ReferenceTaking

WATCH_EVERY_S = 0.2
MEASURES = "treadwatch_consumer_"
FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 30.0
_log = logging.getLogger(__name__)


def consume(health: HealthAddress | None) -> None:
    """Consume the topic."""
    settings = load_settings()
    topic = topic_of(settings)
    if topic is None:
        raise ParameterError(
            "is needed: brokers as host:port, with commas between them", field=f"{PREFIX}KAFKA_SERVERS"
        )
    stopping, status = begun(settings), ConsumerStatus()
    opened = store_once_it_answers(settings, stopping)
    if opened is None:
        return
    reader = with_named_setting(lambda: TopicReader(topic, status))
    work = _Work(settings, opened, topic, status, stopping)
    status.thread = threading.Thread(target=work.run, args=(reader,), name="consumer", daemon=True)
    with ExitStack() as stack:
        if health is not None:
            answers = partial(_health, status), partial(_readiness, status)
            port = stack.enter_context(served(health, *answers, [partial(_measures, status)]))
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


@dataclass(slots=True)
class _Work:
    """The thread of a consumer, with the store that it owns."""

    settings: Settings
    storage: SqlStorage
    topic: Topic
    status: ConsumerStatus
    stopping: threading.Event
    failure: Exception | None = None

    def run(self, reader: TopicReader) -> None:
        """Consume until a stop; a client that refuses everything from now on is replaced."""
        with closing(self.storage):
            try:
                self._consume(reader)
            except Exception as error:  # noqa: BLE001 - raised by the main thread
                self.failure = error

    def _consume(self, reader: TopicReader) -> None:
        from confluent_kafka import KafkaException  # noqa: PLC0415 - an extra, imported where it is used

        delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
        raw, clock = raw_store(self.settings), SystemClock()
        decoder = receiver(self.settings, self.storage, clock)
        decode = partial(decode_received, self.storage, decoder, process_name())
        patient = replace(self.storage, patience_s=RECEIPT_PATIENCE_S)
        backlog = backlog_watch(self.settings, self.storage, raw)
        taking = ReferenceTaking(patient, raw, clock, backlog, f"topic {self.topic.name}")
        while True:
            with closing(reader):
                try:
                    Consuming(reader, taking, decode, self.status, self.stopping.is_set).run()
                except KafkaException as error:
                    _log.warning("the consumer begins again: %s", error)
                else:
                    return
            if self.stopping.wait(delays.failed()):
                return
            reader = TopicReader(self.topic, self.status)


def _health(status: ConsumerStatus) -> Answer:
    return json_answer(status.alive, {"thread": status.alive})


def _readiness(status: ConsumerStatus) -> Answer:
    """Whether references reach their receipts; one that waits because too much is not decoded yet is no fault."""
    facts = {"faults": status.faults, "behind": status.behind, "partitions": status.partitions}
    return json_answer(status.alive and not status.faults, facts)


def _measures(status: ConsumerStatus) -> list[Metric]:
    outcomes = {outcome.value: status.outcomes[outcome] for outcome in Outcome}
    gauges = {
        "partitions": ("Partitions that are this consumer's.", status.partitions),
        "messages_waiting": ("Messages of these partitions that are not taken yet.", status.behind_by),
        "last_message_timestamp_seconds": (
            "When the last message was taken; 0 before the first.",
            status.last_message_s or 0.0,
        ),
        "last_reference_age_seconds": ("How old the last reference was when it was taken.", status.last_age_s),
    }
    faults = {**status.faults, **({} if status.behind is None else {"backlog": status.behind})}
    up = {what: 0.0 if what in faults else 1.0 for what in ("broker", "raw", "database", "backlog")}
    failed = "Chunks that could not be decoded."
    return [
        counter(f"{MEASURES}messages", "Messages of the topic by what became of them.", "outcome", outcomes),
        CounterMetricFamily(f"{MEASURES}chunks_decoded", "Chunks that were decoded.", value=status.decoded),
        CounterMetricFamily(f"{MEASURES}chunks_not_decoded", failed, value=status.not_decoded),
        *(GaugeMetricFamily(f"{MEASURES}{name}", text, value=value) for name, (text, value) in gauges.items()),
        gauge(f"{MEASURES}up", "Whether it works.", "what", up),
    ]
