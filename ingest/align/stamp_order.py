"""Frames by the order of stamps: the SYNC before each, and whether their delays after SYNC leave a doubt about that.

Most recordings leave none; only where they do :mod:`ingest.align.cycles` asks when frames of a message usually come.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import IntArray

SYNC_REACH = 5
"""Cycles without SYNC that the recorder's clock may bridge."""

IN_TIME = 4
"""SYNCs are in time whose stamps are a whole number of cycles apart, to a fourth of one."""

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
    """Return the SYNC number (n,) of frames by the order of stamps, and whether their delays agree with that.

    Args:
        sync_ns, number, sent_ns, interval_ns: As in ``SyncClock``, at least one.
        t_ns: (n,) stamps of frames, ascending, ns.
    """
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
