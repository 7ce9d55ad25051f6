"""References are published after the receipt, over TCP; a broker that is away costs nobody anything but references."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from kafka_cluster import NAME, NOT_PERMITTED, NUMBER_OF_A_PRODUCER, MockCluster, mock_cluster
from live_listening import eventually
from test_decoding_chunks import runs
from test_receiver import CountingClock
from vehicle_bus import VEHICLE, register

from estimation.errors import InputError, NotFoundError, PassingFaultError, StorageError
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.receipts import Arrival, Chunk, ChunkStorage
from ingest.receiver import Receiver
from ingest.topic.client import OURS, Topic, load_properties
from ingest.topic.references import Publisher, Sent

NOBODY = Topic("127.0.0.1:1", NAME)
"""Brokers at a port where nobody listens."""


@pytest.fixture(scope="module")
def shared_cluster() -> Iterator[MockCluster]:
    with mock_cluster() as cluster:
        yield cluster


def record(number: int, vehicle: str = "L-1") -> ChunkRecord:
    return Chunk(vehicle, ".blf", f"{number}.blf", None).receipt(f"{number:064x}", 10, 1_790_000_000_000_000_000)


def north(_vehicle: str) -> str:
    return "north"


def test_references_reach_the_topic_and_those_of_a_vehicle_one_partition() -> None:
    with mock_cluster() as cluster, closing(Publisher(cluster.topic(), north)) as publisher:
        for number in range(40):
            publisher.publish(record(number, f"L-{number % 5}"))
        publisher.publish(replace(record(99), state=ChunkState.DECODED))  # nobody needs it
        publisher.close()
        assert (publisher.ended, publisher.waiting) == ({Sent.PUBLISHED: 40, Sent.DROPPED: 0}, 0)
        found = cluster.messages(40)
    partitions: dict[bytes, set[int]] = {}
    for message in found:
        partitions.setdefault(message.key() or b"", set()).add(message.partition() or 0)
    assert sorted(partitions) == [f"north:L-{number}".encode() for number in range(5)]
    assert {len(one) for one in partitions.values()} == {1}
    digests = {json.loads(message.value() or b"")["sha256"] for message in found}
    assert digests == {f"{number:064x}" for number in range(40)}


@pytest.mark.parametrize("error", [NotFoundError("vehicle", "L-1"), StorageError("the database is away")])
def test_the_fleet_need_not_be_known(shared_cluster: MockCluster, error: Exception) -> None:
    def unknown(_vehicle: str) -> str:
        raise error

    with closing(Publisher(shared_cluster.topic(), unknown)) as publisher:
        publisher.publish(record(1, f"X-{type(error).__name__}"))
        publisher.close()
        assert publisher.ended[Sent.PUBLISHED] == 1


def test_a_fleet_is_looked_up_once_for_many_references(shared_cluster: MockCluster) -> None:
    asked: list[str] = []

    def fleet_of(vehicle: str) -> str:
        asked.append(vehicle)
        return "north"

    with closing(Publisher(shared_cluster.topic(), fleet_of)) as publisher:
        for number in range(20):
            publisher.publish(record(number, f"M-{number % 2}"))
        publisher.close()
    assert sorted(asked) == ["M-0", "M-1"]


def test_without_a_broker_a_bounded_number_waits_and_the_rest_is_dropped_and_counted() -> None:
    with closing(Publisher(NOBODY, north)) as publisher:
        for number in range(10_003):
            publisher.publish(record(number))
        assert (publisher.waiting, publisher.ended) == (10_000, {Sent.DROPPED: 3})
        publisher.close(timeout_s=0.2)
        assert (publisher.waiting, publisher.ended) == (0, {Sent.DROPPED: 10_003})
        publisher.publish(record(1))  # behind its end
        assert publisher.ended == {Sent.DROPPED: 10_004}


def test_a_reference_that_no_broker_takes_in_time_counts_as_failed(caplog: pytest.LogCaptureFixture) -> None:
    impatient = replace(NOBODY, properties={"message.timeout.ms": "100"})
    with caplog.at_level(logging.WARNING), closing(Publisher(impatient, north)) as publisher:
        for number in range(3):
            publisher.publish(record(number))
        eventually(lambda: publisher.ended[Sent.FAILED] == 3)
        assert publisher.waiting == 0
    said = [entry for entry in caplog.messages if "references do not reach" in entry]
    assert len(said) == 1  # not at every attempt
    assert any(f"3 references did not reach the topic {NAME}" in entry for entry in caplog.messages)


def test_references_that_waited_for_a_broker_are_published_when_it_is_back() -> None:
    with mock_cluster() as cluster, closing(Publisher(cluster.topic(), north)) as publisher:
        publisher.publish(record(0))
        eventually(lambda: publisher.ended[Sent.PUBLISHED] == 1)
        cluster.down()
        for number in range(1, 6):
            publisher.publish(record(number))
        eventually(lambda: publisher.waiting == 5)
        cluster.up()
        eventually(lambda: publisher.ended[Sent.PUBLISHED] == 6)
        assert len({message.value() for message in cluster.messages(6)}) == 6


def test_a_producer_that_the_brokers_refuse_for_good_is_replaced() -> None:
    with mock_cluster() as cluster:
        cluster.refuse(NUMBER_OF_A_PRODUCER, NOT_PERMITTED)
        with closing(Publisher(cluster.topic(), north)) as publisher:
            number = 0

            def published() -> bool:
                nonlocal number
                number += 1
                publisher.publish(record(number))
                return publisher.ended[Sent.PUBLISHED] > 0

            eventually(published)
            publisher.close()
            assert publisher.ended[Sent.FAILED] >= 1
            assert sum(publisher.ended.values()) == number


def test_a_chunk_is_announced_after_its_receipt_and_each_way_of_taking_it_does(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    announced: list[tuple[str, ChunkState | None]] = []

    def announce(receipt: ChunkRecord) -> None:
        found: list[ChunkRecord | None] = []

        def look() -> None:  # in a transaction of its own: it sees what is committed
            with sqlite_storage.read() as unit:
                found.append(unit.chunks.get(receipt.digest))

        thread = threading.Thread(target=look)
        thread.start()
        thread.join()
        announced.append((receipt.digest, None if found[0] is None else found[0].state))

    with sqlite_storage.write() as unit:
        register(unit)
    raw = FileRawStore(sqlite_storage.data_dir / "raw")
    first, second, third = runs(tmp_path, 3, seconds=3.0)
    receiver = Receiver(sqlite_storage, raw, default_catalogue(), CountingClock(), 2.0, announce=announce)
    one = receiver.receive_file(first, VEHICLE).record.digest
    two = receiver.keep(second.read_bytes(), ".blf", VEHICLE, "L-1__1")[0].digest
    chunks = ChunkStorage(sqlite_storage, raw, CountingClock(), announce)
    for _ in range(2):  # the second time it is known, and still waits
        with raw.incoming(".blf") as incoming:
            incoming.write(third.read_bytes())
            incoming.finish()
            chunks.store([Arrival(incoming, Chunk(VEHICLE, ".blf", third.name, None))])
    three = incoming.digest
    assert announced == [(digest, ChunkState.STORED) for digest in (one, two, three, three)]


def test_properties_come_from_a_file_but_none_on_which_safety_rests(tmp_path: Path) -> None:
    file = tmp_path / "kafka.properties"
    file.write_text("# TLS\nsecurity.protocol = SASL_SSL\n\nsasl.password=a=b#c\n")
    assert load_properties(file) == {"security.protocol": "SASL_SSL", "sasl.password": "a=b#c"}
    for name in sorted(OURS):
        file.write_text(f"log_level=3\n{name}=secret\n")
        with pytest.raises(InputError, match=r"kafka.properties:2: .* is set by treadwatch") as refused:
            load_properties(file)
        assert "secret" not in str(refused.value)
    file.write_text("sasl.password secret\n")
    with pytest.raises(InputError, match="no line name=value") as refused:
        load_properties(file)
    assert "secret" not in str(refused.value)
    with pytest.raises(InputError, match="cannot be read"):
        load_properties(tmp_path / "none")


@pytest.mark.parametrize("properties", [{"sasl.pasword": "secret"}, {"security.protocol": "secret"}])
def test_a_property_that_the_client_refuses_is_named_without_its_value(properties: dict[str, str]) -> None:
    with pytest.raises(InputError, match=f"the property {next(iter(properties))} of the Kafka client") as refused:
        Publisher(replace(NOBODY, properties=properties), north)
    assert "secret" not in str(refused.value)
    assert "secret" not in repr(replace(NOBODY, properties=properties))


def test_without_the_extra_there_is_one_clear_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(PassingFaultError, match=r"pip install 'treadwatch\[kafka\]'"):
        Publisher(NOBODY, north)
