"""Messages become receipts and windows: known or new, twice, wrong or too early, while database and backlog permit."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from kafka_cluster import MockCluster, mock_cluster
from live_listening import eventually
from raw_stores import Behind, in_bucket
from s3_server import running_s3_server
from test_decoding_chunks import hand_in, receiver_of, runs, windows
from topic_consumer import ROOM, Consumer, put, referred, sent
from vehicle_bus import VEHICLE, register

from estimation.errors import StorageError
from estimation.values.reasons import ReasonCode
from estimation.values.runs import QuarantineState, delay_s
from fleet_db.locks import decoding_locks
from fleet_db.raw import check_raw_store
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.topic import client, consuming, references
from ingest.topic.client import Outcome, Topic
from ingest.topic.consuming import MOST_ATTEMPTS, NEVER_NS, ReferenceTaking


@pytest.fixture
def cluster() -> Iterator[MockCluster]:
    with mock_cluster() as found:
        yield found


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a consumer look at what else waits, and try again, all the time."""
    monkeypatch.setattr(consuming, "LOOK_EVERY_S", 0.1)
    monkeypatch.setattr(consuming, "FIRST_DELAY_S", 0.02)


@pytest.fixture
def registered(storage: SqlStorage) -> SqlStorage:
    with storage.write() as unit:
        register(unit)
    return storage


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


@pytest.mark.usefixtures("quick")
def test_a_reference_that_overtakes_its_file_is_taken_once_the_file_is_there(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    consumer = Consumer(registered, cluster)
    path = runs(tmp_path, 1)[0]
    reference = referred(path)
    cluster.send(sent(reference))
    with consumer.running():
        consumer.until(missing=1)
        put(consumer.raw, path)
        # the clock of the test stands still: what is due is due at once after the first failure, and behind a retry
        with registered.write() as unit:
            unit.quarantine.retry()
        eventually(lambda: consumer.status.decoded == 1)
    item = consumer.held(reference)
    assert item is not None
    assert item.state is QuarantineState.RESOLVED


@pytest.mark.usefixtures("quick")
def test_a_gateway_may_put_chunks_into_a_folder_or_a_bucket(
    sqlite_storage: SqlStorage, cluster: MockCluster, tmp_path: Path, raw_behind: Behind
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    consumer = Consumer(sqlite_storage, cluster, store=raw_behind.store)
    late, torn, good = runs(tmp_path, 3, seconds=3.0)
    references = [referred(path) for path in (late, torn, good)]
    for reference, content in zip(references[1:], (torn.read_bytes()[:-1], good.read_bytes()), strict=True):
        raw_behind.write(reference.digest, ".blf", content)
    cluster.send(*map(sent, references))
    with consumer.running():
        consumer.until(missing=1, damaged=1, stored=1)
        for reference, path in zip(references, (late, torn), strict=False):
            raw_behind.write(reference.digest, ".blf", path.read_bytes())
        with sqlite_storage.write() as unit:
            unit.quarantine.retry()
        eventually(lambda: consumer.status.decoded == 3)
    found = [consumer.receipt(reference) for reference in references]
    assert [one.state for one in found if one is not None] == [ChunkState.DECODED] * 3


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_while_a_bucket_is_away_references_wait_and_none_is_quarantined(
    sqlite_storage: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    with running_s3_server() as server:
        behind = in_bucket(server, "waits", tmp_path, timeout_s=2.0)
        consumer = Consumer(sqlite_storage, cluster, store=behind.store)
        path = runs(tmp_path, 1, seconds=3.0)[0]
        reference = referred(path)
        behind.write(reference.digest, ".blf", path.read_bytes())
        check_raw_store(sqlite_storage, behind.store, 0)
        server.stop()
        cluster.send(sent(reference))
        with consumer.running():
            eventually(lambda: consumer.status.raw_fault is not None)
            assert consumer.status.outcomes.total() == 0
            server.start()
            consumer.until(stored=1)
    assert consumer.status.faults == {}
    assert consumer.held(reference) is None


def test_a_held_reference_is_tried_thirty_times_and_then_by_hand_only(storage: SqlStorage, tmp_path: Path) -> None:
    with mock_cluster() as cluster:
        consumer = Consumer(storage, cluster)
        path = tmp_path / "V-1__1.blf"
        path.write_bytes(b"a log")
        reference, taking = referred(path), consumer.taking()
        for attempt in range(1, MOST_ATTEMPTS + 1):
            with storage.write() as unit:
                unit.quarantine.retry()
            assert list(taking.held.due()) == ([] if attempt == 1 else [reference])
            assert taking.take(reference).outcome is Outcome.MISSING  # type: ignore[union-attr]
            item = consumer.held(reference)
            assert item is not None
            assert item.attempts == attempt
            assert (item.due_ns == NEVER_NS) == (attempt == 30)
        assert list(taking.held.due()) == []
        with storage.write() as unit:
            unit.quarantine.retry()
        assert list(taking.held.due()) == [reference]
        put(consumer.raw, path)
        assert taking.take(reference).outcome is Outcome.STORED  # type: ignore[union-attr]
        assert list(taking.held.due()) == []


def test_a_folder_that_is_not_mounted_lets_references_wait_and_quarantines_none(
    sqlite_storage: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    consumer = Consumer(sqlite_storage, cluster)
    first, second = runs(tmp_path, 2, seconds=3.0)
    hand_in(sqlite_storage, first)
    check_raw_store(sqlite_storage, consumer.raw, 0)
    reference = put(consumer.raw, second)
    away = consumer.raw.directory.with_name("unmounted")
    consumer.raw.directory.rename(away)
    consumer.raw.directory.mkdir()
    cluster.send(sent(reference))
    with consumer.running():
        eventually(lambda: "is it mounted?" in (consumer.status.raw_fault or ""))
        assert consumer.status.outcomes.total() == 0
        consumer.raw.directory.rmdir()
        away.rename(consumer.raw.directory)
        consumer.until(stored=1)
    assert consumer.status.faults == {}
    assert consumer.held(reference) is None


@dataclass(frozen=True)
class Failing(SqlStorage):
    """A database whose writing fails while the switch is on."""

    switch: list[bool] = None  # type: ignore[assignment]
    tried: list[int] = None  # type: ignore[assignment]

    @contextmanager
    def write(self, *, fenced: bool = True) -> Iterator[SqlUnitOfWork]:
        if self.switch[0]:
            self.tried.append(1)
            raise StorageError("the database is away")
        with super().write(fenced=fenced) as unit:
            yield unit


def failing(storage: SqlStorage) -> Failing:
    return Failing(storage.engine, storage.data_dir, switch=[True], tried=[])


@pytest.mark.usefixtures("quick")
def test_while_the_database_is_away_the_message_waits_and_then_it_is_taken(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    database = failing(registered)
    consumer = Consumer(database, cluster)
    references = [put(consumer.raw, path) for path in runs(tmp_path, 2, seconds=3.0)]
    cluster.send(*map(sent, references))
    with consumer.running():
        eventually(lambda: len(database.tried) >= 5)  # beyond the attempts after which it would be held
        assert consumer.status.faults == {"database": "the database is away"}
        assert consumer.status.outcomes.total() == 0
        assert cluster.committed() == 0
        database.switch[0] = False
        consumer.until(stored=2)
    assert consumer.status.faults == {}
    assert cluster.committed() == 2


@pytest.mark.usefixtures("quick")
def test_a_message_at_which_the_database_fails_for_good_is_held_and_the_next_gets_its_turn(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    consumer = Consumer(registered, cluster)
    bad, worse, good = (put(consumer.raw, path) for path in runs(tmp_path, 3, seconds=3.0))
    tried: list[str] = []
    new = ReferenceTaking._new

    def poisoned(self: ReferenceTaking, reference: object) -> object:
        if reference == bad:
            tried.append("bad")
            raise StorageError("this one")
        if reference == worse:
            tried.append("worse")
            raise ZeroDivisionError("that one")
        return new(self, reference)  # type: ignore[arg-type]

    monkeypatch.setattr(ReferenceTaking, "_new", poisoned)
    cluster.send(sent(bad), sent(worse), sent(good))
    with consumer.running():
        consumer.until(failed=2, stored=1)
    assert tried.count("bad") >= 3
    items = [consumer.held(one) for one in (bad, worse, good)]
    assert [None if one is None else one.code for one in items] == [
        ReasonCode.WAITS_FOR_STORAGE,
        ReasonCode.PROCESSING_FAILED,
        None,
    ]
    assert cluster.committed() == 3


@pytest.mark.usefixtures("quick")
def test_new_receipts_wait_while_too_much_is_not_decoded_and_it_is_decoded_meanwhile(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    waiting, coming = runs(tmp_path, 2, seconds=3.0)
    hand_in(registered, waiting)
    consumer = Consumer(registered, cluster, replace(ROOM, chunks=1))
    reference = put(consumer.raw, coming)
    with (
        decoding_locks(registered.engine, "another") as try_vehicle,
        try_vehicle(VEHICLE) as locked,
        consumer.running(),
    ):
        assert locked
        cluster.send(sent(reference))
        eventually(lambda: "1 chunks wait to be decoded, 1 may" in (consumer.status.behind or ""))
        assert consumer.receipt(reference) is None
        assert consumer.status.outcomes.total() == 0
        assert consumer.status.faults == {}
    assert cluster.committed() == 0
    again = Consumer(registered, cluster, replace(ROOM, chunks=1))
    with again.running():  # it decodes what keeps the receipt out
        again.until(stored=1)
        assert again.status.behind is None
    assert again.status.decoded == 2


@pytest.mark.usefixtures("quick")
def test_a_full_disk_lets_new_receipts_wait_and_nothing_is_decoded(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    consumer = Consumer(registered, cluster, replace(ROOM, free_bytes=1 << 60))
    reference = put(consumer.raw, runs(tmp_path, 1, seconds=3.0)[0])
    cluster.send(sent(reference))
    with consumer.running():
        eventually(lambda: "stay free" in (consumer.status.behind or ""))
        assert consumer.status.outcomes.total() == 0
    assert cluster.committed() == 0


@pytest.mark.usefixtures("quick")
def test_without_messages_a_consumer_decodes_what_else_waits(
    registered: SqlStorage, cluster: MockCluster, tmp_path: Path
) -> None:
    hand_in(registered, *runs(tmp_path, 2, seconds=3.0))  # their references were dropped
    consumer = Consumer(registered, cluster)
    with consumer.running():
        eventually(lambda: consumer.status.decoded == 2)
    assert consumer.status.outcomes.total() == 0


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
