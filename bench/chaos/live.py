"""The live receiver killed, without its database or its disk, while a vehicle transmits; on both databases."""

from __future__ import annotations

import random
import resource
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event, Thread

import numpy as np

from api.factory import open_store
from api.settings import Settings
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import PASSWORD, Databases, databases, faults
from bench.report import BenchRow
from bench.services import started, until
from estimation.values.units import SECOND_NS
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.frames import OVERFLOW_ID, FrameBatch, concatenate, count_dropped, sort_by_time, take
from ingest.live.listening import open_bus, send
from ingest.logs import read_log
from tests.ingest.vehicle_bus import VEHICLE, Run

CHANNEL = "239.74.163.91"
PATIENCE_S = 120.0
OTHERS = 0x500
"""Identifiers from here on are those of other devices on a busy bus, which nobody decodes."""


@dataclass
class LiveRound:
    """One deployment with its receiver, and what was transmitted to it.

    Attributes:
        away_ns: When no process received.
    """

    settings: Settings
    log: Path
    process: subprocess.Popen[bytes] | None = None
    sent: list[FrameBatch] = field(default_factory=list)
    sent_ns: list[int] = field(default_factory=list)
    away_ns: list[tuple[int, int]] = field(default_factory=list)

    def start(self) -> None:
        """Start a receiver and wait until it listens."""
        arguments = ["ingest", "--interface", "udp_multicast", "--channel", CHANNEL, "--vehicle", VEHICLE]
        before = self.said().count("listening")
        self.process = started(self.settings, *arguments, "--chunk-seconds", "1", log=self.log)
        assert until(lambda: self.said().count("listening") > before, PATIENCE_S) is not None, self.said()

    def kill(self) -> None:
        """Kill the receiver and start it again; what is transmitted meanwhile reaches nobody."""
        assert self.process is not None
        self.process.send_signal(signal.SIGKILL)
        begin = time.time_ns()
        self.process.wait()
        self.start()
        self.away_ns.append((begin, time.time_ns()))

    def end(self, patience_s: float = PATIENCE_S) -> None:
        """End the receiver once nothing waits in its spool, or after some patience."""
        assert self.process is not None
        until(lambda: not any(self.spool()), patience_s)
        self.process.terminate()
        self.process.wait(PATIENCE_S)

    def said(self) -> str:
        """Return what the receivers have written."""
        return self.log.read_text() if self.log.exists() else ""

    def spool(self) -> list[Path]:
        """Return the pieces in the spool."""
        found = []
        for path in (self.settings.spool_dir / VEHICLE).glob("*.*"):
            with suppress(FileNotFoundError):  # it has its receipt by now
                found += [path] if path.stat().st_size else []
        return found


@contextmanager
def transmitting(one: LiveRound, busy: int = 1) -> Iterator[None]:
    """Transmit without an end, a second at a time; every payload is known by its batch."""
    stop = Event()

    def transmit() -> None:
        with open_bus("udp_multicast", CHANNEL) as bus:
            while not stop.is_set():
                begin_ns = time.time_ns() // SECOND_NS * SECOND_NS
                batch = _busy(Run(seconds=1.0, start_ns=begin_ns, seed=len(one.sent)).frames(), busy)
                one.sent_ns.append(time.time_ns())
                one.sent.append(batch)
                send(bus, batch)

    thread = Thread(target=transmit)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def stored_frames(one: LiveRound, storage: SqlStorage) -> FrameBatch:
    """Return all frames that have a receipt."""
    with storage.read() as unit:
        records = [record for state in ChunkState for record in unit.chunks.with_state(state, limit=100_000)]
    raw = FileRawStore(one.settings.data_dir / "raw")
    return concatenate([read_log(raw.path(record.digest, record.suffix)) for record in records])


def acceleration_frames(batch: FrameBatch) -> np.ndarray:
    """Return which frames are those of acceleration, whose payloads are drawn: no two are the same."""
    return np.isin(batch.arbitration_id, (0x181, 0x182))


def _busy(batch: FrameBatch, busy: int) -> FrameBatch:
    own = take(batch, acceleration_frames(batch))
    others = [replace(own, arbitration_id=own.arbitration_id - 0x181 + OTHERS + 2 * n) for n in range(busy - 1)]
    return sort_by_time(concatenate([batch, *others])) if others else batch


KINDS = ("sqlite", "postgresql")
FULL_S = 12.0
FULL_BYTES = 20
"""On a full disk no file gets longer than this."""

LOST_S = 1.0
"""What was received so long before a kill may be lost."""

SHORT = 4
"""Kills up to which the run is short: all of them while the one database is away, and nothing is timed."""


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what kills and full disks cost a live receiver.

    ``size`` is the number of kills; a few come while the database is away. Outages are a matter of ``behind``.
    """
    draw = random.Random(settings.seed)  # noqa: S311 - no secret
    with databases(settings.folder) as both:
        if settings.size <= SHORT:
            yield _kills_without_database(both, settings)
            return
        for kind in KINDS:
            yield _kills(both, kind, settings, draw)
        for kind in KINDS:
            yield _full_disk(both, kind, settings)


@contextmanager
def _listening(both: Databases, kind: str, settings: ChaosSettings, name: str) -> Iterator[LiveRound]:
    """Yield a receiver to which a vehicle transmits; it is ended once nothing waits any more."""
    one = LiveRound(both.new(kind), settings.folder / f"{name}.log")
    one.start()
    with transmitting(one):
        yield one
    one.end()


def _kills_without_database(both: Databases, settings: ChaosSettings) -> BenchRow:
    with _listening(both, "postgresql", settings, "kills-without-database") as one:
        time.sleep(1.0)
        both.server.stop()
        for _ in range(settings.size):
            time.sleep(3.0)
            one.kill()
        both.server.start()
        time.sleep(1.0)
    return _row(f"postgresql: {settings.size} kills while it is away", both, one, timed=False)


def _kills(both: Databases, kind: str, settings: ChaosSettings, draw: random.Random) -> BenchRow:
    kills = settings.size // 2
    with _listening(both, kind, settings, f"kills-{kind}") as one:
        for _ in range(kills):
            time.sleep(draw.uniform(0.3, 3.0))
            one.kill()
        time.sleep(1.5)
    return _row(f"{kind}: {kills} kills of the receiver", both, one)


def _full_disk(both: Databases, kind: str, settings: ChaosSettings) -> BenchRow:
    """Let the receiver write nothing for a while: no spool, no recording, no file of SQLite."""
    with _listening(both, kind, settings, f"full-{kind}") as one:
        assert one.process is not None
        time.sleep(2.0)
        before = resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, (FULL_BYTES, before[1]))
        time.sleep(FULL_S)
        resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, before)
        time.sleep(2.0)
    return _row(f"{kind}: disk full for {FULL_S:g} s", both, one)


def _row(what: str, both: Databases, one: LiveRound, *, timed: bool = True) -> BenchRow:
    """Compare what was transmitted with what has a receipt."""
    with closing(open_store(one.settings)) as storage:
        wrong = faults(one.settings, storage)
        stored = stored_frames(one, storage)
    dropped = count_dropped(stored)
    ours = stored.arbitration_id != OVERFLOW_ID
    doubled, lost_s, lost = _compared(one, stored.t_ns[ours], _keys(stored))
    lost = max(lost - dropped, 0)
    left, leaked = len(one.spool()), PASSWORD in one.said()
    both.drop(one.settings)
    total = sum(map(len, one.sent))
    measured = (
        f"{total:,} frames sent, {int(ours.sum()):,} stored; lost while a receiver listened {lost:,}, before a kill at "
        f"most {lost_s:.2f} s; dropped and counted {dropped:,}, doubled {doubled}, torn or orphaned {len(wrong)}, "
        f"pieces left {left}"
    )
    met = doubled == left == lost == len(wrong) == 0 and not leaked and (lost_s <= LOST_S or not timed)
    return BenchRow(what, measured, "0 lost but the last second before a kill, 0 doubled, 0 torn, 0 left", met)


def _compared(one: LiveRound, stored_ns: np.ndarray, keys: np.ndarray) -> tuple[int, float, int]:
    """Return frames stored twice, the longest time lost before a kill, s, and frames lost although they were received.

    A frame belongs to a kill when it was sent within the last two seconds before it or before the next receiver
    listened.
    """
    found = Counter(keys.tolist())
    wanted = Counter(key for batch in one.sent for key in _keys(batch).tolist())
    doubled = sum((found - wanted).values())
    missing = wanted - found
    lost = 0
    before_kill_s = 0.0
    last = {begin: stored_ns[stored_ns < begin].max(initial=0) for begin, _ in one.away_ns}
    for begin, newest in last.items():
        if newest:
            before_kill_s = max(before_kill_s, (begin - newest) / SECOND_NS)
    for sent_ns, batch in zip(one.sent_ns, one.sent, strict=True):
        at_ns = sent_ns + batch.t_ns - batch.t_ns[0]
        away = np.zeros(len(batch), dtype=bool)
        for begin, end in one.away_ns:
            away |= (at_ns > begin - 2 * SECOND_NS) & (at_ns < end + SECOND_NS // 2)
        lost += sum(missing[key] > 0 for key in _keys(take(batch, ~away)).tolist())
    return doubled, before_kill_s, lost


def _keys(batch: FrameBatch) -> np.ndarray:
    """Return the payloads of the acceleration frames, which are drawn: no two are the same."""
    return np.ascontiguousarray(batch.data[acceleration_frames(batch)]).view("<u8").ravel()
