"""The mock cluster of librdkafka, which speaks the Kafka protocol over TCP to any client in any process.

The Python client has no functions for it; they are those of the header ``rdkafka_mock.h``, in the library that the
client has loaded.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from confluent_kafka import Consumer, Message, Producer, TopicPartition

from ingest.topic.client import GROUP, Topic

NAME = "treadwatch.chunks"
PRODUCER = 0
"""Kind of a client, as librdkafka counts them."""
BROKER = 1
PARTITION_UA = -1
"""Whichever the key gives."""
NUMBER_OF_A_PRODUCER, NOT_PERMITTED = 22, 31
"""A request of the protocol, and an error at which an idempotent producer refuses everything from then on."""
FAST = {"session.timeout.ms": "1500", "heartbeat.interval.ms": "300", "auto.commit.interval.ms": "100"}
POINTER = ctypes.c_void_p


def _library() -> ctypes.CDLL:
    found = re.search(r"\S*librdkafka\S*", Path("/proc/self/maps").read_text())
    assert found is not None
    library = ctypes.CDLL(found[0])
    signatures = {
        "rd_kafka_new": (POINTER, [ctypes.c_int, POINTER, ctypes.c_char_p, ctypes.c_size_t]),
        "rd_kafka_destroy": (None, [POINTER]),
        "rd_kafka_mock_cluster_new": (POINTER, [POINTER, ctypes.c_int]),
        "rd_kafka_mock_cluster_destroy": (None, [POINTER]),
        "rd_kafka_mock_cluster_bootstraps": (ctypes.c_char_p, [POINTER]),
        "rd_kafka_mock_topic_create": (ctypes.c_int, [POINTER, ctypes.c_char_p, ctypes.c_int, ctypes.c_int]),
        "rd_kafka_mock_group_initial_rebalance_delay_ms": (None, [POINTER, ctypes.c_int32]),
        "rd_kafka_mock_broker_set_down": (ctypes.c_int, [POINTER, ctypes.c_int32]),
        "rd_kafka_mock_broker_set_up": (ctypes.c_int, [POINTER, ctypes.c_int32]),
        "rd_kafka_mock_push_request_errors_array": (
            None,
            [POINTER, ctypes.c_int16, ctypes.c_size_t, ctypes.POINTER(ctypes.c_int)],
        ),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


@dataclass(frozen=True)
class MockCluster:
    """A cluster of one broker with one topic."""

    library: ctypes.CDLL
    handle: int
    servers: str

    def topic(self, **properties: str) -> Topic:
        named = {name.replace("_", "."): value for name, value in properties.items()}
        return Topic(self.servers, NAME, FAST | named)

    def down(self) -> None:
        """Close all connections, and refuse new ones; what the broker holds stays."""
        assert self.library.rd_kafka_mock_broker_set_down(self.handle, BROKER) == 0

    def up(self) -> None:
        """Listen again, on the same port."""
        assert self.library.rd_kafka_mock_broker_set_up(self.handle, BROKER) == 0

    def refuse(self, request: int, error: int) -> None:
        """Answer the next request of a kind with an error."""
        self.library.rd_kafka_mock_push_request_errors_array(self.handle, request, 1, (ctypes.c_int * 1)(error))

    def send(self, *messages: tuple[bytes | None, bytes | None]) -> None:
        """Produce messages as a gateway would, into the partitions of their keys."""
        self._send([(*message, PARTITION_UA) for message in messages])

    def spread(self, *messages: tuple[bytes | None, bytes | None]) -> None:
        """Produce messages into one partition after the other, whatever their keys are."""
        partitions = self.partitions()
        self._send([(*one, partitions[number % len(partitions)]) for number, one in enumerate(messages)])

    def _send(self, messages: Sequence[tuple[bytes | None, bytes | None, int]]) -> None:
        producer = Producer({"bootstrap.servers": self.servers, "log_level": 2})
        for key, value, partition in messages:
            producer.produce(NAME, value, key, partition)
        assert producer.flush(30) == 0

    def messages(self, count: int) -> Sequence[Message]:
        """Return so many messages of the topic, read from its begin by a group of its own."""
        consumer = Consumer(
            {"bootstrap.servers": self.servers, "group.id": "test", "auto.offset.reset": "earliest", "log_level": 2}
        )
        consumer.assign([TopicPartition(NAME, partition, 0) for partition in self.partitions()])
        try:
            found = consumer.consume(count, 30)
        finally:
            consumer.close()
        assert len(found) == count
        return found

    def partitions(self) -> Sequence[int]:
        return sorted(Producer({"bootstrap.servers": self.servers}).list_topics(NAME, 30).topics[NAME].partitions)

    def committed(self) -> int:
        """Return how many messages the group has committed, of all partitions."""
        consumer = Consumer({"bootstrap.servers": self.servers, "group.id": GROUP, "log_level": 2})
        try:
            found = consumer.committed([TopicPartition(NAME, one) for one in self.partitions()], 30)
        finally:
            consumer.close()
        return sum(max(0, one.offset) for one in found)


@contextmanager
def mock_cluster(partitions: int = 4) -> Iterator[MockCluster]:
    """Yield a cluster."""
    library, message = _library(), ctypes.create_string_buffer(512)
    client = library.rd_kafka_new(PRODUCER, None, message, len(message))
    assert client, message.value
    handle = library.rd_kafka_mock_cluster_new(client, 1)
    library.rd_kafka_mock_group_initial_rebalance_delay_ms(handle, 100)
    assert library.rd_kafka_mock_topic_create(handle, NAME.encode(), partitions, 1) == 0
    try:
        yield MockCluster(library, handle, library.rd_kafka_mock_cluster_bootstraps(handle).decode())
    finally:
        library.rd_kafka_mock_cluster_destroy(handle)
        library.rd_kafka_destroy(client)
