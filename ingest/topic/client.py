"""Clients of the topic: their configuration, and the member of the group that reads it.

Messages come one by one, offsets of what is done are committed, and partitions pause while one is worked at.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from estimation.errors import InputError, PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.input_file import SETTINGS_BYTES, read_text_within

if TYPE_CHECKING:
    from confluent_kafka import Consumer, KafkaError, TopicPartition


GROUP = "treadwatch"  # the one group of all consumers of a deployment
OURS = frozenset(
    {
        "bootstrap.servers",
        "metadata.broker.list",
        "client.id",
        "group.id",
        "group.instance.id",
        "group.protocol",
        "group.remote.assignor",
        "partition.assignment.strategy",
        "enable.idempotence",
        "acks",
        "request.required.acks",
        "transactional.id",
        "enable.auto.commit",
        "auto.commit.enable",
        "enable.auto.offset.store",
        "auto.offset.reset",
    }
)
"""Properties on which it rests that nothing is lost: a file cannot set them."""

_LOGGED = MappingProxyType({"log_level": 2})  # faults are reported once, not at each of its attempts
_PRODUCER: Mapping[str, Any] = MappingProxyType(
    {"enable.idempotence": True, "linger.ms": 20, "message.timeout.ms": 300_000}
)
_CONSUMER: Mapping[str, Any] = MappingProxyType(
    {
        "group.id": GROUP,
        "enable.auto.commit": True,  # of what is stored as done, each second and when a partition is given up
        "auto.commit.interval.ms": 1000,
        "enable.auto.offset.store": False,
        "auto.offset.reset": "earliest",
        "partition.assignment.strategy": "cooperative-sticky",
        "session.timeout.ms": 10_000,
        "heartbeat.interval.ms": 3_000,
        "queued.min.messages": 1000,
        "queued.max.messages.kbytes": 1024,
        "fetch.message.max.bytes": 262_144,
    }
)
Client = TypeVar("Client")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and how its brokers are reached."""

    servers: str  # brokers, ``host:port`` with commas between them
    name: str
    properties: Mapping[str, str] = field(default_factory=dict, repr=False)  # of librdkafka; may hold passwords

    def producer(self) -> dict[str, Any]:
        """Return the configuration of a producer."""
        return self._common(_PRODUCER)

    def consumer(self) -> dict[str, Any]:
        """Return the configuration of a member of the group."""
        return self._common(_CONSUMER)

    def _common(self, own: Mapping[str, Any]) -> dict[str, Any]:
        fixed = {"bootstrap.servers": self.servers, "client.id": "treadwatch"}
        return {**_LOGGED, **own, **self.properties, **fixed}


def load_properties(path: Path) -> dict[str, str]:
    """Return the properties of a file: lines ``name=value``; empty ones and those that begin with ``#`` are left out.

    Errors never have a value in them: it may be a secret.
    """
    properties: dict[str, str] = {}
    for number, line in enumerate(read_text_within(path, SETTINGS_BYTES, InputError).splitlines(), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        name, separator, value = text.partition("=")
        name = name.strip()
        if not separator or not re.fullmatch(r"[a-z0-9._]+", name):
            raise InputError("is no line name=value of a librdkafka property", file=path, line=number)
        if name in OURS:
            raise InputError(f"{name} is set by treadwatch", file=path, line=number)
        properties[name] = value.strip()
    return properties


def require_client() -> None:
    """Refuse to go on without the library."""
    if importlib.util.find_spec("confluent_kafka") is None:
        missing = "the Kafka client is not installed: pip install 'treadwatch[kafka]'"
        raise PassingFaultError(missing, code=ReasonCode.WAITS_FOR_EXTRA)


def kafka() -> ModuleType:
    """Return the library, which is an extra and imported where it is used."""
    return importlib.import_module("confluent_kafka")


def connected(make: Callable[[], Client], topic: Topic) -> Client:
    """Return a client, or refuse a configuration that cannot be used; the brokers need not be there.

    The value of a property that cannot be used is not repeated: it may be a secret.
    """
    try:
        return make()
    except kafka().KafkaException as error:
        text = str(error)
        named = next((name for name in sorted(topic.properties, key=len, reverse=True) if name in text), None)
        which = "a property" if named is None else f"the property {named}"
        raise InputError(f"{which} of the Kafka client cannot be used") from None


STAY_EVERY_S = 10.0  # a member that works for so long at one message takes part in its group in between
SHORT_POLL_S = 0.2
ASK_S = 2.0

_log = logging.getLogger(__name__)


class Outcome(StrEnum):
    """What became of a message, once its offset is committed."""

    STORED = "stored"  # the receipt is new: the bytes were in the raw store already
    KNOWN = "known"  # there was a receipt
    MISSING = "missing"  # no such bytes in the raw store: in quarantine, tried again
    DAMAGED = "damaged"  # other bytes under that digest, or of another size: in quarantine, tried again
    FAILED = "failed"  # the program failed at it: in quarantine, tried again
    OTHER_VEHICLE = "other_vehicle"  # the same chunk was received from another vehicle
    DELETED = "deleted"  # the chunk was deleted by hand
    MALFORMED = "malformed"
    OTHER_VERSION = "other_version"
    CONTRADICTORY = "contradictory"  # key and body name different vehicles


@dataclass(slots=True)
class ConsumerStatus:
    """What a consumer knows; written by its thread, and read by any. Counts are since the start; no fault is None."""

    broker_fault: str | None = "not asked yet"
    raw_fault: str | None = None
    database_fault: str | None = "not asked yet"
    behind: str | None = None  # which limit keeps new receipts out
    outcomes: Counter[Outcome] = field(default_factory=Counter)  # of messages
    decoded: int = 0  # chunks
    not_decoded: int = 0  # chunks that could not be
    partitions: int = 0  # this consumer's
    behind_by: int = 0  # messages of these that are not taken yet, as far as the brokers have said
    last_message_s: float | None = None  # seconds since the Unix epoch; None before the first
    last_age_s: float = 0.0  # of the reference of the last message, when it was taken
    thread: threading.Thread | None = None

    @property
    def alive(self) -> bool:
        """Whether its thread runs."""
        return self.thread is not None and self.thread.is_alive()

    @property
    def faults(self) -> dict[str, str]:
        """What keeps references from their receipts, by where it is."""
        faults = {"broker": self.broker_fault, "raw": self.raw_fault, "database": self.database_fault}
        return {where: fault for where, fault in faults.items() if fault is not None}


@dataclass(frozen=True, slots=True)
class Received:
    """A message, and since which assignment its partition is this member's."""

    key: bytes | None
    value: bytes | None
    partition: int
    offset: int
    assignment: int


class TopicReader:
    """Joins the group; used by one thread."""

    def __init__(self, topic: Topic, status: ConsumerStatus) -> None:
        require_client()
        self._topic = topic
        self._status = status
        self._assignments: dict[int, int] = {}
        self._assignment = 0
        self._paused = False
        self._early: deque[Received] = deque()
        self._polled_s = time.monotonic()
        config = {**topic.consumer(), "error_cb": self._on_error, "logger": _log}
        self._consumer: Consumer = connected(lambda: kafka().Consumer(config), topic)
        self._consumer.subscribe([topic.name], on_assign=self._on_assign, on_revoke=self._on_revoke)

    def next(self, timeout_s: float) -> Received | None:
        """Return the next message; None where none came in time."""
        return self._early.popleft() if self._early else self._polled(timeout_s)

    def done(self, message: Received) -> None:
        """Let the offset behind a message be committed, unless its partition is another member's by now."""
        if not self.holds(message):
            return
        behind = kafka().TopicPartition(self._topic.name, message.partition, message.offset + 1)
        try:
            self._consumer.store_offsets(offsets=[behind])
        except kafka().KafkaException as error:  # given up a moment ago: the next member gets the message again
            _log.info("offset %d of partition %d is not stored: %s", message.offset, message.partition, error)

    def holds(self, message: Received) -> bool:
        """Whether the partition of a message has been this member's since the message came."""
        return self._assignments.get(message.partition) == message.assignment

    def stay(self) -> None:
        """Take part in the group from time to time while a message is worked at."""
        if time.monotonic() - self._polled_s >= STAY_EVERY_S:
            with self.paused():
                self._take_part(0.0)

    def wait(self, seconds: float, stopped: Callable[[], bool]) -> None:
        """Take no message for a while, and stay in the group."""
        until_s = time.monotonic() + seconds
        with self.paused():
            while not stopped() and (left_s := until_s - time.monotonic()) > 0.0:
                self._take_part(min(left_s, SHORT_POLL_S))

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Fetch nothing within; partitions that come meanwhile pause too."""
        if self._paused:
            yield
            return
        self._paused = True
        self._consumer.pause(self._consumer.assignment())
        try:
            yield
        finally:
            self._paused = False
            self._consumer.resume(self._consumer.assignment())

    def ask(self) -> None:
        """Ask a broker about the topic, and say in the status how it stands."""
        try:
            topic = self._consumer.list_topics(self._topic.name, timeout=ASK_S).topics[self._topic.name]
        except kafka().KafkaException as error:
            self._fault(error.args[0].str())
            return
        if topic.error is not None:
            self._fault(topic.error.str())
        else:
            self._well()
        self._status.behind_by = sum(self._behind_by(partition) for partition in self._consumer.assignment())

    def close(self) -> None:
        """Commit what is done, and leave the group."""
        self._consumer.close()

    def _take_part(self, timeout_s: float) -> None:
        message = self._polled(timeout_s)
        if message is not None:  # it was on its way when the partitions paused
            self._early.append(message)

    def _polled(self, timeout_s: float) -> Received | None:
        message = self._consumer.poll(timeout_s)
        self._polled_s = time.monotonic()
        if message is None:
            return None
        error = message.error()
        if error is not None:
            self._on_error(error)
            if error.fatal():
                raise kafka().KafkaException(error)
            return None
        self._well()
        partition, offset = message.partition(), message.offset()
        assert partition is not None
        assert offset is not None
        return Received(message.key(), message.value(), partition, offset, self._assignments.get(partition, 0))

    def _on_assign(self, consumer: Consumer, partitions: list[TopicPartition]) -> None:
        consumer.incremental_assign(partitions)
        self._assignment += 1
        self._assignments |= {partition.partition: self._assignment for partition in partitions}
        if self._paused:
            consumer.pause(partitions)
        self._count()

    def _on_revoke(self, consumer: Consumer, partitions: list[TopicPartition]) -> None:
        for partition in partitions:
            self._assignments.pop(partition.partition, None)
        self._early = deque(message for message in self._early if self.holds(message))
        consumer.incremental_unassign(partitions)
        self._count()

    def _count(self) -> None:
        self._status.partitions = len(self._assignments)
        _log.info("%d partitions of the topic %s are this consumer's", len(self._assignments), self._topic.name)

    def _behind_by(self, partition: TopicPartition) -> int:
        marks = self._consumer.get_watermark_offsets(partition, cached=True)
        (position,) = self._consumer.position([partition])
        if not marks or marks[1] < 0:
            return 0
        return max(0, int(marks[1]) - (position.offset if position.offset >= 0 else int(marks[0])))

    def _on_error(self, error: KafkaError) -> None:
        self._fault(error.str())

    def _fault(self, fault: str) -> None:
        if self._status.broker_fault in {None, "not asked yet"}:
            _log.warning("the topic %s cannot be read now: %s", self._topic.name, fault)
        self._status.broker_fault = fault

    def _well(self) -> None:
        if self._status.broker_fault not in {None, "not asked yet"}:
            _log.info("the topic %s can be read again", self._topic.name)
        self._status.broker_fault = None
