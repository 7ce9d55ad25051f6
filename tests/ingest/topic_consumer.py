"""Consumers of a mock cluster in threads of the test's process, with a gateway that puts files into their raw store."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from kafka_cluster import MockCluster
from live_listening import eventually
from test_receiver import CountingClock
from vehicle_bus import CATALOGUE, VEHICLE

from estimation.values.runs import Quarantined, SubjectKind
from fleet_db.raw import FileRawStore, RawStore
from fleet_db.records import ChunkRecord
from fleet_db.storage import SqlStorage
from ingest.intake.backlog import BacklogLimits, BacklogWatch, decode_received
from ingest.receiver import Receiver
from ingest.topic.client import ConsumerStatus, Outcome, TopicReader
from ingest.topic.consuming import STAGE, Consuming, ReferenceTaking
from ingest.topic.references import Reference, message_of

ROOM = BacklogLimits(chunks=1000, size_bytes=1 << 30, free_bytes=0)
LENGTH_S = 5.0
RECEIVED_NS = 1_800_000_000_000_000_000


@dataclass
class Consumer:
    """A consumer over a storage."""

    storage: SqlStorage
    cluster: MockCluster
    limits: BacklogLimits = ROOM
    name: str = "the test"
    clock: CountingClock = field(default_factory=CountingClock)
    status: ConsumerStatus = field(default_factory=ConsumerStatus)
    stop: threading.Event = field(default_factory=threading.Event)
    failures: list[Exception] = field(default_factory=list)
    store: RawStore | None = None
    """Of raw recordings; by default the folder of the storage."""

    @property
    def raw(self) -> FileRawStore:
        return FileRawStore(self.storage.data_dir / "raw")

    def taking(self) -> ReferenceTaking:
        raw = self.store or self.raw
        backlog = BacklogWatch(self.storage, raw.receiving, self.limits)
        return ReferenceTaking(self.storage, raw, self.clock, backlog, "topic of the test")

    def run(self) -> None:
        raw = self.store or self.raw
        receiver = Receiver(self.storage, raw, CATALOGUE, self.clock, window_length_s=LENGTH_S)
        reader = TopicReader(self.cluster.topic(), self.status)
        decode = partial(decode_received, self.storage, receiver, self.name)
        try:
            Consuming(reader, self.taking(), decode, self.status, self.stop.is_set).run()
        except Exception as error:  # noqa: BLE001 - for the test to look at
            self.failures.append(error)
        finally:
            reader.close()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Consume until the block ends; what it has done by then is committed."""
        thread = threading.Thread(target=self.run)
        self.status.thread = thread
        thread.start()
        try:
            yield
        finally:
            self.stop.set()
            thread.join(60.0)
            assert not thread.is_alive()
            assert self.failures == []

    def until(self, **outcomes: int) -> None:
        """Wait until messages have ended so, and no other way."""
        wanted = {Outcome(name): count for name, count in outcomes.items()}
        eventually(lambda: self.status.outcomes.total() >= sum(wanted.values()))
        assert +self.status.outcomes == wanted

    def held(self, reference: Reference) -> Quarantined | None:
        with self.storage.read() as unit:
            return unit.quarantine.get(SubjectKind.RECORDING, reference.digest, STAGE)

    def receipt(self, reference: Reference) -> ChunkRecord | None:
        with self.storage.read() as unit:
            return unit.chunks.get(reference.digest)


def referred(path: Path, vehicle: str = VEHICLE) -> Reference:
    """Return the reference to a file."""
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    return Reference(digest, path.suffix, vehicle, len(content), path.name, RECEIVED_NS)


def put(raw: FileRawStore, path: Path) -> Reference:
    """Put a file into the raw store, as a gateway does, and return its reference."""
    reference = referred(path)
    target = raw.path(reference.digest, reference.suffix)
    target.parent.mkdir(parents=True, exist_ok=True)
    (target.parent / f".{target.name}").write_bytes(path.read_bytes())
    (target.parent / f".{target.name}").rename(target)
    return reference


def sent(reference: Reference, fleet: str = "north") -> tuple[bytes, bytes]:
    """Return the message of a reference."""
    return message_of(reference, fleet)
