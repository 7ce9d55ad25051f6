"""Windows that contradict how their vehicle is registered, against those that are left of the same time.

A test that refuses a window says nothing of it where it has too little to go by. Where most windows of some time are
refused for what is on file of the vehicle, the few that were not are no better.
"""

from __future__ import annotations

from collections.abc import Sequence

from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord

CONTRADICTIONS = (ReasonCode.AXLE_DISTANCE, ReasonCode.SENSOR_TURNED, ReasonCode.AXES_REVERSED)
BEFORE_AND_AFTER_NS = 24 * 3600 * 10**9  # of the time that is looked at
MOST_SHARE = 0.5  # of all windows that may be refused so


def contradiction(unit: UnitOfWork, windows: Sequence[WindowRecord]) -> Reason | None:
    """Return why most windows of the time of some were refused; None where fewer were.

    Parameters
    ----------
    unit
        Windows are read.
    windows
        Of one wheelset, oldest first, with tables.
    """
    if not windows:
        return None
    first, last = windows[0].start_ns - BEFORE_AND_AFTER_NS, windows[-1].start_ns + BEFORE_AND_AFTER_NS
    refused = unit.windows.refused(windows[0].wheelset, CONTRADICTIONS, first, last)
    vehicles = {one.vehicle for one in windows}
    against = [one.reason for one in refused if one.vehicle in vehicles and one.reason is not None]
    share = len(against) / (len(against) + len(windows))
    return against[-1] if share > MOST_SHARE else None
