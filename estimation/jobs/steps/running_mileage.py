"""The mileage of a wheelset's windows in the order of vehicle time, whatever its odometer did.

What is newest is what was measured last, not what has the highest mileage. An odometer that is reset or exchanged, or a
recording with a garbled mileage, makes a step that no vehicle runs: the mileage then goes on from what it was.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from estimation.values.roll_up import Odometer
from estimation.values.windows import WindowRecord

NANOSECONDS = 1_000_000_000
FASTEST_KM_S = 0.15  # that a vehicle runs for an hour
HOUR_S = 3600.0
MOST_KM_DAY = 3000.0  # that a vehicle runs on every day
DAY_S = 86_400.0
MOST_KM = 1e8  # that a wheelset can have run


def running_mileage(windows: Sequence[WindowRecord]) -> list[float]:
    """Return the mileage of each window, km; never decreasing.

    Where the odometer made no impossible step it is the mileage as stored, bit for bit.

    Args:
        windows: Of one wheelset between two reprofilings, oldest first.
    """
    at, found = first_reading(windows), []
    for window in windows:
        at = read(at, window)
        found.append(at.last_km)
    return found


def first_reading(windows: Iterable[WindowRecord]) -> Odometer:
    """Return where the chain of mileages begins that has no window before these.

    Args:
        windows: As in :func:`running_mileage`.
    """
    known = (known_mileage(window.mileage_km) for window in windows)
    first = next((value for value in known if math.isfinite(value)), 0.0)
    return Odometer(last=first, last_km=first, last_ns=0)


def known_mileage(stored_km: float) -> float:
    """Return a stored mileage, NaN where no wheelset can have run it."""
    return stored_km if abs(stored_km) <= MOST_KM else math.nan


def read(at: Odometer, window: WindowRecord) -> Odometer:
    """Return where the chain of mileages stands after a window; without a reading it says nothing.

    It depends on nothing but the last window with a reading, its mileage as stored and as run: so the chain goes on
    from any window of which both are kept.
    """
    stored = known_mileage(window.mileage_km)
    if math.isnan(stored):
        return at
    step, most = stored - at.last, most_km((window.start_ns - at.last_ns) / NANOSECONDS)
    if 0.0 <= step <= most:
        # rounded twice where the odometer was exchanged once; it never goes back
        return Odometer(stored, max(at.last_km, stored + (at.last_km - at.last)), window.start_ns)
    return Odometer(stored, at.last_km + min(max(step, 0.0), most), window.start_ns)


def most_km(seconds: float) -> float:
    """Return how far a vehicle can have run in some time, km.

    Args:
        seconds: From 0.
    """
    return FASTEST_KM_S * min(seconds, HOUR_S) + MOST_KM_DAY * seconds / DAY_S
