"""Windows that contradict how their vehicle is registered, against those that are left of the same time.

A test that refuses a window says nothing of it where it has too little to go by. Where most windows of some time are
refused for what is on file of the vehicle, the few that were not are no better.
"""

from __future__ import annotations

from collections.abc import Sequence

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord

CONTRADICTIONS = (ReasonCode.AXLE_DISTANCE, ReasonCode.SENSOR_TURNED, ReasonCode.AXES_REVERSED)
BEFORE_AND_AFTER_NS = 24 * 3600 * 10**9  # of the time that is looked at
MOST_SHARE = 0.5  # of all windows that may be refused so


def contradiction(refused: Sequence[WindowRecord], windows: Sequence[WindowRecord]) -> Reason | None:
    """Return why most windows of the time of some were refused; None where fewer were.

    Parameters
    ----------
    refused
        Windows of the same wheelset that were refused by one of ``CONTRADICTIONS``, oldest first.
    windows
        Oldest first, with tables.
    """
    if not windows:
        return None
    first, last = windows[0].start_ns - BEFORE_AND_AFTER_NS, windows[-1].start_ns + BEFORE_AND_AFTER_NS
    vehicles = {one.vehicle for one in windows}
    against = [one.reason for one in refused if one.vehicle in vehicles and first <= one.start_ns <= last]
    return against[-1] if len(against) > MOST_SHARE * (len(against) + len(windows)) else None
