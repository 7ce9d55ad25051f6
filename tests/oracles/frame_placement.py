"""The placement of frames with one numpy operation for each step, at every frame: what the compiled one must equal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray
from ingest.align.cycles import (
    BESIDE,
    CLEAR,
    CONCENTRATED,
    FEWEST,
    IN_TIME,
    REACH_NS,
    RHYTHM,
    SYNC_REACH,
    UNPLACED,
    Placement,
    SyncClock,
)

COUNTS = 1 << 20


def place_frames(clock: SyncClock, t_ns: IntArray, cycles: int) -> Placement:
    """Return the SYNC number that each frame of one message belongs to.

    Where a SYNC is lost, its instant follows from the one before, over at most ``SYNC_REACH`` cycles; the number of the
    next SYNC shows how many were lost, so that a frame that is stamped late, with none lost, is still taken for what it
    is. Frames between SYNCs that are not in time belong to the one before them.

    Args:
        t_ns: (n,) stamps of the frames of one message, ascending, ns.
        cycles: The message is sent every so many SYNCs; 0 if it does not follow SYNC.
    """
    if len(clock.t_ns) == 0 or len(t_ns) == 0:
        return Placement(np.full(len(t_ns), UNPLACED))
    before, since, in_time = _since_sync(clock, t_ns)
    lost = np.append(np.clip(np.diff(clock.tick) - 1, 0, None), SYNC_REACH + 1)[before]
    by_order = np.clip(since // clock.interval_ns, 0, lost)
    elapsed = since + (clock.t_ns - clock.sent_ns)[before]
    counted = in_time & (lost == 0)
    usual = None
    if cycles and not (counted.all() and _amid_a_cycle(elapsed, clock.interval_ns)):
        usual = _usual_delay(t_ns, elapsed, counted, clock.interval_ns)
    passed = by_order
    if usual is not None:
        nearest = np.floor((elapsed - usual.delay) / clock.interval_ns + 0.5).astype(np.int64)
        passed = np.where(in_time & usual.known, np.clip(nearest, -1, lost + 1), by_order)
    first = t_ns < clock.t_ns[0]
    placed = np.where(first, passed == 1, passed <= SYNC_REACH)
    tick = np.where(placed, clock.tick[before] - first + passed, UNPLACED)
    tick, late = _in_rhythm(tick, t_ns, cycles)
    return Placement(
        tick,
        moved=int(np.count_nonzero(placed & (passed != by_order))),
        late=late,
        ambiguous=0 if usual is None else int(np.count_nonzero(placed & usual.unclear(elapsed, in_time))),
    )


def _since_sync(clock: SyncClock, t_ns: IntArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Return the SYNC before each frame, the time since, and whether the SYNCs around it are in time.

    For frames before the first SYNC it is the first, and the time since one a cycle before it.
    """
    slack = clock.interval_ns // IN_TIME
    regular = np.abs(np.diff(clock.t_ns) - np.diff(clock.tick) * clock.interval_ns) <= slack
    regular = np.concatenate([[True], regular, [True]])  # before the first, after the last
    at = np.searchsorted(clock.t_ns, t_ns, side="right")
    before = np.maximum(at - 1, 0)
    elapsed = t_ns - clock.t_ns[before] + np.where(at == 0, clock.interval_ns, 0)
    return before, elapsed, regular[at] & (elapsed >= 0)


def _amid_a_cycle(elapsed: IntArray, interval_ns: int) -> bool:
    """Whether all delays are within half a cycle that contains no SYNC: then no frame can be on its wrong side."""
    edge, low, high = interval_ns // BESIDE, int(elapsed.min()), int(elapsed.max())
    return edge <= low and high <= interval_ns - edge and 2 * (high - low) <= interval_ns


@dataclass(frozen=True, slots=True)
class _UsualDelay:
    """When frames of a message usually come after SYNC, at each frame (n,)."""

    delay: FloatArray  # ns, 0 to a cycle
    error: FloatArray  # its standard error, ns
    known: BoolArray
    interval_ns: int

    def unclear(self, elapsed: IntArray, in_time: BoolArray) -> BoolArray:
        """Return which frames (n,) could as well belong to the neighbouring cycle."""
        from_sync = np.minimum(self.delay, self.interval_ns - self.delay)
        own = elapsed % self.interval_ns
        beside = np.minimum(own, self.interval_ns - own) < self.interval_ns // BESIDE
        return np.where(self.known & in_time, from_sync < CLEAR * self.error, beside)


def _usual_delay(t_ns: IntArray, elapsed: IntArray, counted: BoolArray, interval_ns: int) -> _UsualDelay:
    """Return the mean of the delays as angles, over the frames within ``REACH_NS`` that are ``counted``."""
    angle = 2.0 * np.pi / interval_ns * elapsed
    low = np.searchsorted(t_ns, t_ns - REACH_NS, side="left")
    high = np.searchsorted(t_ns, t_ns + REACH_NS, side="right")
    sums = []
    for part in (np.cos(angle), np.sin(angle), np.ones(len(t_ns))):
        running = np.concatenate([[0], np.cumsum(np.where(counted, np.rint(COUNTS * part), 0.0).astype(np.int64))])
        sums.append((running[high] - running[low]) / COUNTS)
    x, y, count = sums
    most = np.maximum(count, 1.0)
    length = np.clip(np.hypot(x, y) / most, 1e-9, 1.0)
    spread = np.sqrt(-2.0 * np.log(length)) * interval_ns / (2.0 * np.pi)  # of a wrapped normal distribution
    return _UsualDelay(
        delay=np.arctan2(y, x) % (2.0 * np.pi) * interval_ns / (2.0 * np.pi),
        error=spread / np.sqrt(most),
        known=(count >= FEWEST) & (length >= CONCENTRATED),
        interval_ns=interval_ns,
    )


def _in_rhythm(tick: IntArray, t_ns: IntArray, cycles: int) -> tuple[IntArray, int]:
    """Return the SYNC numbers with frames that came one cycle after the beat of their message put back on it."""
    if cycles <= 1:
        return tick, 0
    placed = tick != UNPLACED
    beat = tick % cycles
    low = np.searchsorted(t_ns, t_ns - REACH_NS, side="left")
    high = np.searchsorted(t_ns, t_ns + REACH_NS, side="right")
    count = _among(placed, low, high)
    late = np.zeros(len(tick), np.bool_)
    for own in np.unique(beat[placed]):
        on_beat = placed & (beat == own)
        after = placed & (beat == (own + 1) % cycles)
        if after.any():
            late |= after & (count >= FEWEST) & (_among(on_beat, low, high) >= RHYTHM * count)
    late &= ~np.isin(tick - 1, tick)
    return np.where(late, tick - 1, tick), int(np.count_nonzero(late))


def _among(flags: BoolArray, low: IntArray, high: IntArray) -> IntArray:
    """Return how many of ``flags`` are set in each range ``[low, high)``."""
    running = np.concatenate([[0], np.cumsum(flags)])
    return np.asarray(running[high] - running[low])
