"""Which SYNC cycle a frame was produced in, from stamps that jitter.

On the bus a frame follows its SYNC, at once or shortly before the next one. A recorder's stamps may put it on the other
side of a SYNC. What decides is when frames of its message usually come: the mean delay after SYNC over the seconds
around it, which is within the cycle. A frame is placed where its own delay is nearest to that. A message of low
priority that a full bus holds back until after the next SYNC is known by its rhythm: the others come every n cycles.

Frames by the order of stamps: the SYNC before each, and whether their delays after SYNC leave a doubt about that.

Most recordings leave none; only where they do it matters when frames of a message usually come.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray

REACH_NS = 2_000_000_000
"""Frames of a message this near decide its usual delay and its rhythm; less than the reach of TIME, which joins
recordings."""

FEWEST = 3  # frames that give a usual delay
CONCENTRATED = 0.7
"""Least mean resultant length of the delays as angles: above it they have a usual value. Uniform over half a cycle:
0.64."""

RHYTHM = 0.6  # share of frames on the same beat from which a message has a rhythm
CLEAR = 2.0  # standard errors that the usual delay must be away from a SYNC, to say on which side of it frames belong
SMOOTHED = 4  # SYNCs on either side whose stamps are averaged: a stamp alone makes late frames look like early ones
_COUNTS = 1 << 20  # of a unit vector: sums of whole numbers do not depend on where a recording was cut


@dataclass(frozen=True, slots=True)
class SyncClock(FrozenArrays):
    """The SYNCs whose numbers are known, by the recorder's time."""

    t_ns: Annotated[IntArray, "n"]  # (k,) recorder
    tick: Annotated[IntArray, "n"]  # (k,) sampling intervals since the Unix epoch, vehicle
    sent_ns: Annotated[IntArray, "n"]  # (k,) recorder, with less jitter than the stamps
    interval_ns: int


@dataclass(frozen=True, slots=True)
class Placement:
    """The SYNC numbers of the frames of one message."""

    tick: IntArray  # (n,) or ``UNPLACED``
    moved: int = 0  # across the SYNC beside them, by the usual delay of their message
    late: int = 0  # sent after the next SYNC: by the rhythm of their message
    ambiguous: int = 0  # beside a SYNC, and nothing says to which side they belong


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
    of_clock = (clock.t_ns, clock.tick, clock.sent_ns, clock.interval_ns)
    tick, by_order = by_stamps(*of_clock, t_ns)
    moved, ambiguous = 0, by_order.beside if cycles else 0
    if cycles and not by_order.is_certain(clock.interval_ns):
        tick, moved, ambiguous = _by_usual_delay(clock, t_ns)
    tick, late = _in_rhythm(tick, t_ns, cycles)
    return Placement(tick, moved=moved, late=late, ambiguous=ambiguous)


def _by_usual_delay(clock: SyncClock, t_ns: IntArray) -> tuple[IntArray, int, int]:
    """Return the SYNC number of frames by their usual delay, how many that moves, and how many it leaves unclear."""
    slack = clock.interval_ns // IN_TIME
    regular = np.abs(np.diff(clock.t_ns) - np.diff(clock.tick) * clock.interval_ns) <= slack
    regular = np.concatenate([[True], regular, [True]])  # before the first, after the last
    at = np.searchsorted(clock.t_ns, t_ns, side="right")
    before = np.maximum(at - 1, 0)  # of frames before the first SYNC the first, a cycle later than one before it
    since = t_ns - clock.t_ns[before] + np.where(at == 0, clock.interval_ns, 0)
    in_time = regular[at] & (since >= 0)
    lost = np.append(np.clip(np.diff(clock.tick) - 1, 0, None), SYNC_REACH + 1)[before]
    by_order = np.clip(since // clock.interval_ns, 0, lost)
    elapsed = since + (clock.t_ns - clock.sent_ns)[before]
    usual = _usual_delay(t_ns, elapsed, in_time & (lost == 0), clock.interval_ns)
    nearest = np.floor((elapsed - usual.delay) / clock.interval_ns + 0.5).astype(np.int64)
    passed = np.where(in_time & usual.known, np.clip(nearest, -1, lost + 1), by_order)
    first = t_ns < clock.t_ns[0]
    placed = np.where(first, passed == 1, passed <= SYNC_REACH)
    tick = np.where(placed, clock.tick[before] - first + passed, UNPLACED)
    moved = int(np.count_nonzero(placed & (passed != by_order)))
    return tick, moved, int(np.count_nonzero(placed & usual.unclear(elapsed, in_time)))


def sync_clock_of(t_ns: IntArray, tick: IntArray, interval_ns: int) -> SyncClock:
    """Return the clock of SYNCs with these stamps and numbers.

    When each was sent follows from its stamp and those of its neighbours, where they are in time. The mean is over
    whole numbers, so it does not depend on where a recording was cut.
    """
    if len(t_ns) == 0:
        return SyncClock(t_ns, tick, t_ns, interval_ns)
    offset = t_ns - tick * interval_ns
    out_of_time = np.abs(np.diff(offset)) > interval_ns // IN_TIME
    out_of_time |= np.diff(t_ns) > SYNC_REACH * interval_ns
    broken = np.concatenate([[0], np.cumsum(out_of_time)])  # before each SYNC
    at = np.arange(len(offset))
    low, high = np.maximum(at - SMOOTHED, 0), np.minimum(at + SMOOTHED, len(offset) - 1)
    running = np.concatenate([[0], np.cumsum(offset - offset[0])])
    mean = offset[0] + (running[high + 1] - running[low]) // (high + 1 - low)
    sent_ns = np.where(broken[high] == broken[low], tick * interval_ns + mean, t_ns)
    return SyncClock(t_ns, tick, sent_ns, interval_ns)


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
    low, high = within_reach(t_ns)
    sums = []
    for part in (np.cos(angle), np.sin(angle), np.ones(len(t_ns))):
        running = np.concatenate([[0], np.cumsum(np.where(counted, np.rint(_COUNTS * part), 0.0).astype(np.int64))])
        sums.append((running[high] - running[low]) / _COUNTS)
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


@compiled(nogil=True)
def within_reach(t_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Return the first frame (n,) within ``REACH_NS`` of each, and the one behind the last."""
    low, high = np.empty(len(t_ns), np.int64), np.empty(len(t_ns), np.int64)
    first = behind = 0
    for i in range(len(t_ns)):
        while t_ns[first] < t_ns[i] - REACH_NS:
            first += 1
        while behind < len(t_ns) and t_ns[behind] <= t_ns[i] + REACH_NS:
            behind += 1
        low[i], high[i] = first, behind
    return low, high


def _in_rhythm(tick: IntArray, t_ns: IntArray, cycles: int) -> tuple[IntArray, int]:
    """Return the SYNC numbers with frames that came one cycle after the beat of their message put back on it."""
    if cycles <= 1:
        return tick, 0
    placed = tick != UNPLACED
    beat = tick % cycles
    beats = np.unique(beat[placed])
    if not np.isin((beats + 1) % cycles, beats).any():
        return tick, 0
    low, high = within_reach(t_ns)
    count = _among(placed, low, high)
    late = np.zeros(len(tick), np.bool_)
    for own in beats:
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


SYNC_REACH = 5  # cycles without SYNC that the recorder's clock may bridge
IN_TIME = 4  # SYNCs are in time whose stamps are a whole number of cycles apart, to a fourth of one
BESIDE = 20
"""Where the usual delay is not known, frames are beside a SYNC that are nearer to it than a twentieth of a cycle."""

NARROW = 16
"""Delays within a sixteenth of a cycle, and a twentieth away from a SYNC, have a usual value that is clear of it: the
standard error of three of them is below 0.02 cycles."""

UNPLACED = -1


class ByOrder(NamedTuple):
    """What frames show that are placed by the SYNC before their stamps."""

    lowest: int  # ns, delay after the SYNC of their cycle, of those between SYNCs that are in time
    highest: int
    same: bool  # whether by their delays, too, those are in the cycle in which they are placed
    all_counted: bool  # whether all are between SYNCs that are in time, and none of those is lost
    beside: int  # of those between SYNCs that are not in time, nearer to one than a twentieth of a cycle

    def is_certain(self, interval_ns: int) -> bool:
        """Whether no frame between SYNCs that are in time can be on the wrong side of one, nor seem so.

        All delays are within half a cycle that contains no SYNC. Where some do not count for the usual delay, they
        are so near to each other that it is clear from any three.
        """
        edge = interval_ns // BESIDE
        amid = edge <= self.lowest and self.highest <= interval_ns - edge
        width = (2 if self.all_counted else NARROW) * (self.highest - self.lowest)
        return self.same and amid and width <= interval_ns


@compiled(nogil=True)
def by_stamps(
    sync_ns: IntArray, number: IntArray, sent_ns: IntArray, interval_ns: int, t_ns: IntArray
) -> tuple[IntArray, ByOrder]:
    """Return the SYNC number (n,) of frames by the order of stamps, and whether their delays agree with that."""
    slack = interval_ns // IN_TIME
    tick = np.full(len(t_ns), UNPLACED)
    lowest, highest, beside = interval_ns, 0, 0
    same = all_counted = True
    at = 0
    for i in range(len(t_ns)):
        while at < len(sync_ns) and sync_ns[at] <= t_ns[i]:
            at += 1
        before = max(at - 1, 0)
        since = t_ns[i] - sync_ns[before] + (0 if at else interval_ns)
        lost = max(number[before + 1] - number[before] - 1, 0) if before + 1 < len(number) else SYNC_REACH + 1
        passed = min(max(since // interval_ns, 0), lost)
        if passed == 1 if at == 0 else passed <= SYNC_REACH:
            tick[i] = number[before] + passed - (at == 0)
        in_time = since >= 0
        if 0 < at < len(sync_ns):
            step = sync_ns[at] - sync_ns[before]
            in_time = in_time and abs(step - (number[at] - number[before]) * interval_ns) <= slack
        all_counted = all_counted and in_time and lost == 0
        turns, own = divmod(since + sync_ns[before] - sent_ns[before], interval_ns)
        if in_time:
            same = same and turns == passed
            lowest, highest = min(lowest, own), max(highest, own)
        elif tick[i] != UNPLACED and min(own, interval_ns - own) < interval_ns // BESIDE:
            beside += 1
    return tick, ByOrder(lowest, highest, same, all_counted, beside)
