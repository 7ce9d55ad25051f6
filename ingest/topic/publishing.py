"""References to received chunks are published; whether brokers are there or not, nobody waits for it.

The database is the truth: a reference that is dropped is found by the schedule.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING

from estimation.errors import TreadwatchError
from fleet_db.receipts import ChunkRecord, ChunkState
from ingest.topic.client import Topic, connected, kafka, require_client
from ingest.topic.reference import Reference, message_of, reference_of

if TYPE_CHECKING:
    from confluent_kafka import KafkaError, Message, Producer

MOST_WAITING = 10_000  # references that wait for a broker; what comes beyond is dropped
CLOSE_S = 5.0  # how long an end waits for the brokers
POLL_S = 0.1
BEGIN_AGAIN_EVERY_S = 10.0
"""How often a producer that the brokers refuse for good, such as one without permission, is replaced at most."""
FLEET_COUNTS_S = 60.0  # how long the fleet of a vehicle counts that was looked up; it only decides the partition
FLEETS_KEPT = 10_000

_log = logging.getLogger(__name__)


class Sent(StrEnum):
    """How the publishing of a reference ended."""

    PUBLISHED = "published"
    DROPPED = "dropped"  # too many waited already, or an end was requested
    FAILED = "failed"  # no broker took it in time


class Publisher:
    """Publishes references from a thread of its own; it starts with the first.

    ``fleet_of`` returns the fleet of a vehicle; it raises TreadwatchError where that is not known.
    """

    def __init__(self, topic: Topic, fleet_of: Callable[[str], str], most_waiting: int = MOST_WAITING) -> None:
        require_client()
        self._topic = topic
        self._fleet_of = fleet_of
        self._most_waiting = most_waiting
        self._producer = self._made()
        self._queue: queue.SimpleQueue[Reference | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._fleets: dict[str, tuple[str, float]] = {}
        self._fault = ""
        self._began_s = float("-inf")
        self._handed = 0  # to the producer, and not reported on yet
        self.waiting = 0
        self.ended: Counter[Sent] = Counter()

    def publish(self, record: ChunkRecord) -> None:
        """Hand a reference over to a committed receipt; it never waits and never fails.

        Nobody needs the reference where the receipt is decoded or decided on already.
        """
        reference = reference_of(record) if record.state is ChunkState.STORED else None
        if reference is None:
            return
        with self._lock:
            if self._closed or self.waiting >= self._most_waiting:
                self.ended[Sent.DROPPED] += 1
                return
            self.waiting += 1
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="references", daemon=True)
                self._thread.start()
        self._queue.put(reference)

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Publish what waits within a time, drop the rest, and log how many did not reach the topic."""
        until = time.monotonic() + timeout_s
        with self._lock:
            self._closed, thread = True, self._thread
        if thread is not None:
            self._queue.put(None)
            thread.join(timeout_s)
            with suppress(kafka().KafkaException, SystemError):  # refused for good
                self._producer.flush(max(0.0, until - time.monotonic()))
            self._producer.purge()
        with self._lock:
            self.ended[Sent.DROPPED] += self.waiting
            self.waiting = 0
            lost = self.ended[Sent.DROPPED] + self.ended[Sent.FAILED]
        if lost:
            _log.warning("%d references did not reach the topic %s: the schedule finds them", lost, self._topic.name)

    def _run(self) -> None:
        while True:
            try:
                reference = self._queue.get(timeout=POLL_S)
            except queue.Empty:
                self._serve()
                continue
            if reference is None:
                return
            self._produce(reference)
            self._serve()

    def _produce(self, reference: Reference) -> None:
        key, value = message_of(reference, self._fleet(reference.vehicle))
        delivered = partial(self._delivered, self._producer)
        try:
            self._producer.produce(self._topic.name, value, key, on_delivery=delivered)
        except (kafka().KafkaException, BufferError) as error:
            self._end(Sent.FAILED)
            self._failed(error)
        else:
            self._handed += 1

    def _serve(self) -> None:
        try:
            self._producer.poll(0)
        except (kafka().KafkaException, SystemError) as error:  # raised where the brokers refuse for good
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        """Report an error; replace a producer that refuses everything from now on."""
        for_good = isinstance(error, SystemError)  # of the client, in which an error of the other kind was raised
        fault = str(error)
        if isinstance(error, kafka().KafkaException):
            fault = error.args[0].str()
            for_good = error.args[0].fatal() or error.args[0].code() == kafka().KafkaError._FATAL  # noqa: SLF001 - is public
        self._report(fault)
        if for_good and time.monotonic() - self._began_s >= BEGIN_AGAIN_EVERY_S:
            self._began_s = time.monotonic()
            self._producer.purge()
            self._producer = self._made()
            self._end(Sent.FAILED, self._handed)
            self._handed = 0

    def _fleet(self, vehicle: str) -> str:
        """Return the fleet of a vehicle; empty where it cannot be found now."""
        found, until_s = self._fleets.get(vehicle, ("", 0.0))
        if time.monotonic() < until_s:
            return found
        try:
            found = self._fleet_of(vehicle)
        except TreadwatchError:  # not registered yet, or the database is away: the key only decides the partition
            return found
        if len(self._fleets) >= FLEETS_KEPT:
            self._fleets.clear()
        self._fleets[vehicle] = (found, time.monotonic() + FLEET_COUNTS_S)
        return found

    def _delivered(self, producer: Producer, error: KafkaError | None, _message: Message) -> None:
        if producer is not self._producer:  # replaced: what it held has failed
            return
        self._handed -= 1
        if error is None:
            self._end(Sent.PUBLISHED)
            if self._fault:
                _log.info("references reach the topic %s again", self._topic.name)
            self._fault = ""
        else:
            self._end(Sent.FAILED)
            self._report(error.str())

    def _end(self, how: Sent, count: int = 1) -> None:
        with self._lock:
            ended = min(count, self.waiting)  # the others were dropped at the end
            self.waiting -= ended
            self.ended[how] += ended

    def _report(self, fault: str) -> None:
        if not self._fault:
            _log.warning("references do not reach the topic %s: %s", self._topic.name, fault)
        self._fault = fault

    def _made(self) -> Producer:
        config = {
            "queue.buffering.max.messages": self._most_waiting,
            **self._topic.producer(),
            "error_cb": lambda error: self._report(error.str()),
            "logger": _log,
        }
        producer: Producer = connected(lambda: kafka().Producer(config), self._topic)
        return producer
