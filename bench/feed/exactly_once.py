"""Many writers, and pollers that are killed and started again: what is missed, doubled, or out of order."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from bench.feed.poller import kept
from fleet_db.storage import SqlStorage

PATIENCE_S = 120.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What pollers got, summed over them, against what is in the feed."""

    events: int
    kills: int
    missed: int
    doubled: int
    out_of_order: int


def run(
    url: str,
    key: str,
    folder: Path,
    database_url: str | None,
    storage: SqlStorage,
    *,
    writers: int,
    pollers: int,
    steps: int,
) -> Outcome:
    """Let writers commit while pollers are killed, and compare."""
    begin = ["-m", "bench.feed.events", str(folder), database_url or ""]
    writing = [_started([*begin, str(one), str(steps), "0.005"], quiet=True) for one in range(writers)]
    files = [folder / f"poller-{one}" for one in range(pollers)]
    polling = [_started(["-m", "bench.feed.poller", url, key, str(file)]) for file in files]
    draw, kills = random.Random(12), 0  # noqa: S311 - which poller is killed when, the same in every run
    try:
        while any(one.poll() is None for one in writing):
            time.sleep(draw.uniform(0.5, 2.0))
            victim = draw.randrange(pollers)
            polling[victim].kill()
            polling[victim].wait()
            kills += 1
            polling[victim] = _started(["-m", "bench.feed.poller", url, key, str(files[victim])])
        if any(one.returncode for one in writing):
            raise RuntimeError("a writer has failed")
        return _compared(storage, files, kills)
    finally:
        for one in (*writing, *polling):
            one.kill()
            one.wait()


def _started(arguments: list[str], *, quiet: bool = False) -> subprocess.Popen[bytes]:
    output = subprocess.DEVNULL if quiet else None
    return subprocess.Popen([sys.executable, *arguments], stdout=output)  # noqa: S603 - our own command


def _compared(storage: SqlStorage, files: list[Path], kills: int) -> Outcome:
    """Wait until every poller has got the last event, or for so long, and count."""
    with storage.read() as unit:
        wanted = [event.note for event in unit.alerts.feed(0, 1_000_000)]
    until = time.monotonic() + PATIENCE_S
    while any(wanted[-1] not in kept(file)[0] for file in files) and time.monotonic() < until:
        time.sleep(0.1)
    missed = doubled = out_of_order = 0
    place = {note: number for number, note in enumerate(wanted)}
    for file in files:
        got = kept(file)[0]
        missed += len(set(wanted) - set(got))
        doubled += len(got) - len(set(got))
        out_of_order += sum(place[after] < place[before] for before, after in pairwise(got))
    return Outcome(len(wanted), kills, missed, doubled, out_of_order)
