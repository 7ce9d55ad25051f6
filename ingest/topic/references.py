"""References to received chunks: their form on the topic (key ``fleet:vehicle``, a small JSON object), and publishing.

Whether brokers are there or not, nobody waits for it. The database is the truth: a reference that is dropped is found
by the schedule.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Annotated

import orjson
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from estimation.errors import TreadwatchError
from estimation.values.reasons import EPOCH
from fleet_db.records import ChunkRecord, ChunkState
from ingest.logs.formats import SUFFIXES
from ingest.topic.client import Outcome, Topic, connected, kafka, require_client

if TYPE_CHECKING:
    from confluent_kafka import KafkaError, Message, Producer


@dataclass(frozen=True, slots=True)
class Refused:
    """A message of which nothing is taken: what it counts as, and why in a sentence."""

    outcome: Outcome
    text: str


VERSION = 1
MOST_BYTES = 4096  # of the value of a message; what is larger is no reference
MOST_NAME_LETTERS = 255
SHOWN = 200  # letters of what is wrong with a message that the log shows
_PRINTABLE = r"^[^\x00-\x1f\x7f]+$"


@dataclass(frozen=True, slots=True)
class Reference:
    """What a message says of a chunk."""

    digest: str
    suffix: str
    vehicle: str
    size_bytes: int
    file_name: str
    received_ns: int  # when it was received, ns UTC of the clock of whoever published the reference


class _Body(BaseModel):
    """Fields that a later minor release adds are ignored."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    format: Annotated[str, Field(pattern=r"^[a-z0-9]{1,8}$")]
    vehicle: Annotated[str, Field(pattern=_PRINTABLE, max_length=64)]
    size_bytes: Annotated[int, Field(ge=1, lt=1 << 63)]
    file_name: Annotated[str, Field(pattern=_PRINTABLE, max_length=MOST_NAME_LETTERS)]
    received_at: AwareDatetime


def reference_of(record: ChunkRecord) -> Reference | None:
    """Return the reference to a received chunk; None where it is no log, which no other place could take."""
    if record.suffix not in SUFFIXES:
        return None
    name = (record.file_name or f"{record.digest}{record.suffix}")[-MOST_NAME_LETTERS:]
    return Reference(record.digest, record.suffix, record.vehicle, record.size_bytes, name, record.received_ns)


def message_of(reference: Reference, fleet: str) -> tuple[bytes, bytes]:
    """Return key and value of the message of a reference; the fleet is empty where the vehicle is not registered."""
    body = {
        "version": VERSION,
        "sha256": reference.digest,
        "format": reference.suffix.removeprefix("."),
        "vehicle": reference.vehicle,
        "size_bytes": reference.size_bytes,
        "file_name": reference.file_name,
        "received_at": (EPOCH + timedelta(microseconds=reference.received_ns // 1000)).isoformat(),
    }
    return f"{fleet}:{reference.vehicle}".encode(), orjson.dumps(body)


def read_message(key: bytes | None, value: bytes | None) -> Reference | Refused:
    """Return the reference of a message, or why there is none."""
    if value is None or len(value) > MOST_BYTES:
        size = "no value" if value is None else f"{len(value):,} bytes, a reference has at most {MOST_BYTES:,}"
        return Refused(Outcome.MALFORMED, f"has {size}")
    try:
        document = orjson.loads(value)
    except orjson.JSONDecodeError as error:
        return Refused(Outcome.MALFORMED, f"is no JSON: {error}"[:SHOWN])
    version = document.get("version") if isinstance(document, dict) else None
    if type(version) is not int:
        return Refused(Outcome.MALFORMED, "is no object with a version")
    if version != VERSION:
        return Refused(Outcome.OTHER_VERSION, f"is of version {version}, this release reads version {VERSION}"[:SHOWN])
    try:
        body = _Body.model_validate_json(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        return Refused(Outcome.MALFORMED, f"{place}: {first['msg']}"[:SHOWN])
    return _of_its_key(key, body)


def as_text(reference: Reference) -> str:
    """Return a reference as it is kept in quarantine."""
    return message_of(reference, "")[1].decode()


def from_text(text: str) -> Reference | None:
    """Return the reference that was kept in quarantine; None where a later release wrote another version of it."""
    read = read_message(None, text.encode())
    return read if isinstance(read, Reference) else None


def _of_its_key(key: bytes | None, body: _Body) -> Reference | Refused:
    named = None if key is None else key.decode(errors="replace")
    if named is not None and not named.endswith(f":{body.vehicle}"):
        text = f"has the key {named[:SHOWN]!r} and names vehicle {body.vehicle!r}"
        return Refused(Outcome.CONTRADICTORY, text)
    suffix = f".{body.format}"
    if suffix not in SUFFIXES:
        return Refused(Outcome.MALFORMED, f"has the format {body.format!r}, none of {', '.join(SUFFIXES)}")
    received_ns = (body.received_at - EPOCH) // timedelta(microseconds=1) * 1000
    return Reference(body.sha256, suffix, body.vehicle, body.size_bytes, body.file_name, received_ns)


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
        fleet, until_s = self._fleets.get(vehicle, ("", 0.0))
        if time.monotonic() < until_s:
            return fleet
        try:
            fleet = self._fleet_of(vehicle)
        except TreadwatchError:  # not registered yet, or the database is away: the key only decides the partition
            return fleet
        if len(self._fleets) >= FLEETS_KEPT:
            self._fleets.clear()
        self._fleets[vehicle] = (fleet, time.monotonic() + FLEET_COUNTS_S)
        return fleet

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
