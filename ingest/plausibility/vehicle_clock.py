"""Which TIME frames of a recording can be believed, and whether its place on the vehicle's clock can be."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from estimation.values.arrays import BoolArray, IntArray
from estimation.values.reasons import Reason, ReasonCode

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS

EARLIEST_NS = 946_684_800 * SECOND_NS
"""2000-01-01: a clock that shows less has not been set since it was switched on (CANopen's begins in 1984)."""

LATEST_NS = 4_102_444_800 * SECOND_NS
"""2100-01-01."""

FEWEST_ALIKE = 3
"""TIME frames in a row that agree and are a clock; fewer among others are odd ones."""

LONGEST_SPAN_NS = 31 * DAY_NS
"""From the first to the last frame of one recording."""

MOST_AHEAD_NS = DAY_NS
"""How far the vehicle's clock may be ahead of our time of receipt."""

OUR_CLOCK_SET_NS = 1_577_836_800 * SECOND_NS
"""2020-01-01: a receipt that says less was given while our own clock was not set, and shows nothing."""


def possible(vehicle_ns: IntArray) -> BoolArray:
    """Return which vehicle times (n,), ns UTC, are those of a clock that was set."""
    return np.asarray((vehicle_ns >= EARLIEST_NS) & (vehicle_ns < LATEST_NS))


def runs_alike(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> list[tuple[int, int]]:
    """Return the runs ``[first, behind)`` of TIME frames that agree with the one before.

    Args:
        t_ns, vehicle_ns: (n,) stamp of the recorder, increasing, and vehicle time.
    """
    if len(t_ns) == 0:
        return []
    edges = np.flatnonzero(np.abs(np.diff(vehicle_ns - t_ns)) > tolerance_ns) + 1
    ends = [0, *edges.tolist(), len(t_ns)]
    return list(pairwise(ends))


def without_odd_ones(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which TIME frames (n,) count: all but a few odd ones between two runs that agree with each other.

    Where the vehicle's clock was set the runs on both sides disagree, and all of their frames count.
    """
    kept = np.ones(len(t_ns), dtype=np.bool_)
    offset = vehicle_ns - t_ns
    before: int | None = None  # last frame of the last run that is a clock
    for first, behind in runs_alike(t_ns, vehicle_ns, tolerance_ns):
        if behind - first < FEWEST_ALIKE:
            continue
        if before is not None and abs(int(offset[first] - offset[before])) <= tolerance_ns:
            kept[before + 1 : first] = False
        before = behind - 1
    return kept


def believed(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which TIME frames (n,) show where a recording is: those of runs; all where there is no run."""
    found = np.zeros(len(t_ns), dtype=np.bool_)
    for first, behind in runs_alike(t_ns, vehicle_ns, tolerance_ns):
        found[first:behind] = behind - first >= FEWEST_ALIKE
    return found if found.any() else np.ones(len(t_ns), dtype=np.bool_)


def clock_verdict(first_ns: int, last_ns: int, received_ns: int) -> Reason | None:
    """Return why the place of a recording on the vehicle's clock cannot be believed; None where it can."""
    days = (last_ns - first_ns) / DAY_NS
    if last_ns - first_ns > LONGEST_SPAN_NS:
        text = (
            f"the recording spans {days:,.0f} days of the vehicle's clock, at most {LONGEST_SPAN_NS // DAY_NS} may be"
        )
        return Reason(ReasonCode.CLOCK_IMPLAUSIBLE, text)
    if received_ns >= OUR_CLOCK_SET_NS and last_ns > received_ns + MOST_AHEAD_NS:
        ahead = (last_ns - received_ns) / DAY_NS
        text = f"the vehicle's clock is {ahead:,.1f} days ahead of ours: one of both is wrong"
        return Reason(ReasonCode.CLOCK_IMPLAUSIBLE, text)
    return None
