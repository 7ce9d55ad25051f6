"""The database goes away, disks are full: nothing that was stored is lost, and every process goes on by itself."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np

from api import logs
from api.factory import open_store
from api.serving import create_server
from api.settings import Settings
from bench.chaos.kills import LEASE_S, schedule
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import (
    PASSWORD,
    Databases,
    compared,
    databases,
    fork,
    ingest,
    newest_run,
    recordings,
    wait_for,
)
from bench.report import BenchRow
from bench.services import answers, free_port, until
from ingest.receiver import ChunkReceipt

SECONDS = 45.0
LONGEST_S = 300.0
BACK_WITHIN_S = 30.0
DISK = "4m"
PLACES = {"sqlite": ("raw", "windows", "database"), "postgresql": ("raw", "windows")}


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what outages of the database did to ingest, scheduler and API, and what full disks did to ingest."""
    lengths = np.geomspace(1.0, LONGEST_S if settings.size > 1 else 1.0, settings.size)
    with databases(settings.folder) as both:
        yield from _database_away(both, [float(length) for length in lengths])
        short = settings.size == 1
        for kind in ("sqlite",) if short else ("sqlite", "postgresql"):
            for place in ("windows",) if short else PLACES[kind]:
                yield _disk_full(both, kind, place)
            yield _not_mounted(both, kind)


def _database_away(both: Databases, lengths: Sequence[float]) -> Iterator[BenchRow]:
    paths = recordings(both.folder / "recordings", np.linspace(0.0, 1.0, len(lengths) + 1)[1:-1].tolist(), SECONDS)
    broken, alone = (both.new("postgresql").model_copy(update={"lease_s": LEASE_S}) for _ in range(2))
    port, log = free_port(), both.folder / "outages.log"
    serving = broken.model_copy(update={"port": port})
    pids = [fork(partial(schedule, broken, 2.0), log), fork(partial(_serve, serving), log)]
    url, back = f"http://127.0.0.1:{port}/v1/jobs", []
    try:
        until(partial(answers, url), BACK_WITHIN_S)
        for length, path in zip(lengths, paths, strict=False):
            sender = fork(partial(_send_until_stored, broken, path), log)
            both.server.stop()
            time.sleep(length)
            both.server.start()
            begin, known = time.monotonic(), newest_run(broken)
            reached = until(lambda known=known: answers(url) and newest_run(broken) > known, BACK_WITHIN_S)
            wait_for([sender])
            back.append(BACK_WITHIN_S if reached is None else time.monotonic() - begin)
        ended = [pid for pid in pids if os.waitpid(pid, os.WNOHANG)[0]]
    finally:
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                wait_for([pid])
    time.sleep(2.0 * LEASE_S)  # what a killed process ran is abandoned once its lease has ended
    wrong = compared(both, broken, alone, paths)
    text = log.read_text(errors="replace")
    named = f"{len(lengths)} outages of PostgreSQL of {lengths[0]:.0f} to {lengths[-1]:.0f} s"
    yield BenchRow(f"{named}: lost or other than without them", f"{len(wrong)} {wrong}", "0", not wrong)
    yield BenchRow(f"{named}: scheduler or API that ended", str(len(ended)), "0", not ended)
    worst = max(back)
    reach = f"< {BACK_WITHIN_S:g} s"
    yield BenchRow(f"{named}: until all go on by themselves, longest", f"{worst:.1f} s", reach, worst < BACK_WITHIN_S)
    yield BenchRow(f"{named}: password in the log", str(text.count(PASSWORD)), "0", PASSWORD not in text)
    yield BenchRow(f"{named}: size of the log", f"{len(text) / 1024:.0f} KiB", "< 1024 KiB", len(text) < 1 << 20)


def _disk_full(both: Databases, kind: str, place: str) -> BenchRow:
    """Receive recordings on a disk that is full, make room, and receive what was not stored again."""
    what = f"disk full in {place}, {kind}: receipts during it; other in the end than without it; refused for good"
    paths = recordings(both.folder / f"recordings-{kind}-{place}", [0.3, 0.6], SECONDS)
    broken, alone = both.new(kind), both.new(kind)
    folder = broken.data_dir if place == "database" else broken.data_dir / place
    try:
        with _small_disk(folder) as disk:
            filler = disk / "filler"
            outcomes = []
            with suppress(Exception), filler.open("wb") as full:  # until nothing fits
                while True:
                    full.write(bytes(4096))
                    full.flush()
            with suppress(Exception):  # a command that ends with a message has stored nothing
                outcomes = ingest(broken, paths)
            filler.unlink()
            stored = sum(isinstance(outcome, ChunkReceipt) for outcome in outcomes)
            wrong = compared(both, broken, alone, paths, keep=True)
            with closing(open_store(broken)) as storage, storage.read() as unit:
                refused = sum(
                    row.state == "rejected" for row in unit.connection.exec_driver_sql("SELECT * FROM chunks")
                )
    except PermissionError:
        return BenchRow(what, "not run: needs the right to mount a disk", "any; 0; 0", met=True)
    both.drop(alone)
    shutil.rmtree(broken.data_dir, ignore_errors=True)
    measured = f"{stored}; {len(wrong)} {wrong}; {refused}"
    return BenchRow(what, measured, "any; 0; 0", not wrong and refused == 0)


def _not_mounted(both: Databases, kind: str) -> BenchRow:
    """Receive recordings while the folder of raw recordings is another, empty one."""
    paths = recordings(both.folder / f"recordings-{kind}-mount", [0.3, 0.6], SECONDS)
    broken, alone = both.new(kind), both.new(kind)
    folder = broken.data_dir / "raw"
    ingest(broken, paths[:1])
    away = folder.rename(broken.data_dir / "away")
    folder.mkdir()
    outcomes: list[object] = []
    with suppress(Exception):
        outcomes = ingest(broken, paths[1:])
    left = len(list(folder.iterdir()))
    folder.rmdir()
    away.rename(folder)
    wrong = compared(both, broken, alone, paths)
    receipts = sum(isinstance(outcome, ChunkReceipt) for outcome in outcomes)
    return BenchRow(
        f"raw recordings not mounted, {kind}: receipts during it; files put beside it; other in the end than with it",
        f"{receipts}; {left}; {len(wrong)} {wrong}",
        "0; 0; 0",
        receipts == left == len(wrong) == 0,
    )


@contextmanager
def _small_disk(folder: Path) -> Iterator[Path]:
    """Put a small file system of its own in place of a folder, with what is in it."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder.with_name(f"{folder.name}-kept")
    shutil.copytree(folder, kept)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "treadwatch-chaos", str(folder)]
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:  # noqa: S603 - our own command
        raise PermissionError(folder)
    try:
        shutil.copytree(kept, folder, dirs_exist_ok=True)
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)  # noqa: S603, S607 - the same


def _send_until_stored(settings: Settings, path: Path) -> None:
    """Send a recording as a depot does: until it has its receipt."""
    while True:
        with suppress(Exception):  # the database is away; nothing was reported as stored
            if any(isinstance(outcome, ChunkReceipt) for outcome in ingest(settings, [path])):
                return
        time.sleep(0.2)


def _serve(settings: Settings) -> None:
    logs.configure(settings)
    create_server(settings).run()
