"""The live receiver killed, without its database or its disk, while a vehicle transmits; on both databases."""

from __future__ import annotations

import random
import resource
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing

import numpy as np

from api.factory import open_store
from bench.chaos.live_round import LiveRound, acceleration_frames, stored_frames, transmitting
from bench.chaos.part import ChaosSettings
from bench.chaos.small_deployment import PASSWORD, Databases, databases, faults
from bench.report import BenchRow
from estimation.values.units import SECOND_NS
from ingest.frames import OVERFLOW_ID, FrameBatch, count_dropped, take

KINDS = ("sqlite", "postgresql")
OUTAGES_S = (1.0, 4.0, 15.0, 60.0, 300.0)
FULL_S = 12.0
FULL_BYTES = 20
"""On a full disk no file gets longer than this."""

LOST_S = 1.0
"""What was received so long before a kill may be lost."""

SHORT = 4
"""Kills up to which the run is short: all of them while the one database is away, and nothing is timed."""


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what kills and outages cost a live receiver.

    Args:
        settings: ``size`` is the number of kills; more than a few come with outages of up to 5 min and full disks.
    """
    draw = random.Random(settings.seed)  # noqa: S311 - no secret
    with databases(settings.folder) as both:
        if settings.size <= SHORT:
            yield _kills_without_database(both, settings)
            return
        for kind in KINDS:
            yield _kills(both, kind, settings, draw)
        for seconds in OUTAGES_S:
            yield _outage(both, settings, seconds)
        for kind in KINDS:
            yield _full_disk(both, kind, settings)


def _kills_without_database(both: Databases, settings: ChaosSettings) -> BenchRow:
    one = LiveRound(both.new("postgresql"), settings.folder / "kills-without-database.log")
    one.start()
    with transmitting(one):
        time.sleep(1.0)
        both.server.stop()
        for _ in range(settings.size):
            time.sleep(3.0)
            one.kill()
        both.server.start()
        time.sleep(1.0)
    one.end()
    return _row(f"postgresql: {settings.size} kills while it is away", both, one, timed=False)


def _kills(both: Databases, kind: str, settings: ChaosSettings, draw: random.Random) -> BenchRow:
    one = LiveRound(both.new(kind), settings.folder / f"kills-{kind}.log")
    kills = settings.size // 2
    one.start()
    with transmitting(one):
        for _ in range(kills):
            time.sleep(draw.uniform(0.3, 3.0))
            one.kill()
        time.sleep(1.5)
    one.end()
    return _row(f"{kind}: {kills} kills of the receiver", both, one)


def _outage(both: Databases, settings: ChaosSettings, seconds: float) -> BenchRow:
    one = LiveRound(both.new("postgresql"), settings.folder / f"outage-{seconds:g}.log")
    one.start()
    with transmitting(one):
        time.sleep(2.0)
        both.server.stop()
        time.sleep(seconds)
        both.server.start()
        time.sleep(2.0)
    one.end()
    return _row(f"postgresql: away {seconds:g} s", both, one)


def _full_disk(both: Databases, kind: str, settings: ChaosSettings) -> BenchRow:
    """Let the receiver write nothing for a while: no spool, no recording, no file of SQLite."""
    one = LiveRound(both.new(kind), settings.folder / f"full-{kind}.log")
    one.start()
    assert one.process is not None
    with transmitting(one):
        time.sleep(2.0)
        before = resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, (FULL_BYTES, before[1]))
        time.sleep(FULL_S)
        resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, before)
        time.sleep(2.0)
    one.end()
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
