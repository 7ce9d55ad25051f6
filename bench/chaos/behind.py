"""Behind by an hour: chunks over HTTP that nobody decodes, a live bus whose database is away.

Chunks come over HTTP while nobody decodes, until a limit is reached; then a decoder catches up. The database of a live
receiver is away for as long as an hour of its bus: what comes waits in the spool.
"""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from pathlib import Path

import httpx

from api.factory import open_store
from bench.chaos.live import PATIENCE_S, LiveRound, stored_frames, transmitting
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import WINDOW_S, Databases, databases, faults
from bench.measuring import resident_of
from bench.report import BenchRow
from bench.served import new_key
from bench.services import START_S, answers, free_port, running, until
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.frames import OVERFLOW_ID, FrameBatch, count_dropped
from ingest.logs import write_blf
from tests.ingest.vehicle_bus import OFFSETS_M, START_NS, Run

MOST_GROWTH_MB = 16.0


def grown(what: str, early_mb: float, late_mb: float) -> BenchRow:
    """Return the row of memory that is to stay flat: at a tenth, and at the end."""
    measured = f"{early_mb:.0f} MB at a tenth, {late_mb:.0f} MB at the end"
    return BenchRow(what, measured, f"{MOST_GROWTH_MB:g} MB more at most", late_mb - early_mb <= MOST_GROWTH_MB)


CLIENTS = 8
CHUNK_S = 60.0
TAKEN = 0.8
"""Share of the backlog at which the limit is."""
EACH_S = 5.0
"""A chunk takes so long to decode at most, on a machine that does other things too, s."""
OCTETS = {"Content-Type": "application/octet-stream"}


@dataclass(frozen=True, slots=True)
class _Chunk:
    path: Path
    vehicle: str
    digest: str

    @property
    def address(self) -> str:
        return f"/v1/chunks/{self.digest}?vehicle={self.vehicle}&format=blf"


@dataclass
class _Answers:
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


def _uploads(both: Databases, kind: str, vehicles: int, minutes: int) -> Iterator[BenchRow]:
    """Yield what an API did with more chunks than it may take: one a minute of each vehicle; what came of them."""
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
        url = f"http://127.0.0.1:{serving.port}"
        with (
            running(serving, "serve", log=serving.data_dir / "serve.log") as api,
            httpx.Client(base_url=url, headers=header | OCTETS, timeout=60.0) as client,
        ):
            assert until(lambda: answers(f"{url}/readyz"), START_S) is not None, serving.data_dir
            answered, early_mb = _sent(client, chunks, api.pid)
            yield _row_of_answers(name, client, chunks, answered)
            late_mb = 1e-6 * resident_of(api.pid)
            yield grown(f"{name}: memory of the API", early_mb, late_mb)
            with running(serving, "chunk", "work", log=serving.data_dir / "chunk.log"):
                again = list(answered.refused)
                patience_s = START_S + EACH_S * len(chunks)
                done = until(lambda: _all_taken(client, again) and _waiting(storage) == 0, patience_s)
            yield _row_of_receipts(name, storage, chunks, done)
            yield grown(f"{name}: memory of the API when all is decoded", early_mb, 1e-6 * resident_of(api.pid))
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
                early_mb = 1e-6 * resident_of(pid)
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


BUSY = 14
"""A bus with so many times the acceleration frames of the vehicle has eight times as many frames."""
SPED_UP = 8.0
FULL_MB = 1
FULL_S = 30.0


def _live(both: Databases, folder: Path, minutes: float) -> Iterator[BenchRow]:
    """Yield what a receiver did with the frames of an outage of its database, sent in an eighth of the time."""
    yield from _outage(both, folder, f"live receiver, {minutes:g} min of a bus behind", 60.0 * minutes / SPED_UP, {})
    small = {"spool_mb": FULL_MB, "spool_memory_mb": FULL_MB}
    yield from _outage(both, folder, f"live receiver, spool and memory of {FULL_MB} MB", FULL_S, small)


def _outage(both: Databases, folder: Path, name: str, seconds: float, chosen: dict[str, int]) -> Iterator[BenchRow]:
    one = LiveRound(both.new("postgresql").model_copy(update=chosen), folder / f"behind-{seconds:g}.log")
    one.start()
    assert one.process is not None
    with transmitting(one, BUSY):
        time.sleep(2.0)
        both.server.stop()
        time.sleep(seconds / 10)
        early_mb = 1e-6 * resident_of(one.process.pid)
        time.sleep(0.9 * seconds)
        late_mb, waiting = 1e-6 * resident_of(one.process.pid), len(one.spool())
    both.server.start()
    one.end(PATIENCE_S + EACH_S * waiting)
    yield _row_of_outage(name, both, one, waiting, full=bool(chosen))
    yield grown(f"{name}: memory of the receiver", early_mb, late_mb)


def _row_of_outage(name: str, both: Databases, one: LiveRound, waiting: int, *, full: bool) -> BenchRow:
    """Compare what was transmitted with what has a receipt, and with what was counted as dropped."""
    with closing(open_store(one.settings)) as storage:
        wrong, stored = faults(one.settings, storage), stored_frames(one, storage)
    dropped, ours = count_dropped(stored), int((stored.arbitration_id != OVERFLOW_ID).sum())
    sent = sum(map(len, one.sent))
    both.drop(one.settings)
    silent = sent - ours - dropped
    measured = (
        f"{sent:,} frames sent, {ours:,} stored, {dropped:,} dropped and counted, {silent:,} lost silently; "
        f"{waiting} pieces waited, {len(one.spool())} are left; torn or orphaned {len(wrong)}"
    )
    met = silent == 0 and waiting > 0 and not wrong and (dropped > 0 if full else dropped == 0)
    return BenchRow(name, measured, f"{'some' if full else '0'} dropped, 0 silently, 0 left", met)


VEHICLES = {"postgresql": 4, "sqlite": 2}
SHORT = 1
"""Minutes up to which the run is short: uploads to SQLite alone."""
SHORT_VEHICLES = 12


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what services do that are behind: refuse or keep, never drop silently, at the same memory.

    ``size`` is the length of the backlog in minutes; it is sent faster than it would come.
    """
    with databases(settings.folder) as both:
        if settings.size <= SHORT:
            yield from _uploads(both, "sqlite", SHORT_VEHICLES, settings.size)
            return
        for kind, vehicles in VEHICLES.items():
            yield from _uploads(both, kind, vehicles, settings.size)
        yield from _live(both, settings.folder, settings.size)
