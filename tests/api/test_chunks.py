"""Chunks over HTTP: what is answered with a receipt is stored, nothing else is."""

from __future__ import annotations

import hashlib
import resource
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import httpx
import pytest
import running_service
from guarded_service import guarded_service
from service_process import service_process
from uploading import Upload, answer_of, connected, raw_files, storage_in, upload

from api.settings import Settings
from estimation.values.reasons import ReasonCode
from estimation.values.registry import VehicleRecord
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage

OCTETS = {"Content-Type": "application/octet-stream"}


@dataclass(frozen=True)
class Running:
    """A service with a client of it, and its storage."""

    url: str
    client: httpx.Client
    storage: SqlStorage
    folder: Path

    def measure(self, sample: str) -> float:
        """Return a measure of now, such as ``treadwatch_uploads_total{outcome="stored"}``."""
        for line in self.client.get("/metrics").text.splitlines():
            if line.startswith(f"{sample} "):
                return float(line.rpartition(" ")[2])
        raise AssertionError(sample)


@contextmanager
def served(folder: Path, url: str | None = None, **settings: object) -> Iterator[Running]:
    """Yield a service in a thread of this process."""
    given = {"data_dir": folder / "data", "port": 0, "database_url": url, "log_level": "warning", **settings}
    with (
        closing(storage_in(folder, url)) as storage,
        running_service.running(Settings.model_validate(given)) as address,
        httpx.Client(base_url=address, timeout=60.0) as client,
    ):
        yield Running(address, client, storage, folder)


@contextmanager
def started(folder: Path) -> Iterator[tuple[Running, subprocess.Popen[bytes]]]:
    """Yield a service that is a process of its own, which may be harmed."""
    with (
        closing(storage_in(folder)) as storage,
        service_process(folder) as service,
        httpx.Client(base_url=service.url, timeout=60.0) as client,
    ):
        yield Running(service.url, client, storage, folder), service.process


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Yield one service for the tests that leave nothing that the others would see."""
    with served(tmp_path_factory.mktemp("service"), max_chunk_mb=1) as found:
        yield found


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_a_chunk_has_its_receipt_and_its_bytes_when_it_is_answered(
    database: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    url = request.getfixturevalue("postgres_url") if database == "postgresql" else None
    one = upload(1)
    with served(tmp_path, url) as running:
        first = one.put(running.client)
        assert first.status_code == 201
        assert first.headers["location"] == f"/v1/chunks/{one.digest}"
        receipt = first.json()
        assert (receipt["sha256"], receipt["vehicle"], receipt["size_bytes"]) == (one.digest, "V-9", len(one.content))
        assert (receipt["state"], receipt["reason_code"]) == ("received", "waits_for_decoding")
        again = one.put(running.client)
        assert (again.status_code, again.json()) == (200, receipt)
        assert "location" not in again.headers
        assert running.client.get(f"/v1/chunks/{one.digest}").json() == receipt
        assert running.client.get(f"/v1/chunks/{'0' * 64}").status_code == 404
        assert raw_files(tmp_path) == [f"{one.digest}.blf"]
        assert (tmp_path / "data" / "raw" / one.digest[:2] / f"{one.digest}.blf").read_bytes() == one.content
        assert running.measure('treadwatch_uploads_total{outcome="stored"}') == 1.0
        assert running.measure('treadwatch_uploads_total{outcome="known"}') == 1.0
        assert running.measure("treadwatch_upload_bytes_total") == len(one.content)
        assert running.measure("treadwatch_chunks_waiting") == 1.0
        assert running.measure("treadwatch_chunks_waiting_bytes") == len(one.content)


def test_bytes_with_another_digest_leave_nothing(running: Running) -> None:
    one = upload(2)
    wrong = running.client.put(one.path, content=one.content[:-1], headers=OCTETS)
    assert wrong.status_code == 422
    assert wrong.json()["type"] == "urn:treadwatch:problem:digest-mismatch"
    assert hashlib.sha256(one.content[:-1]).hexdigest() in wrong.json()["detail"]
    assert not stored(running, one)
    assert running.client.get(f"/v1/chunks/{one.digest}").status_code == 404
    assert one.put(running.client).status_code == 201


def test_a_chunk_without_a_byte_is_refused(running: Running) -> None:
    empty = upload(0, 0)
    assert (empty.put(running.client).status_code, stored(running, empty)) == (422, False)


def test_a_chunk_that_comes_in_pieces_ends_where_its_last_piece_is_full(running: Running) -> None:
    """The end is said by itself, behind a piece that was written already."""
    one = upload(14, 900_000)
    pieces = [one.content[at : at + 300_000] for at in range(0, 900_000, 300_000)]
    assert running.client.put(one.path, content=iter(pieces), headers=OCTETS).status_code == 201
    assert stored(running, one)


def test_a_chunk_over_the_limit_is_refused_announced_or_not(running: Running) -> None:
    large, fits = upload(3, 1_000_001), upload(3, 1_000_000)
    assert large.put(running.client).status_code == 413
    body = (large.content[at : at + 65536] for at in range(0, len(large.content), 65536))
    chunked = running.client.put(large.path, content=body, headers=OCTETS)
    assert (chunked.status_code, chunked.json()["type"]) == (413, "urn:treadwatch:problem:content-too-large")
    assert not stored(running, large)
    assert fits.put(running.client).status_code == 201
    with connected(running.url) as connection:  # refused before a byte of the body is sent
        connection.sendall(large.head(10**12))
        assert answer_of(connection)[0] == 413


@pytest.mark.parametrize(
    ("query", "content_type", "status"),
    [
        ("vehicle=V-9&format=pdf", "application/octet-stream", 415),
        ("vehicle=V-9&format=blf", "application/json", 415),
        ("vehicle=V-9&format=BLF&file_name=a/b", "application/octet-stream", 422),
        ("vehicle=V-9", "application/octet-stream", 422),
        ("format=blf", "application/octet-stream", 422),
        ("vehicle=V-9&format=blf&file_name=../x", "application/octet-stream", 422),
    ],
)
def test_what_says_too_little_or_nonsense_of_a_chunk_is_refused(
    running: Running, query: str, content_type: str, status: int
) -> None:
    one = upload(4, 1000)
    headers = {"Content-Type": content_type}
    answer = running.client.put(f"/v1/chunks/{one.digest}?{query}", content=one.content, headers=headers)
    assert answer.status_code == status, answer.text
    assert not stored(running, one)


def test_the_same_chunk_from_many_at_the_same_time_is_stored_once(running: Running) -> None:
    one = upload(5, 500_000)
    ready = threading.Barrier(12)

    def send() -> int:
        with httpx.Client(base_url=running.url, timeout=60.0) as client:
            ready.wait()
            return one.put(client).status_code

    with ThreadPoolExecutor(12) as senders:
        statuses = [future.result() for future in [senders.submit(send) for _ in range(12)]]
    assert sorted(statuses) == [200] * 11 + [201]
    assert stored(running, one)


def test_a_chunk_of_another_vehicle_is_a_conflict(running: Running) -> None:
    one = upload(6)
    assert one.put(running.client).status_code == 201
    other = Upload(one.content, "V-8").put(running.client)
    assert other.status_code == 409
    assert "V-9" in other.json()["detail"]


def test_a_client_that_breaks_off_leaves_nothing(running: Running) -> None:
    one = upload(7, 900_000)
    with connected(running.url) as connection:
        connection.sendall(one.head(len(one.content)) + one.content[:300_000])
        eventually(lambda: running.measure("treadwatch_uploads_running") == 1.0)
    eventually(lambda: running.measure("treadwatch_uploads_running") == 0.0)
    assert not stored(running, one)
    assert running.measure('treadwatch_uploads_total{outcome="broken_off"}') == 1.0
    assert one.put(running.client).status_code == 201


def test_a_client_that_waits_for_leave_to_send_is_refused_before_it_sends(tmp_path: Path) -> None:
    one = upload(8)
    head = one.head(len(one.content)).replace(b"\r\n\r\n", b"\r\nExpect: 100-continue\r\n\r\n")
    with served(tmp_path, backlog_chunks=1) as running:
        assert upload(80).put(running.client).status_code == 201
        with connected(running.url) as connection:
            connection.sendall(head)
            status, text = answer_of(connection)
            assert (status, b"retry-after: 30" in text.lower()) == (503, True)


@pytest.mark.slow
def test_a_service_killed_in_the_middle_of_uploads_has_every_chunk_that_it_answered(tmp_path: Path) -> None:
    some = [upload(100 + number, 300_000) for number in range(200)]
    answered: list[str] = []

    def send(number: int, url: str) -> None:
        with httpx.Client(base_url=url, timeout=60.0) as client:
            for one in some[number::4]:
                try:
                    if one.put(client).status_code == 201:
                        answered.append(one.digest)
                except httpx.TransportError:
                    return

    with started(tmp_path) as (running, process):
        senders = [threading.Thread(target=send, args=(number, running.url)) for number in range(4)]
        for sender in senders:
            sender.start()
        eventually(lambda: len(answered) >= 20)
        process.kill()
        for sender in senders:
            sender.join(60)
    assert 20 <= len(answered) < len(some)
    with started(tmp_path) as (running, _):
        for digest in answered:
            assert running.client.get(f"/v1/chunks/{digest}").json()["state"] == "received"
            content = (tmp_path / "data" / "raw" / digest[:2] / f"{digest}.blf").read_bytes()
            assert hashlib.sha256(content).hexdigest() == digest
        statuses = {one.digest: one.put(running.client).status_code for one in some}  # senders send again
        assert {statuses[digest] for digest in answered} == {200}
        with running.storage.read() as unit:
            assert len(unit.chunks.with_state(ChunkState.STORED, 1000)) == len(some)


@pytest.mark.slow
def test_a_chunk_that_fits_on_no_disk_is_sent_again_later(tmp_path: Path) -> None:
    """A file may have 500 kB only: the disk of this service is full in the middle of a chunk."""
    small, large = upload(9, 100_000), upload(10, 900_000)
    with started(tmp_path) as (running, process):
        assert small.put(running.client).status_code == 201
        limit_files(process, 500_000)
        refused = large.put(running.client)
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "60")
        assert running.measure('treadwatch_uploads_behind_total{limit="storage"}') == 1.0
        assert raw_files(tmp_path) == [f"{small.digest}.blf"]
        assert running.client.get(f"/v1/chunks/{large.digest}").status_code == 404
        limit_files(process, resource.RLIM_INFINITY)
        assert large.put(running.client).status_code == 201


def limit_files(process: subprocess.Popen[bytes], size: int) -> None:
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


@pytest.mark.parametrize(
    ("setting", "value", "limit", "after"),
    [
        ("backlog_chunks", 2, "chunks", "30"),
        ("backlog_mb", 1, "bytes", "30"),
        ("free_disk_mb", 999_999_999, "disk", "60"),
    ],
)
def test_beyond_a_limit_chunks_are_refused_and_counted(
    tmp_path: Path, setting: str, value: int, limit: str, after: str
) -> None:
    with served(tmp_path, **{setting: value}) as running:
        statuses = []
        for number in range(3):
            answer = upload(20 + number, 450_000).put(running.client)
            statuses.append(answer.status_code)
        assert statuses == ([503] * 3 if limit == "disk" else [201, 201, 503])
        assert answer.headers["retry-after"] == after
        assert answer.json()["type"] == "urn:treadwatch:problem:overloaded"
        assert running.measure(f'treadwatch_uploads_behind_total{{limit="{limit}"}}') == statuses.count(503)
        assert len(raw_files(tmp_path)) == statuses.count(201)
        if limit == "disk":
            return
        with running.storage.write() as unit:  # a worker has decoded one
            unit.chunks.update(replace(unit.chunks.undecoded(1)[0], reason=None))
        eventually(lambda: upload(22, 450_000).put(running.client).status_code == 201)


def test_a_sender_is_held_to_its_fleets_and_named_in_the_receipt(tmp_path: Path) -> None:
    with guarded_service(tmp_path) as guarded:
        with guarded.storage.write() as unit:
            for fleet in ("alpha", "beta"):
                unit.registry.add_vehicle(VehicleRecord(f"V-{fleet}", fleet, "regional", 1, 40.0, (0.0,)))
        mine, theirs = upload(11, 1000, "V-alpha"), upload(11, 1000, "V-beta")
        key = guarded.key("train 7", fleet="alpha")
        assert mine.put(guarded.client).status_code == 401
        assert mine.put(guarded.client, **guarded.key(without="ingest")).status_code == 403
        assert theirs.put(guarded.client, **key).status_code == 404
        made = mine.put(guarded.client, **key)
        assert made.status_code == 201
        assert made.json()["sender"].startswith("train 7 (key ")
        other = theirs.put(guarded.client, **guarded.key(fleet="beta"))
        assert (other.status_code, "V-alpha" in other.text) == (409, False)
        assert guarded.client.get(f"/v1/chunks/{mine.digest}", headers=guarded.key(fleet="beta")).status_code == 404
        assert guarded.client.get(f"/v1/chunks/{mine.digest}", headers=key).json()["sender"] == made.json()["sender"]


def test_a_chunk_that_was_deleted_is_not_taken_again(running: Running) -> None:
    one = upload(12, 1000)
    assert one.put(running.client).status_code == 201
    assert running.client.delete(f"/v1/recordings/{one.digest}", params={"why": "a test bench"}).status_code == 200
    again = one.put(running.client)
    assert (again.status_code, "test bench" in again.json()["detail"]) == (409, True)
    assert running.client.get(f"/v1/chunks/{one.digest}").json()["state"] == "deleted"
    assert not stored(running, one)


def test_what_is_no_log_ends_in_quarantine_by_the_job_and_not_in_the_service(running: Running) -> None:
    one = upload(13, 1000)
    assert one.put(running.client).status_code == 201
    assert running.client.post("/v1/jobs/assemble_windows/runs").status_code == 202
    path = f"/v1/chunks/{one.digest}"
    eventually(lambda: running.client.get(path).json()["state"] == "quarantined")
    found = running.client.get(path).json()
    assert found["reason_code"] == ReasonCode.LOG_DAMAGED.value
    assert one.put(running.client).status_code == 200  # its bytes are kept


def stored(running: Running, one: Upload) -> bool:
    """Return whether a chunk is stored; nothing may be left half-way."""
    assert not unfinished(running)
    return f"{one.digest}.blf" in raw_files(running.folder)


def unfinished(running: Running) -> list[str]:
    return [name for name in raw_files(running.folder) if name.startswith(".")]


def eventually(condition: object, within_s: float = 30.0) -> None:
    assert callable(condition)
    until = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)
