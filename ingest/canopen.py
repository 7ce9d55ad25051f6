"""What CANopen (CiA 301) fixes: identifiers of the predefined connection set, the SYNC counter, TIME_OF_DAY.

The SYNC producer is the keeper of the vehicle's clock: SYNC number ``k`` is sent at ``k`` sampling intervals after the
Unix epoch on that clock, and its counter is ``1 + k mod 240``. So one TIME frame that is right to a tenth of a second
gives the exact instant of every SYNC around it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.values.arrays import IntArray

SYNC_ID = 0x080
TIME_ID = 0x100

SYNC_PERIOD = 240
"""The counter runs 1..240 (CiA 301, object 1019h)."""

NANOSECONDS = 1_000_000_000
DAY_MS = 86_400_000
EPOCH_DAYS = 5113
"""Days from 1970-01-01 to 1984-01-01, where CANopen's TIME_OF_DAY begins."""


def sync_counter(tick: npt.ArrayLike) -> IntArray:
    """Return the counter that the SYNC number ``tick`` (sampling intervals since 1970-01-01) carries: 1..240."""
    return np.asarray(tick, dtype=np.int64) % SYNC_PERIOD + 1


def time_of_day(t_ns: npt.ArrayLike) -> tuple[IntArray, IntArray]:
    """Return ``(milliseconds after midnight, days since 1984-01-01)`` of vehicle times in ns UTC, truncated."""
    milliseconds = np.asarray(t_ns, dtype=np.int64) // 1_000_000
    return milliseconds % DAY_MS, milliseconds // DAY_MS - EPOCH_DAYS


def vehicle_time_ns(milliseconds: npt.ArrayLike, days: npt.ArrayLike) -> IntArray:
    """Return the vehicle time in ns UTC of a TIME frame.

    Args:
        milliseconds: (n,) after midnight.
        days: (n,) since 1984-01-01.
    """
    whole_days = np.asarray(days, dtype=np.int64) + EPOCH_DAYS
    return (whole_days * DAY_MS + np.asarray(milliseconds, dtype=np.int64)) * 1_000_000
