"""Windows that contradict how their vehicle is registered, against those that are left of the same time.

A test that refuses a window says nothing of it where it has too little to go by. Where many windows of some time are
refused for what is on file of the vehicle, those that were not are no better.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord

CONTRADICTIONS = (ReasonCode.AXLE_DISTANCE, ReasonCode.SENSOR_TURNED, ReasonCode.AXES_REVERSED)
BEFORE_AND_AFTER_NS = 24 * 3600 * 10**9  # of the time that is looked at
MOST_SHARE = 0.3  # of all windows that may be refused so: of right vehicles hardly one in a thousand is


def contradiction(
    refused: Sequence[WindowRecord], vehicles: Collection[str], first_ns: int, last_ns: int, windows: int
) -> Reason | None:
    """Return why so many windows of the time of some were refused; None where fewer were.

    Args:
        refused: Windows of the same wheelset that were refused by one of ``CONTRADICTIONS``, oldest first.
        first_ns, last_ns: Start of the first and of the last of them.
    """
    first, last = first_ns - BEFORE_AND_AFTER_NS, last_ns + BEFORE_AND_AFTER_NS
    against = [one.reason for one in refused if one.vehicle in vehicles and first <= one.start_ns <= last]
    return against[-1] if len(against) > MOST_SHARE * (len(against) + windows) else None
