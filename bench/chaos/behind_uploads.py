"""Chunks that come over HTTP while nobody decodes, until a limit is reached; then a decoder catches up."""

from __future__ import annotations

import hashlib
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from pathlib import Path
import httpx
from api.factory import open_store
from api.settings import Settings
from bench.api.servers import new_key
from bench.chaos.kills import free_port
from bench.chaos.small_deployment import WINDOW_S, Databases, until
from bench.report import BenchRow
from bench.service_environment import environment_of
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.frames import FrameBatch
from ingest.logs import write_blf
from tests.ingest.vehicle_bus import OFFSETS_M, START_NS, Run
import resource
from pathlib import Path
from bench.report import BenchRow


MOST_GROWTH_MB = 16.0


def resident_mb(pid: int) -> float:
    """Return how much memory a process has, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 1e6


def grown(what: str, early_mb: float, late_mb: float) -> BenchRow:
    """Return the row of memory that is to stay flat.

    Args:
        early_mb, late_mb: At a tenth, and at the end.
    """
    measured = f"{early_mb:.0f} MB at a tenth, {late_mb:.0f} MB at the end"
    return BenchRow(what, measured, f"{MOST_GROWTH_MB:g} MB more at most", late_mb - early_mb <= MOST_GROWTH_MB)


CLIENTS = 8
CHUNK_S = 60.0
TAKEN = 0.8
"""Share of the backlog at which the limit is."""
START_S = 120.0
EACH_S = 5.0
"""A chunk takes so long to decode at most, on a machine that does other things too, s."""
OCTETS = {"Content-Type": "application/octet-stream"}
RUN = "from api.cli import main; main()"


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A chunk to be sent."""

    path: Path
    vehicle: str
    digest: str

    @property
    def address(self) -> str:
        return f"/v1/chunks/{self.digest}?vehicle={self.vehicle}&format=blf"


@dataclass
class _Answers:
    """What the senders were answered."""

    stored: list[_Chunk] = field(default_factory=list)
    refused: list[_Chunk] = field(default_factory=list)
    others: Counter[int] = field(default_factory=Counter)
    without_time: int = 0  # refused without Retry-After

    def add(self, chunk: _Chunk, answer: httpx.Response) -> None:
        if answer.status_code in (HTTPStatus.CREATED, HTTPStatus.OK):
            self.stored.append(chunk)
        elif answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE:
            self.refused.append(chunk)
            self.without_time += not answer.headers.get("Retry-After", "").isdigit()
        else:
            self.others[answer.status_code] += 1


def rows(both: Databases, kind: str, vehicles: int, minutes: int) -> Iterator[BenchRow]:
    """Yield what an API did with more chunks than it may take, and what came of them.

    Args:
        vehicles, minutes: Of the backlog: a chunk a minute of each vehicle.
    """
    settings = both.new(kind)
    chunks = _chunks(both.folder / f"chunks-{kind}", vehicles, minutes)
    most = max(1, round(TAKEN * len(chunks)))
    with closing(open_store(settings)) as storage:
        _register(storage, vehicles)
        header = dict([new_key(storage).split(": ", 1)])
        serving = settings.model_copy(
            update={"backlog_chunks": most, "requests_per_s": 1e6, "requests_burst": 1_000_000, "port": free_port()}
        )
        name = f"{kind}, {len(chunks)} chunks of a minute, of {vehicles} vehicles, {most} may wait"
        with _api(serving) as api, httpx.Client(base_url=api.url, headers=header | OCTETS, timeout=60.0) as client:
            answers, early_mb = _sent(client, chunks, api.pid)
            yield _row_of_answers(name, client, chunks, answers)
            late_mb = resident_mb(api.pid)
            yield grown(f"{name}: memory of the API", early_mb, late_mb)
            with _decoder(serving):
                again = list(answers.refused)
                patience_s = START_S + EACH_S * len(chunks)
                done = until(lambda: _all_taken(client, again) and _waiting(storage) == 0, patience_s)
            yield _row_of_receipts(name, storage, chunks, done)
            yield grown(f"{name}: memory of the API when all is decoded", early_mb, resident_mb(api.pid))
    both.drop(settings)


def _sent(client: httpx.Client, chunks: Sequence[_Chunk], pid: int) -> tuple[_Answers, float]:
    """Send chunks once each, from several clients; return the answers, and the memory at a tenth of them, MB."""
    answers = _Answers()

    def send(chunk: _Chunk) -> tuple[_Chunk, httpx.Response]:
        return chunk, client.put(chunk.address, content=chunk.path.read_bytes())

    early_mb = 0.0
    with ThreadPoolExecutor(CLIENTS) as threads:
        for number, (chunk, answer) in enumerate(threads.map(send, chunks), start=1):
            answers.add(chunk, answer)
            if number == max(1, len(chunks) // 10):
                early_mb = resident_mb(pid)
    return answers, early_mb


def _row_of_answers(name: str, client: httpx.Client, chunks: Sequence[_Chunk], answers: _Answers) -> BenchRow:
    """Compare what was answered with what is there."""
    silent = len(chunks) - len(answers.stored) - len(answers.refused) - answers.others.total()
    silent += sum(client.get(f"/v1/chunks/{chunk.digest}").status_code != HTTPStatus.OK for chunk in answers.stored)
    kept = sum(client.get(f"/v1/chunks/{c.digest}").status_code != HTTPStatus.NOT_FOUND for c in answers.refused)
    measured = (
        f"{len(answers.stored)} receipts, {len(answers.refused)} refused with 503; {answers.without_time} without "
        f"Retry-After, {kept} of them stored; {answers.others.total()} answered otherwise, {silent} dropped"
    )
    bad = (answers.without_time, kept, answers.others.total(), silent)
    met = not any(bad) and bool(answers.refused)
    return BenchRow(f"{name}: answers", measured, "some refused; 0, 0, 0, 0", met)


def _row_of_receipts(name: str, storage: SqlStorage, chunks: Sequence[_Chunk], done: float | None) -> BenchRow:
    with storage.read() as unit:
        found = [unit.chunks.get(chunk.digest) for chunk in chunks]
        starts = [sorted(w.start_ns for w in unit.windows.list(one.serial)) for one in unit.registry.wheelsets()]
    decoded = sum(one is not None and one.state is ChunkState.DECODED for one in found)
    gaps = sum((one[-1] - one[0]) / (WINDOW_S * 1e9) + 1 - len(one) for one in starts if one)
    took = "not in time" if done is None else f"{done:.0f} s"
    measured = f"{decoded} of {len(chunks)} assembled in {took}; {gaps:g} windows missing"
    met = decoded == len(chunks) and gaps == 0.0
    return BenchRow(f"{name}: once a decoder runs, refused ones sent again", measured, "all; 0", met)


def _all_taken(client: httpx.Client, left: list[_Chunk]) -> bool:
    """Send again what was refused, until it is taken; return whether nothing is left."""
    while left:
        answer = client.put(left[-1].address, content=left[-1].path.read_bytes())
        if answer.status_code not in (HTTPStatus.CREATED, HTTPStatus.OK):
            time.sleep(1.0)
            return False
        left.pop()
    return True


def _waiting(storage: SqlStorage) -> int:
    with storage.read() as unit:
        return int(unit.chunks.undecoded_size().count)


def _chunks(folder: Path, vehicles: int, minutes: int) -> list[_Chunk]:
    """Write a chunk a minute of each vehicle, in the order in which they are ready."""
    folder.mkdir()
    found = []
    for minute in range(minutes):
        start_ns = START_NS + round(minute * CHUNK_S * 1e9)
        frames = Run(seconds=CHUNK_S, start_ns=start_ns, seed=minute).frames()
        for vehicle in range(vehicles):
            path = folder / f"{vehicle}-{minute:04}.blf"
            write_blf(path, _of_vehicle(frames, vehicle))
            found.append(_Chunk(path, f"B-{vehicle}", hashlib.sha256(path.read_bytes()).hexdigest()))
    return found


def _of_vehicle(frames: FrameBatch, vehicle: int) -> FrameBatch:
    """Return the frames as another vehicle would have sent them: recorded a little later."""
    return replace(frames, t_ns=frames.t_ns + 1_000_000 * vehicle)


def _register(storage: SqlStorage, vehicles: int) -> None:
    with storage.write() as unit:
        for number in range(vehicles):
            code = f"B-{number}"
            unit.registry.add_vehicle(VehicleRecord(code, "north", "multiple unit", 2, 40.0, OFFSETS_M))
            for axle in (1, 2):
                serial = f"{code}-{axle}"
                unit.registry.add_wheelset(WheelsetRecord(serial, "north", "P8", 0.45, None))
                unit.registry.add_mounting(Mounting(serial, code, axle, 0, None, 4000.0, 700.0 * axle))


@dataclass(frozen=True, slots=True)
class _Api:
    url: str
    pid: int


@contextmanager
def _api(settings: Settings) -> Iterator[_Api]:
    """Run ``treadwatch serve``."""
    url = f"http://127.0.0.1:{settings.port}"
    with _running(settings, "serve") as process:
        assert until(lambda: _ready(url), START_S) is not None, (settings.data_dir / "serve.log").read_text()
        yield _Api(url, process.pid)


@contextmanager
def _decoder(settings: Settings) -> Iterator[None]:
    """Run ``treadwatch chunk work``."""
    with _running(settings, "chunk", "work"):
        yield


@contextmanager
def _running(settings: Settings, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    with (settings.data_dir / f"{command[0]}.log").open("ab") as log:
        process = subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, "-c", RUN, *command], env=environment_of(settings), stdout=log, stderr=log
        )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(START_S)


def _ready(url: str) -> bool:
    try:
        with urllib.request.urlopen(f"{url}/readyz", timeout=5) as answer:  # noqa: S310 - our own service
            return bool(answer.status == HTTPStatus.OK)
    except (urllib.error.URLError, ConnectionError):
        return False
