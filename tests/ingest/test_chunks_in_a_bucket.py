"""A service process and an S3 server: chunks over HTTP become receipts and windows, through outages and kills."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from each_store import recordings
from in_process_command import Run
from obstore.store import S3Store
from s3_server import SECRET_KEY, S3Server, running_s3_server
from service_process import ServiceProcess, service_process, wait_for
from test_reassembly import made_of
from uploading import Upload, storage_in, upload
from vehicle_bus import VEHICLE, register

from fleet_db.raw import MARK_NAME
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage


@dataclass(frozen=True)
class Deployment:
    """A service whose raw recordings are in a bucket."""

    process: ServiceProcess
    client: httpx.Client
    storage: SqlStorage
    folder: Path
    objects: S3Store

    def names(self) -> list[str]:
        """Return the recordings in the bucket."""
        found = (meta["path"] for page in self.objects.list() for meta in page)
        return sorted(name for name in found if name != MARK_NAME)

    def receipts(self) -> set[str]:
        with self.storage.read() as unit:
            return {one.digest for state in ChunkState for one in unit.chunks.with_state(state)}

    def left(self) -> list[Path]:
        """Return what is on this machine of recordings."""
        return [*(self.folder / "data" / "receiving").glob("*"), *(self.folder / "data").glob("raw")]


@contextmanager
def deployed(
    server: S3Server, folder: Path, monkeypatch: pytest.MonkeyPatch, url: str | None = None, prefix: str = ""
) -> Iterator[Deployment]:
    """Yield a running service; commands that a test runs are of the same deployment."""
    prefix = prefix or uuid.uuid4().hex
    folder.mkdir(exist_ok=True)
    given = {"TREADWATCH_S3_TIMEOUT_S": "2", "TREADWATCH_WINDOW_LENGTH_S": "10"}
    given["TREADWATCH_DATA_DIR"] = str(folder / "data")
    for name, value in (server.environment(prefix) | given).items():
        monkeypatch.setenv(name, value)
    with (
        closing(storage_in(folder, url)) as storage,
        service_process(folder, url) as process,
        httpx.Client(base_url=process.url, timeout=60.0) as client,
    ):
        yield Deployment(process, client, storage, folder, server.objects(prefix))
        assert SECRET_KEY not in process.log


def name_of(one: Upload) -> str:
    return f"{one.digest[:2]}/{one.digest}.blf"


def eventually(condition: Callable[[], object], within_s: float = 60.0) -> None:
    until = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.slow
def test_chunks_become_windows(s3_server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with deployed(s3_server, tmp_path, monkeypatch) as service:
        with service.storage.write() as unit:
            register(unit)
        sent = [Upload(path.read_bytes(), VEHICLE) for path in recordings(tmp_path)]
        assert [one.put(service.client).status_code for one in sent] == [201] * 3
        assert [one.put(service.client).status_code for one in sent] == [200] * 3
        assert service.names() == sorted(name_of(one) for one in sent)
        assert service.left() == []
        assert bytes(service.objects.get(name_of(sent[0])).bytes()) == sent[0].content
        assert service.client.post("/v1/jobs/assemble_windows/runs").status_code == 202
        paths = [f"/v1/chunks/{one.digest}" for one in sent]
        eventually(lambda: {service.client.get(path).json()["state"] for path in paths} == {"assembled"})
        assert len(made_of(service.storage)) == 6
        assert service.left() == []
        deleted = service.client.delete(f"/v1/recordings/{sent[0].digest}", params={"why": "a test bench"})
        assert (deleted.status_code, name_of(sent[0]) in service.names()) == (200, False)


@pytest.mark.slow
def test_while_the_bucket_is_away_chunks_are_refused_and_taken_when_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_s3_server() as server, deployed(server, tmp_path, monkeypatch) as service:
        first, second, third = (upload(seed) for seed in (1, 2, 3))
        assert first.put(service.client).status_code == 201
        server.stop()
        for _ in range(2):
            refused = second.put(service.client)
            assert (refused.status_code, refused.headers["retry-after"]) == (503, "60")
            assert refused.json()["detail"].startswith("the raw store takes nothing now")
        assert (service.receipts(), service.left()) == ({first.digest}, [])
        wait_for(f"{server.endpoint} cannot be reached", service.process.file)
        server.start()
        assert [one.put(service.client).status_code for one in (second, third, first)] == [201, 201, 200]
        assert service.names() == sorted(name_of(one) for one in (first, second, third))


@pytest.mark.slow
def test_a_wrong_key_refuses_chunks_and_is_named_in_the_log(
    s3_server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = s3_server
    with monkeypatch.context() as patch:
        patch.setattr(S3Server, "environment", lambda _self, prefix="": _with_wrong_key(server, prefix))
        with deployed(s3_server, tmp_path, monkeypatch) as service:
            refused = upload(1).put(service.client)
            assert (refused.status_code, service.receipts(), service.names()) == (503, set(), [])
            wait_for("403 Forbidden", service.process.file)
            assert "not-the-key" not in service.process.log + refused.text


def _with_wrong_key(server: S3Server, prefix: str) -> dict[str, str]:
    named = {"TREADWATCH_RAW_STORE": f"s3://fleet/{prefix}", "TREADWATCH_S3_ENDPOINT": server.endpoint}
    return named | {"AWS_ACCESS_KEY_ID": "TESTERKEY", "AWS_SECRET_ACCESS_KEY": "not-the-key"}


@pytest.mark.slow
def test_a_service_that_is_killed_leaves_no_receipt_without_its_object(
    s3_server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = [upload(100 + number, 200_000) for number in range(60)]
    answered: list[str] = []

    def send(number: int, url: str) -> None:
        with httpx.Client(base_url=url, timeout=60.0) as client:
            for one in some[number::4]:
                try:
                    if one.put(client).status_code == 201:
                        answered.append(one.digest)
                except httpx.TransportError:
                    return

    prefix = uuid.uuid4().hex
    with deployed(s3_server, tmp_path, monkeypatch, prefix=prefix) as service:
        senders = [threading.Thread(target=send, args=(number, service.process.url)) for number in range(4)]
        for sender in senders:
            sender.start()
        eventually(lambda: len(answered) >= 8)
        os.kill(service.process.process.pid, signal.SIGKILL)
        for sender in senders:
            sender.join(60)
        there = {name[3:67] for name in service.names()}
        assert set(answered) <= service.receipts() <= there
    with deployed(s3_server, tmp_path, monkeypatch, prefix=prefix) as service:
        statuses = {one.digest: one.put(service.client).status_code for one in some}  # senders send again
        assert {statuses[digest] for digest in answered} == {200}
        assert service.receipts() == {name[3:67] for name in service.names()} == {one.digest for one in some}


@pytest.mark.slow
def test_two_services_that_get_the_same_chunk_at_once_store_it_once(
    s3_server: S3Server, postgres_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix, one = uuid.uuid4().hex, upload(5, 900_000)
    with ExitStack() as stack:
        both = [
            stack.enter_context(deployed(s3_server, tmp_path / name, monkeypatch, postgres_url, prefix))
            for name in ("a", "b")
        ]
        ready = threading.Barrier(8)

        def send(number: int) -> int:
            with httpx.Client(base_url=both[number % 2].process.url, timeout=60.0) as client:
                ready.wait()
                return one.put(client).status_code

        with ThreadPoolExecutor(8) as senders:
            assert sorted(senders.map(send, range(8))) == [200] * 7 + [201]
        assert (both[0].names(), both[0].receipts()) == ([name_of(one)], {one.digest})
        assert bytes(both[0].objects.get(name_of(one)).bytes()) == one.content


@pytest.mark.slow
def test_the_commands_know_the_bucket(
    s3_server: S3Server, treadwatch: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with deployed(s3_server, tmp_path, monkeypatch) as service:
        with service.storage.write() as unit:
            register(unit)
        damaged, gone = (upload(seed, vehicle=VEHICLE) for seed in (1, 2))
        for one in (damaged, gone):
            assert one.put(service.client).status_code == 201
        done = treadwatch("ingest", *recordings(tmp_path))
        assert done.returncode == 0, done.stderr
        assert len(service.names()) == 5
        url = f"s3://fleet/{service.objects.prefix}"
        stats = json.loads(treadwatch("db", "stats", "--json").stdout)
        assert stats["raw_store"] == url
        assert [kind["items"] for kind in stats["kinds"] if kind["kind"] == "raw recordings"] == [5]
        service.objects.put(name_of(damaged), b"!" * len(damaged.content))
        service.objects.delete(name_of(gone))
        scrubbed = treadwatch("chunk", "scrub")
        assert (scrubbed.returncode, "5 raw files" in scrubbed.stdout) == (1, True)
        assert f"{url}/{name_of(gone)} is missing" in treadwatch("db", "check", "--deep").stdout
        backup = treadwatch("backup", "b")
        assert (backup.returncode, f"missing: {url}/{name_of(gone)}" in backup.stdout) == (1, True)
        assert f"the recordings stay in {url}" in backup.stdout
        for one in (damaged, gone):
            assert one.put(service.client).status_code == 200
        assert treadwatch("chunk", "scrub").returncode == 0
        assert treadwatch("db", "check", "--deep").returncode == 0
        assert treadwatch("backup", "c").returncode == 0
        assert treadwatch("db", "purge").returncode == 0
        assert len(service.names()) == 5
        assert service.left() == []
        dropped = tmp_path / "incoming"
        dropped.mkdir()
        (dropped / f"{VEHICLE}__1.blf").write_bytes(upload(3).content)
        assert treadwatch("chunk", "drop", dropped, "--once", "--quiet-s", "0").returncode == 0
        assert name_of(upload(3)) in service.names()
        assert service.left() == []
