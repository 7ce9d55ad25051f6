"""Commands over one mock cluster: each way of taking a chunk publishes; consumers are killed and lose nothing."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from in_process_command import Run
from kafka_cluster import FAST, NAME, MockCluster
from live_listening import eventually
from rich.console import Console
from service_process import service_process
from test_decoding_chunks import LENGTH_S, hand_in, receiver_of, runs, windows
from topic_consumer import put, referred, sent
from uploading import storage_in, upload
from vehicle_bus import VEHICLE, register

from api.settings import Settings
from api.terminal.live import _Stores
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

ROOT = Path(__file__).parents[2]
START_S = 60.0


@dataclass(frozen=True)
class ConsumerProcess:
    """A consumer as a process of its own."""

    process: subprocess.Popen[bytes]
    log: Path

    def ask(self, path: str) -> tuple[int, str]:
        """Return status and body of an answer of its health port."""
        try:
            with urllib.request.urlopen(f"{self._url()}{path}", timeout=10) as answer:  # noqa: S310 - our own
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def measure(self, sample: str) -> float:
        """Return a measure of now."""
        found = re.search(rf"^{re.escape(sample)} (\S+)$", self.ask("/metrics")[1], re.MULTILINE)
        assert found is not None, sample
        return float(found[1])

    def _url(self) -> str:
        until = time.monotonic() + START_S
        while (found := re.search(r"health and metrics at (http://\S+:\d+)", self.log.read_text())) is None:
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < until, self.log.read_text()
            time.sleep(0.05)
        return found[1]


def environment(folder: Path, cluster: MockCluster, url: str, **more: str) -> dict[str, str]:
    """Return the settings of a deployment, without their prefix, with a properties file in the folder."""
    file = folder / "kafka.properties"
    file.write_text("".join(f"{name}={value}\n" for name, value in FAST.items()))
    return {
        "DATABASE_URL": url,
        "DATA_DIR": str(folder / "data"),
        "WINDOW_LENGTH_S": str(LENGTH_S),
        "KAFKA_SERVERS": cluster.servers,
        "KAFKA_PROPERTIES": str(file),
        **more,
    }


@contextmanager
def consumer(folder: Path, name: str, given: dict[str, str]) -> Iterator[ConsumerProcess]:
    """Yield a consumer that is killed at the end, unless it has ended by then."""
    file = folder / f"{name}.log"
    command = [sys.executable, "-c", "from api.cli import main; main()", "chunk", "consume", "--health-port", "0"]
    variables = {f"TREADWATCH_{key}": value for key, value in given.items()}
    with file.open("wb") as log:
        process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT), **variables}, stderr=log)
    try:
        yield ConsumerProcess(process, file)
    finally:
        process.kill()
        process.wait(120)


@pytest.fixture
def deployment(storage_url: str, tmp_path: Path) -> Iterator[SqlStorage]:
    """Yield the registered storage of the processes."""
    with closing(SqlStorage(database_engine(storage_url), tmp_path / "data")) as storage:
        with storage.write() as unit:
            register(unit)
        yield storage


def decoded(storage: SqlStorage) -> int:
    with storage.read() as unit:
        return len(unit.chunks.with_state(ChunkState.DECODED, 1000))


@pytest.mark.slow
def test_a_consumer_that_is_killed_is_followed_by_another_and_nothing_is_lost_or_doubled(
    deployment: SqlStorage, storage_url: str, cluster: MockCluster, tmp_path: Path
) -> None:
    given = environment(tmp_path, cluster, storage_url)
    paths = runs(tmp_path, 10, seconds=1.0)
    hand_in(deployment, *paths[:3])
    raw = FileRawStore(deployment.data_dir / "raw")
    cluster.spread(*(sent(referred(path)) for path in paths[:3]), *(sent(put(raw, path)) for path in paths[3:]))
    with consumer(tmp_path, "first", given) as first:
        eventually(lambda: decoded(deployment) >= 3)
        first.process.send_signal(signal.SIGKILL)
        first.process.wait(120)
    assert decoded(deployment) < 10
    assert cluster.committed() < 10
    with consumer(tmp_path, "second", given) as second:
        eventually(lambda: decoded(deployment) == 10 and cluster.committed() == 10)
        assert second.ask("/healthz")[0] == 200
        code, ready = second.ask("/readyz")
        assert (code, json.loads(ready)["partitions"]) == (200, 4)
        outcomes = {one: second.measure(f'treadwatch_consumer_messages_total{{outcome="{one}"}}') for one in OUTCOMES}
        assert outcomes["stored"] + outcomes["known"] == sum(outcomes.values()) > 0
        assert second.measure('treadwatch_consumer_up{what="broker"}') == 1.0
        assert second.measure("treadwatch_consumer_last_reference_age_seconds") >= 0.0
        second.process.send_signal(signal.SIGTERM)
        assert second.process.wait(120) == 0
    made = windows(deployment)
    assert made
    receiver = receiver_of(deployment)
    assert sum(receiver.receive_file(path, VEHICLE).windows_changed for path in paths) == 0
    assert windows(deployment) == made


OUTCOMES = (
    "stored",
    "known",
    "missing",
    "damaged",
    "failed",
    "other_vehicle",
    "deleted",
    "malformed",
    "other_version",
    "contradictory",
)


@pytest.mark.slow
def test_a_consumer_whose_broker_is_away_says_so_goes_on_and_ends_when_asked(
    sqlite_url: str, cluster: MockCluster, tmp_path: Path
) -> None:
    given = environment(tmp_path, cluster, sqlite_url, SHUTDOWN_TIMEOUT_S="20")
    cluster.down()
    with consumer(tmp_path, "alone", given) as alone:
        eventually(lambda: "broker" in json.loads(alone.ask("/readyz")[1])["faults"])
        assert alone.ask("/readyz")[0] == 503
        assert alone.ask("/healthz")[0] == 200
        cluster.up()
        eventually(lambda: alone.ask("/readyz")[0] == 200)
        cluster.down()
        alone.process.send_signal(signal.SIGTERM)
        assert alone.process.wait(120) == 0
        assert "in the middle of a chunk" not in alone.log.read_text()


def published(cluster: MockCluster, count: int) -> list[tuple[str, str, str]]:
    """Return key, vehicle and file name of the references on the topic."""
    found = []
    for message in cluster.messages(count):
        body = json.loads(message.value() or b"")
        found.append(((message.key() or b"").decode(), body["vehicle"], body["file_name"]))
    return sorted(found)


def measured(client: httpx.Client, sample: str) -> float:
    found = re.search(rf"^{re.escape(sample)} (\S+)$", client.get("/metrics").text, re.MULTILINE)
    assert found is not None, sample
    return float(found[1])


@pytest.mark.slow
def test_uploads_publish_and_do_not_wait_for_a_broker_that_is_away(cluster: MockCluster, tmp_path: Path) -> None:
    done = 'treadwatch_references_total{outcome="published"}'
    one, two, three = upload(1, 1000), upload(2, 1000), upload(3, 1000)
    with (
        closing(storage_in(tmp_path)),
        service_process(tmp_path, KAFKA_SERVERS=cluster.servers) as service,
        httpx.Client(base_url=service.url, timeout=60.0) as client,
    ):
        assert one.put(client).status_code == 201
        eventually(lambda: measured(client, done) == 1.0)
        cluster.down()
        assert two.put(client).status_code == 201
        assert two.put(client).status_code == 200  # known, and still waits: its reference may have been lost
        assert measured(client, "treadwatch_references_waiting") == 2.0
        assert measured(client, done) == 1.0
        cluster.up()
        eventually(lambda: measured(client, done) == 3.0)
        assert three.put(client).status_code == 201
        service.process.terminate()  # what was just received is published before the end
        assert service.process.wait(120) == 0
    digests = sorted(json.loads(message.value() or b"")["sha256"] for message in cluster.messages(4))
    assert digests == sorted(each.digest for each in (one, two, two, three))


def test_the_drop_folder_and_the_ingest_of_files_publish(
    treadwatch: Run, sqlite_url: str, cluster: MockCluster, tmp_path: Path
) -> None:
    given = {name.lower(): value for name, value in environment(tmp_path, cluster, sqlite_url).items()}
    with closing(SqlStorage(database_engine(sqlite_url), tmp_path / "data")) as storage, storage.write() as unit:
        register(unit)
    first, second, third = runs(tmp_path, 3, seconds=2.0)
    folder = tmp_path / "drop"
    folder.mkdir()
    (folder / "NEW-1__7.blf").write_bytes(first.read_bytes())
    assert treadwatch("chunk", "drop", folder, "--quiet-s", 0, "--once", **given).returncode == 0
    assert treadwatch("ingest", second, third, **given).returncode == 0
    assert treadwatch("ingest", second, **given).returncode == 0  # decoded already: nobody needs a reference
    assert published(cluster, 3) == [
        (":NEW-1", "NEW-1", "NEW-1__7.blf"),
        (f"north:{VEHICLE}", VEHICLE, second.name),
        (f"north:{VEHICLE}", VEHICLE, third.name),
    ]


def test_the_receiver_of_a_live_bus_publishes(sqlite_url: str, cluster: MockCluster, tmp_path: Path) -> None:
    given = {f"{name.lower()}": value for name, value in environment(tmp_path, cluster, sqlite_url).items()}
    stores = _Stores(Settings(_env_file=None, **given), (), None, Console())  # type: ignore[arg-type]
    content = runs(tmp_path, 1, seconds=2.0)[0].read_bytes()
    stores.connect().keep(content, ".blf", "L-1", "L-1__7")
    assert stores.references is not None
    stores.references.close()
    stores.close()
    assert published(cluster, 1) == [(":L-1", "L-1", "L-1__7.blf")]


def test_a_consumer_needs_brokers_and_names_a_property_that_is_wrong_without_its_value(
    treadwatch: Run, sqlite_url: str, tmp_path: Path
) -> None:
    refused = treadwatch("chunk", "consume", database_url=sqlite_url)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "TREADWATCH_KAFKA_SERVERS" in refused.stderr
    file = tmp_path / "kafka.properties"
    file.write_text("sasl.pasword=secret\n")
    for command in (["chunk", "consume"], ["ingest", tmp_path], ["serve"]):
        wrong = treadwatch(*command, database_url=sqlite_url, kafka_servers="127.0.0.1:1", kafka_properties=str(file))
        assert wrong.returncode == 2
        assert "TREADWATCH_KAFKA_PROPERTIES" in wrong.stderr
        assert "sasl.pasword" in wrong.stderr
        assert "secret" not in wrong.stderr


def test_the_topic_has_a_name_that_brokers_take(treadwatch: Run, sqlite_url: str) -> None:
    refused = treadwatch(
        "chunk", "consume", database_url=sqlite_url, kafka_servers="127.0.0.1:1", kafka_topic="a topic"
    )
    assert "TREADWATCH_KAFKA_TOPIC" in refused.stderr
    assert Settings.model_fields["kafka_topic"].default == NAME
