"""References wait while the raw store, the database or the backlog does not permit them, and none is lost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from kafka_cluster import MockCluster, mock_cluster
from live_listening import eventually
from raw_stores import Behind, in_bucket
from s3_server import running_s3_server
from test_decoding_chunks import hand_in, runs
from topic_consumer import ROOM, Consumer, put, referred, sent
from vehicle_bus import VEHICLE, register

from estimation.errors import StorageError
from estimation.values.reasons import ReasonCode
from estimation.values.runs import QuarantineState
from fleet_db.locks import decoding_locks
from fleet_db.raw import check_raw_store
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.topic.client import Outcome
from ingest.topic.consuming import MOST_ATTEMPTS, NEVER_NS, ReferenceTaking


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
