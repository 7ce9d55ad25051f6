"""Chunks: a drop folder watched, what is received decoded, a topic of references consumed, raw files read again."""

from __future__ import annotations

import logging
import os
import threading
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import typer
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from api import logs
from api.factory import SystemClock, open_store, process_name, raw_store
from api.measures import counter, gauge
from api.pipeline import MEGABYTE, RECEIPT_PATIENCE_S, backlog_watch, publishing, receiver, topic_of, with_named_setting
from api.settings import PREFIX, Settings, load_settings
from api.terminal.health_server import Answer, HealthAddress, json_answer, served
from api.terminal.ingest import vehicle_in_name
from api.terminal.processes import begun, store_once_it_answers
from api.terminal.progress import counted
from api.terminal.stopping import stop_on_signals
from estimation.errors import InputError, MigrationError, ParameterError, PassingFaultError, StoppedError, StorageError
from fleet_db.keeping.checks import ScrubFault, ScrubPlan, scrub
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import DecodedChunks, decode_received
from ingest.intake.drop_folder import DropFolder, DropSettings, held_folder
from ingest.live.status import Backoff
from ingest.receipts import ChunkStorage
from ingest.topic.client import ConsumerStatus, Outcome, Topic, TopicReader
from ingest.topic.consuming import Consuming, ReferenceTaking

LOOK_EVERY_S = 1.0
FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 30.0
_log = logging.getLogger(__name__)


def work(*, once: bool) -> None:
    """Decode what is received until a stop is requested."""
    settings, clock = load_settings(), SystemClock()
    stopping = begun(settings)

    def checkpoint(done: int, total: int) -> None:
        if stopping.is_set():
            raise StoppedError(done, total)

    with closing(store_once_it_answers(settings, stopping)) as storage, suppress(StoppedError):
        decoder = receiver(settings, storage, clock)
        while not stopping.is_set():
            done = DecodedChunks()
            try:
                done = decode_received(storage, decoder, process_name(), checkpoint)
            except StorageError as error:
                _log.warning("decoding waits for the database: %s", error)
                if once:
                    raise
            if done.decoded or done.others:
                _log.info("%d chunks decoded, %d could not be", done.decoded, done.others)
            elif once:
                return
            stopping.wait(LOOK_EVERY_S)


def scrub_and_report(mb_per_s: float | None, *, resume: bool) -> None:
    """Read every raw file again, print what is damaged or missing, and exit 1 where anything is."""

    def print_fault(fault: ScrubFault) -> None:
        typer.echo(f"recording {fault.file.digest[:12]} of vehicle {fault.file.vehicle}: {fault.fault}")

    settings = load_settings()
    plan = ScrubPlan(None if mb_per_s is None else mb_per_s * MEGABYTE, resume)
    with closing(open_store(settings)) as storage, counted("reading raw files") as progress:
        ended = scrub(storage, raw_store(settings), plan, SystemClock().now_ns, print_fault, progress)
    typer.echo(f"read {ended.files:,} raw files, {ended.file_bytes:,} bytes: {ended.faults:,} damaged or missing")
    if ended.faults:
        raise typer.Exit(1)


def watch(folder: Path, vehicle: str | None, quiet_s: float, *, once: bool) -> None:
    """Watch a folder."""
    settings = load_settings()
    logs.configure(settings)
    if not folder.is_dir():
        raise InputError("is no folder", file=folder)
    stopping = threading.Event()
    stop_on_signals(stopping)
    with held_folder(folder):
        opened = store_once_it_answers(settings, stopping)
        with closing(opened) as storage, publishing(settings, lambda: storage) as announce:
            raw = raw_store(settings)
            wanted = DropSettings(
                folder, quiet_s, settings.max_chunk_mb * MEGABYTE, lambda path: vehicle or vehicle_in_name(path)
            )
            chunks = ChunkStorage(replace(storage, patience_s=RECEIPT_PATIENCE_S), raw, SystemClock(), announce)
            _watch(DropFolder(wanted, raw, chunks, backlog_watch(settings, storage, raw)), stopping, once=once)


def _watch(drop: DropFolder, stopping: threading.Event, *, once: bool) -> None:
    delays, waited = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S), ""
    while not stopping.is_set():
        try:
            look = drop.look()
        except MigrationError:
            raise
        except (PassingFaultError, StorageError) as error:
            if str(error) != waited:
                _log.warning("files wait in the folder: %s", error)
            waited = str(error)
            stopping.wait(delays.failed())
            continue
        delays.succeeded()
        behind = "" if look.behind is None else look.behind.limit.value
        if look.behind is not None and behind != waited:
            _log.warning("files wait in the folder: %s", look.behind.text)
        waited = behind
        for line in look.refused:
            _log.warning("refused %s", line)
        if look.stored or look.known:
            _log.info("%d files stored, %d were known already", look.stored, look.known)
        if once and not (look.stored or look.known or look.incomplete):
            return
        stopping.wait(LOOK_EVERY_S)


WATCH_EVERY_S = 0.2
MEASURES = "treadwatch_consumer_"


def consume(health: HealthAddress | None) -> None:
    """Consume the topic."""
    settings = load_settings()
    topic = topic_of(settings)
    if topic is None:
        reason = "is needed: brokers as host:port, with commas between them"
        raise ParameterError(reason, field=f"{PREFIX}KAFKA_SERVERS")
    stopping, status = begun(settings), ConsumerStatus()
    opened = store_once_it_answers(settings, stopping)
    reader = with_named_setting(lambda: TopicReader(topic, status))
    work = _Work(settings, opened, topic, status, stopping)
    status.thread = threading.Thread(target=work.run, args=(reader,), name="consumer", daemon=True)
    with ExitStack() as stack:
        if health is not None:
            alive = lambda: json_answer(status.alive, {"thread": status.alive})  # noqa: E731 - as short as it is
            port = stack.enter_context(served(health, alive, partial(_readiness, status), [partial(_measures, status)]))
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
