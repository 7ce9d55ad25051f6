"""A live receiver whose database is away for as long as an hour of its bus: what comes waits in the spool."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from api.factory import open_store
from bench.chaos.behind_uploads import grown, resident_mb
from bench.chaos.live import PATIENCE_S, LiveRound, stored_frames, transmitting
from bench.chaos.small_deployment import Databases, faults
from bench.report import BenchRow
from ingest.frames import OVERFLOW_ID, count_dropped

BUSY = 14
"""A bus with so many times the acceleration frames of the vehicle has eight times as many frames."""
SPED_UP = 8.0
FULL_MB = 1
FULL_S = 30.0
EACH_S = 5.0
"""A piece takes so long to be stored at most, on a machine that does other things too, s."""


def rows(both: Databases, folder: Path, minutes: float) -> Iterator[BenchRow]:
    """Yield what a receiver did with the frames of an outage of its database.

    Args:
        minutes: Of the bus at its usual rate, in an eighth of the time.
    """
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
        early_mb = resident_mb(one.process.pid)
        time.sleep(0.9 * seconds)
        late_mb, waiting = resident_mb(one.process.pid), len(one.spool())
    both.server.start()
    one.end(PATIENCE_S + EACH_S * waiting)
    yield _row(name, both, one, waiting, full=bool(chosen))
    yield grown(f"{name}: memory of the receiver", early_mb, late_mb)


def _row(name: str, both: Databases, one: LiveRound, waiting: int, *, full: bool) -> BenchRow:
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
