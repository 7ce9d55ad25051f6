"""The mileage of a wheelset's windows in the order of vehicle time, whatever its odometer did.

What is newest is what was measured last, not what has the highest mileage. An odometer that is reset or exchanged, or a
recording with a garbled mileage, makes a step that no vehicle runs: the mileage then goes on from what it was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

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
    return [mileage_km for mileage_km, _ in running(windows, None)]


def running(windows: Sequence[WindowRecord], before: Odometer | None) -> list[tuple[float, Odometer]]:
    """Return the mileage of each window, km, and where the chain stands after it.

    Args:
        windows: Of one wheelset between two reprofilings, oldest first.
        before: Where the chain stands before the first of them; None where there is no earlier one.
    """
    at = before or _begin(windows)
    found: list[tuple[float, Odometer]] = []
    for window in windows:
        at = _read(at, window)
        found.append((at.last_km, at))
    return found


def known_mileage(stored_km: float) -> float:
    """Return a stored mileage, NaN where no wheelset can have run it."""
    return stored_km if abs(stored_km) <= MOST_KM else math.nan


def plausible_step(first: WindowRecord, second: WindowRecord) -> bool:
    """Whether the odometer made no impossible step from one window to a later one; both must have a reading."""
    step = known_mileage(second.mileage_km) - known_mileage(first.mileage_km)
    return 0.0 <= step <= most_km((second.start_ns - first.start_ns) / NANOSECONDS)


def _begin(windows: Sequence[WindowRecord]) -> Odometer:
    known = (known_mileage(window.mileage_km) for window in windows)
    first = next((value for value in known if math.isfinite(value)), 0.0)
    return Odometer(shift=0.0, last=first, last_km=first, last_ns=0, seen_ns=0)


def _read(at: Odometer, window: WindowRecord) -> Odometer:
    stored = known_mileage(window.mileage_km)
    if math.isnan(stored):  # it says nothing
        return replace(at, seen_ns=window.start_ns)
    most, shift = most_km((window.start_ns - at.last_ns) / NANOSECONDS), at.shift
    if not 0.0 <= stored - at.last <= most:
        shift = at.last_km + min(max(stored - at.last, 0.0), most) - stored
    return Odometer(shift, stored, stored + shift, window.start_ns, window.start_ns)


def most_km(seconds: float) -> float:
    """Return how far a vehicle can have run in some time, km.

    Args:
        seconds: From 0.
    """
    return FASTEST_KM_S * min(seconds, HOUR_S) + MOST_KM_DAY * seconds / DAY_S
