"""A member of the group: it stays while it works or waits, and commits nothing of a partition that it has lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager

import pytest
from kafka_cluster import MockCluster
from live_listening import PATIENCE_S, eventually

from ingest.topic import client
from ingest.topic.client import ConsumerStatus, Received, Topic, TopicReader

MESSAGES = [(b"north:L-1", str(number).encode()) for number in range(8)]


@contextmanager
def reader_of(topic: Topic) -> Iterator[tuple[TopicReader, ConsumerStatus]]:
    status = ConsumerStatus()
    with closing(TopicReader(topic, status)) as reader:
        yield reader, status


@contextmanager
def another_member(cluster: MockCluster) -> Iterator[ConsumerStatus]:
    """Let a second member take part, in a thread of its own, that takes messages and commits none."""
    ending, status = threading.Event(), ConsumerStatus()

    def take_part() -> None:
        with closing(TopicReader(cluster.topic(), status)) as reader:
            while not ending.is_set():
                reader.next(0.1)

    thread = threading.Thread(target=take_part)
    thread.start()
    try:
        yield status
    finally:
        ending.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def first(reader: TopicReader) -> Received:
    until = time.monotonic() + PATIENCE_S
    while (message := reader.next(0.5)) is None:
        assert time.monotonic() < until
    return message


def test_a_member_that_works_at_a_message_takes_part_and_what_it_loses_it_does_not_commit(
    cluster: MockCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "STAY_EVERY_S", 0.0)
    cluster.spread(*MESSAGES)
    with reader_of(cluster.topic()) as (reader, status), ExitStack() as others:
        working = {message.partition: message for message in (first(reader) for _ in range(8))}
        assert (status.partitions, sorted(working)) == (4, [0, 1, 2, 3])
        another = others.enter_context(another_member(cluster))

        def shared() -> bool:
            reader.stay()  # between two chunks of the work
            return (status.partitions, another.partitions) == (2, 2)

        eventually(shared)
        lost = [one for one in working.values() if not reader.holds(one)]
        assert len(lost) == 2
        for message in working.values():
            reader.done(message)
        eventually(lambda: not reader.stay() and cluster.committed() == 4)  # two partitions of two messages
        others.close()  # its partitions come back, and their messages again

        def regained() -> bool:
            reader.stay()
            return status.partitions == 4

        eventually(regained)
        assert not any(reader.holds(one) for one in lost)
        again = [first(reader) for _ in range(4)]
        assert {one.partition for one in again} == {one.partition for one in lost}
        for message in again:
            reader.done(message)
    assert cluster.committed() == 8


def test_a_member_that_waits_fetches_nothing_and_leaves_nothing_out(cluster: MockCluster) -> None:
    with reader_of(cluster.topic()) as (reader, status):
        eventually(lambda: reader.next(0.1) is None and status.partitions == 4)
        sent = threading.Event()

        def stopped() -> bool:
            if not sent.is_set():
                cluster.spread(*MESSAGES)
                sent.set()
            return False

        reader.wait(1.0, stopped)
        assert len(reader._early) <= 1
        values = {first(reader).value for _ in range(8)}
    assert values == {value for _, value in MESSAGES}


def test_a_wait_ends_when_an_end_is_requested(cluster: MockCluster) -> None:
    with reader_of(cluster.topic()) as (reader, _):
        reader.wait(1e6, lambda: True)


def test_a_member_says_how_broker_and_topic_are_and_how_far_it_is_behind(cluster: MockCluster) -> None:
    with reader_of(cluster.topic()) as (reader, status):
        assert status.broker_fault == "not asked yet"
        cluster.spread(*MESSAGES)
        taken = [first(reader) for _ in range(3)]
        assert len(taken) == 3

        def five_behind() -> bool:
            reader.ask()
            return (status.broker_fault, status.behind_by) == (None, 5)

        eventually(five_behind)
        cluster.down()
        eventually(lambda: reader.next(0.1) is not None or status.broker_fault is not None)
        reader.ask()
        assert status.broker_fault is not None
        cluster.up()
        eventually(lambda: not reader.ask() and status.broker_fault is None)
    with reader_of(Topic(cluster.servers, "no.such.topic", {"allow.auto.create.topics": "false"})) as (reader, status):
        reader.ask()
        assert "Unknown topic" in (status.broker_fault or "")
