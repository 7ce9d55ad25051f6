"""Messages become receipts and windows: known or new, twice, wrong or too early, while database and backlog permit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from kafka_cluster import MockCluster, mock_cluster
from live_listening import eventually
from test_decoding_chunks import hand_in, receiver_of, runs, windows
from topic_consumer import Consumer, put, referred, sent
from vehicle_bus import VEHICLE

from estimation.values.reasons import ReasonCode
from estimation.values.runs import delay_s
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.topic import client, consuming, references
from ingest.topic.client import Outcome, Topic
from ingest.topic.consuming import MOST_ATTEMPTS


def test_a_known_chunk_is_decoded_and_its_offset_committed(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    paths = runs(tmp_path, 3)
    hand_in(registered, *paths)
    consumer = Consumer(registered, cluster)
    cluster.send(*(sent(referred(path)) for path in paths))
    with consumer.running():
        consumer.until(known=3)
    assert (consumer.status.decoded, consumer.status.not_decoded) == (3, 0)
    assert cluster.committed() == 3
    made = windows(registered)
    assert made
    receiver = receiver_of(registered)
    assert [receiver.receive_file(path, VEHICLE).windows_changed for path in paths] == [0, 0, 0]


def test_a_chunk_that_a_gateway_put_into_the_raw_store_gets_its_receipt(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    consumer = Consumer(registered, cluster)
    path = runs(tmp_path, 1)[0]
    reference = put(consumer.raw, path)
    cluster.send(sent(reference), sent(reference), sent(reference, fleet=""))
    with consumer.running():
        consumer.until(stored=1, known=2)
    record = consumer.receipt(reference)
    assert record is not None
    assert (record.state, record.vehicle, record.size_bytes) == (ChunkState.DECODED, VEHICLE, reference.size_bytes)
    assert (record.file_name, record.sender) == (path.name, "topic of the test")
    assert record.received_ns != reference.received_ns  # our time, not that of others
    assert consumer.status.decoded == 1
    assert cluster.committed() == 3


def test_messages_of_others_each_have_their_outcome_and_harm_nothing(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    consumer = Consumer(registered, cluster)
    good, known, deleted, damaged, large, absent = runs(tmp_path, 6, seconds=3.0)
    references = [put(consumer.raw, path) for path in (good, damaged, large)]
    consumer.raw.path(references[1].digest, ".blf").write_bytes(b"x" * references[1].size_bytes)
    hand_in(registered, known, deleted)
    with registered.write() as unit:
        record = unit.chunks.get(referred(deleted).digest)
        assert record is not None
        unit.chunks.update(replace(record, state=ChunkState.DELETED))
    body = json.loads(sent(references[0])[1])
    cluster.send(
        (b"north:N-7", b"\x00\xff"),
        (b"north:N-7", None),
        (None, b"x" * 900_000),
        (b"north:N-7", json.dumps({**body, "version": 2}).encode()),
        (b"north:N-8", sent(references[0])[1]),
        sent(replace(referred(known), vehicle="N-8")),
        sent(referred(deleted)),
        sent(references[1]),
        sent(replace(references[2], size_bytes=references[2].size_bytes + 1)),
        sent(referred(absent)),
        sent(references[0]),
    )
    with consumer.running():
        consumer.until(
            malformed=3, other_version=1, contradictory=1, other_vehicle=1, deleted=1, damaged=2, missing=1, stored=1
        )
    assert cluster.committed() == 11
    kept = {name: consumer.held(one) for name, one in zip("dla", [*references[1:], referred(absent)], strict=True)}
    assert {name: None if one is None else one.code for name, one in kept.items()} == dict.fromkeys(
        "dla", ReasonCode.WAITS_FOR_STORAGE
    )
    reasons = {name: "" if one is None else one.error for name, one in kept.items()}
    assert all(f"a reference names this chunk of vehicle {VEHICLE}: " in one for one in reasons.values())
    assert "has another digest" in reasons["d"]
    assert f"has {references[2].size_bytes} bytes, not {references[2].size_bytes + 1}" in reasons["l"]
    assert "is missing" in reasons["a"]
    with registered.read() as unit:
        assert unit.chunks.get(references[1].digest) is None
        assert unit.chunks.get(referred(absent).digest) is None
        other = unit.chunks.get(referred(known).digest)
    assert other is not None
    assert other.vehicle == VEHICLE


def test_two_consumers_share_the_partitions_and_take_each_chunk_once(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    one, two = Consumer(registered, cluster, name="one"), Consumer(registered, cluster, name="two")
    paths = runs(tmp_path, 8, seconds=3.0)
    references = [put(one.raw, path) for path in paths]
    with one.running(), two.running():
        eventually(lambda: (one.status.partitions, two.status.partitions) == (2, 2))
        cluster.spread(*map(sent, references))
        eventually(lambda: cluster.committed() == 8)
        eventually(lambda: one.status.decoded + two.status.decoded == 8)
    assert one.status.outcomes.total() > 0
    assert two.status.outcomes.total() > 0
    taken = one.status.outcomes + two.status.outcomes
    assert taken[Outcome.STORED] == 8
    assert set(taken) <= {Outcome.STORED, Outcome.KNOWN}  # a message may come again where a partition moves
    assert [found.state for each in references if (found := one.receipt(each))] == [ChunkState.DECODED] * 8


def test_a_broker_that_restarts_loses_and_doubles_nothing(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    consumer = Consumer(registered, cluster)
    first, second = (put(consumer.raw, path) for path in runs(tmp_path, 2, seconds=3.0))
    cluster.send(sent(first))
    with consumer.running():
        consumer.until(stored=1)
        eventually(lambda: cluster.committed() == 1)
        cluster.down()
        eventually(lambda: consumer.status.broker_fault is not None)
        assert consumer.status.alive
        cluster.up()
        cluster.send(sent(second))
        consumer.until(stored=2)
    assert consumer.status.faults == {}
    assert cluster.committed() == 2


def test_a_cluster_that_has_lost_everything_gives_messages_again_and_nothing_changes(
    registered: SqlStorage, tmp_path: Path
) -> None:
    paths = runs(tmp_path, 2, seconds=3.0)
    with mock_cluster() as cluster:
        consumer = Consumer(registered, cluster)
        references = [put(consumer.raw, path) for path in paths]
        cluster.send(*map(sent, references))
        with consumer.running():
            consumer.until(stored=2)
    made = windows(registered)
    with mock_cluster() as cluster:
        again = Consumer(registered, cluster)
        cluster.send(*map(sent, references))
        with again.running():
            again.until(known=2)
    assert again.status.decoded == 0
    assert windows(registered) == made


def test_the_bounds_are_as_documented() -> None:
    assert (consuming.MOST_ATTEMPTS, consuming.HELD_AT_ONCE, consuming.ATTEMPTS) == (30, 100, 3)
    assert (client.STAY_EVERY_S, references.CLOSE_S, consuming.LOOK_EVERY_S) == (10.0, 5.0, 5.0)
    waited_s = sum(delay_s(ReasonCode.WAITS_FOR_STORAGE, attempts) for attempts in range(1, MOST_ATTEMPTS))
    assert round(waited_s / 3600) == 23
    topic = Topic("kafka-1:9092", "t", {"session.timeout.ms": "6000"})
    assert topic.producer()["message.timeout.ms"] == 300_000
    assert topic.producer()["enable.idempotence"] is True
    consumer = topic.consumer()
    assert (consumer["session.timeout.ms"], Topic("x", "t").consumer()["session.timeout.ms"]) == ("6000", 10_000)
    assert (consumer["queued.max.messages.kbytes"], consumer["group.id"]) == (1024, "treadwatch")
    assert (consumer["enable.auto.offset.store"], consumer["auto.offset.reset"]) == (False, "earliest")
