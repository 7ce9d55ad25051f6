"""Who misses an event of the feed, and how late it comes: ``python -m bench feed [--databases sqlite]``.

Streams: the time from the end of a commit in another process to each client. Many writers, and pollers that are killed
and started again: what is missed, doubled, or out of order. Both on both databases, with two worker processes of the
service. A writer commits alerts of its own wheelset that are raised, change and close. A poller may be killed at any
time: effect and cursor are one line of its file, written at once.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import re
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from api.factory import open_store
from api.settings import Settings
from bench.report import Bench, BenchRow, Part, ResultTable, say
from bench.served import WORKERS, filled_database, served
from bench.services import DATABASES, started_program, until
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Severity
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.storage import SqlStorage

WRITERS, POLLERS, STEPS = 8, 4, 250
CLIENTS, EVENTS = 200, 40
REACH_S, PATIENCE_S = 1.0, 120.0
COLUMNS = ("database", "what", "measured", "reach", "met")
FLEET = "bench"
BEGUN_NS = 1_750_000_000_000_000_000
KINDS = (AlertEventKind.RAISED, AlertEventKind.UPDATED, AlertEventKind.ACKNOWLEDGED, AlertEventKind.CLOSED)
NOTE = re.compile(rb'"note":"(\d+-\d+)"')
PAUSE_S, AGAIN_S = 0.5, 0.5
PAGE = 7
_OPEN: list[asyncio.StreamWriter] = []


@dataclass(frozen=True, slots=True)
class Service:
    """A running service and its deployment."""

    url: str
    key: str
    folder: Path
    database_url: str | None
    storage: SqlStorage

    def write(self, writer: int, steps: int, pause_s: float) -> list[str]:
        """Return the arguments of a process that commits events."""
        numbers = (str(writer), str(steps), str(pause_s))
        return ["-m", "bench.feed", "write", str(self.folder), self.database_url or "", *numbers]

    def poll(self, file: Path) -> list[str]:
        """Return the arguments of a process that polls."""
        return ["-m", "bench.feed", "poll", self.url, self.key, str(file)]


def _parts(options: argparse.Namespace, _folder: Path) -> Iterator[Part]:
    rows = []
    for database in options.databases:
        for row in _of(database):
            say(f"{database}: {row.what}: {row.measured}")
            rows.append((database, *row.cells))
    yield ResultTable(COLUMNS, rows)


def _of(database: str) -> Iterator[BenchRow]:
    with (
        filled_database(database) as (folder, url, key),
        served(folder, url) as address,
        closing(open_store(_settings(folder, url))) as storage,
    ):
        _populate(storage)
        service = Service(address, key, folder, url, storage)
        yield _latency(service)
        yield _exactly_once(service)


def _settings(folder: Path, database_url: str | None) -> Settings:
    return Settings.model_validate({"data_dir": folder, "database_url": database_url or None, "log_level": "warning"})


def _populate(storage: SqlStorage) -> None:
    """Store a fleet with a wheelset for each writer."""
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord(FLEET, "Bench"))
        for writer in range(WRITERS + 1):
            unit.registry.add_wheelset(WheelsetRecord(f"WS-{writer:04d}", FLEET, "P8", 0.46, None, ()))


def _latency(service: Service) -> BenchRow:
    p50, p99, most = np.percentile(asyncio.run(_delays_s(service)), [50, 99, 100])
    return BenchRow(
        f"{CLIENTS} streams of {WORKERS} workers, {EVENTS} commits of another process: time after the commit",
        f"p50 {p50:.2f} s, p99 {p99:.2f} s, most {most:.2f} s",
        f"most < {REACH_S:g} s",
        bool(most < REACH_S),
    )


async def _delays_s(service: Service) -> list[float]:
    """Return the delay of every event at every client, s; raises where one is missing."""
    received: list[dict[bytes, int]] = [{} for _ in range(CLIENTS)]
    connections = await asyncio.gather(*(_connected(service) for _ in range(CLIENTS)))
    listening = [asyncio.create_task(_listen(one, got)) for one, got in zip(connections, received, strict=True)]
    command = service.write(WRITERS, EVENTS, PAUSE_S)
    committing = await asyncio.create_subprocess_exec(sys.executable, *command, stdout=subprocess.PIPE)
    printed, _ = await committing.communicate()
    committed = {note: int(at_ns) for note, at_ns in (line.split() for line in printed.splitlines())}
    await asyncio.wait_for(asyncio.gather(*listening), timeout=60)
    return [(got[note] - at_ns) / 1e9 for got in received for note, at_ns in committed.items()]


async def _connected(service: Service) -> asyncio.StreamReader:
    """Return a stream behind its first block; a service that has too much to do is asked again."""
    address = urllib.parse.urlsplit(service.url)
    head = f"GET /v1/alerts/feed/stream?after=latest HTTP/1.1\r\nHost: {address.netloc}\r\n{service.key}\r\n"
    while True:
        reader, writer = await asyncio.open_connection(address.hostname, address.port, limit=1 << 20)
        writer.write(f"{head}Accept: text/event-stream\r\n\r\n".encode())
        if b" 200 " in await reader.readline():
            while not (await reader.readline()).startswith(b"id:"):
                pass
            _OPEN.append(writer)  # closed with the process: a stream whose writer is forgotten is closed
            return reader
        writer.close()
        await asyncio.sleep(AGAIN_S)


async def _listen(reader: asyncio.StreamReader, got: dict[bytes, int]) -> None:
    while len(got) < EVENTS:
        line = await reader.readline()
        if not line:
            raise ConnectionError("a stream has ended")
        found = NOTE.search(line)
        if found is not None:
            got.setdefault(found[1], time.time_ns())


def _exactly_once(service: Service) -> BenchRow:
    """Let writers commit while pollers are killed, and compare what pollers got with what is in the feed."""
    logs = [service.folder / f"writer-{number}.log" for number in range(WRITERS)]
    writing = [started_program(service.write(number, STEPS, 0.005), os.environ, log) for number, log in enumerate(logs)]
    files = [service.folder / f"poller-{one}" for one in range(POLLERS)]
    polling = [started_program(service.poll(file), os.environ) for file in files]
    draw, kills = random.Random(12), 0  # noqa: S311 - which poller is killed when, the same in every run
    try:
        while any(one.poll() is None for one in writing):
            time.sleep(draw.uniform(0.5, 2.0))
            victim = draw.randrange(POLLERS)
            polling[victim].kill()
            polling[victim].wait()
            kills += 1
            polling[victim] = started_program(service.poll(files[victim]), os.environ)
        if any(one.returncode for one in writing):
            raise RuntimeError("a writer has failed: " + "\n".join(log.read_text() for log in logs))
        with service.storage.read() as unit:
            wanted = [event.note for event in unit.alerts.feed(0, 1_000_000)]
        until(lambda: all(wanted[-1] in _kept(file)[0] for file in files), PATIENCE_S)
    finally:
        for one in (*writing, *polling):
            one.kill()
            one.wait()
    place = {note: number for number, note in enumerate(wanted)}
    got = [_kept(file)[0] for file in files]
    missed = sum(len(set(wanted) - set(notes)) for notes in got)
    doubled = sum(len(notes) - len(set(notes)) for notes in got)
    out_of_order = sum(place[after] < place[before] for notes in got for before, after in pairwise(notes))
    return BenchRow(
        f"{WRITERS} writers, {POLLERS} pollers, {len(wanted)} events, {kills} kills of pollers",
        f"{missed} missed, {doubled} doubled, {out_of_order} out of order",
        "0, 0, 0",
        missed == doubled == out_of_order == 0,
    )


def _new_alert(writer: int) -> Alert:
    return Alert(
        alert_id=0,
        fleet=FLEET,
        wheelset=f"WS-{writer:04d}",
        kind="conicity_limit",
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=BEGUN_NS,
        last_seen_ns=BEGUN_NS,
        occurrence_count=1,
        probability=0.9,
        evidence={},
        action="reprofile",
        raise_limit=0.4,
        clear_limit=0.38,
    )


def _write(folder: Path, url: str, writer: int, steps: int, pause_s: float) -> None:
    """Commit events one by one, and print the note of each with when its commit had ended."""
    alert = _new_alert(writer)
    with closing(open_store(_settings(folder, url))) as storage:
        for number in range(steps):
            kind = KINDS[number % len(KINDS)]
            alert = replace(alert, occurrence_count=number + 1)
            if kind is AlertEventKind.CLOSED:
                alert = replace(alert, closed_ns=BEGUN_NS + number, close_reason=CloseReason.REPROFILED)
            note = f"{writer}-{number}"
            with storage.write() as unit:
                alert = unit.alerts.save(alert, [kind], time.time_ns(), note=note)
            print(note, time.time_ns(), flush=True)
            if kind is AlertEventKind.CLOSED:
                alert = _new_alert(writer)
            time.sleep(pause_s)


def _kept(file: Path) -> tuple[list[str], str | None]:
    """Return the notes of the events that a poller has handed over, and its cursor; a torn last line is not there."""
    lines = file.read_bytes().splitlines(keepends=True) if file.exists() else ()
    pages = [json.loads(line) for line in lines if line.endswith(b"\n")]
    return [note for page in pages for note in page["notes"]], pages[-1]["cursor"] if pages else None


def _poll(url: str, key: str, file: Path) -> None:
    """Poll for ever, with a wait, and keep each page."""
    _, cursor = _kept(file)
    whole = file.read_bytes().rpartition(b"\n") if file.exists() else (b"", b"", b"")
    handle = os.open(file, os.O_WRONLY | os.O_CREAT)
    os.ftruncate(handle, len(whole[0]) + len(whole[1]))
    os.lseek(handle, 0, os.SEEK_END)
    while True:
        query = {"limit": str(PAGE), "wait_s": "1"} | ({} if cursor is None else {"after": cursor})
        request = urllib.request.Request(f"{url}/v1/alerts/feed?{urllib.parse.urlencode(query)}")  # noqa: S310 - our own service
        request.add_header(*key.split(": ", maxsplit=1))
        with urllib.request.urlopen(request, timeout=30) as answer:  # noqa: S310 - the same
            page = json.load(answer)
        cursor = page["next_cursor"]
        line = {"notes": [item["note"] for item in page["items"]], "cursor": cursor}
        os.write(handle, json.dumps(line).encode() + b"\n")


main = Bench(
    "feed", "The feed", __doc__ or "", _parts, {"databases": (list(DATABASES), "that are used", DATABASES)}
).run

if __name__ == "__main__":
    if sys.argv[1] == "write":
        _write(Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]), int(sys.argv[5]), float(sys.argv[6]))
    else:
        _poll(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
