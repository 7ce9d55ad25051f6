"""The mileage of a wheelset's windows in the order of vehicle time, whatever its odometer did.

What is newest is what was measured last, not what has the highest mileage. An odometer that is reset or exchanged, or a
recording with a garbled mileage, makes a step that no vehicle runs: the mileage then goes on from what it was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

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

    Parameters
    ----------
    windows
        Of one wheelset between two reprofilings, oldest first.
    """
    known = [window.mileage_km if abs(window.mileage_km) <= MOST_KM else math.nan for window in windows]
    first = next((value for value in known if math.isfinite(value)), 0.0)
    found: list[float] = []
    shift, last, last_km, last_ns = 0.0, first, first, 0
    for window, stored in zip(windows, known, strict=True):
        if math.isnan(stored):  # it says nothing
            found.append(last_km)
            continue
        most = most_km((window.start_ns - last_ns) / NANOSECONDS)
        if not 0.0 <= stored - last <= most:
            shift = last_km + min(max(stored - last, 0.0), most) - stored
        last, last_km, last_ns = stored, stored + shift, window.start_ns
        found.append(last_km)
    return found


def mean_mileage(windows: Sequence[WindowRecord], half_life_km: float | None) -> float:
    """Return the mean mileage, weighted as forgetting weights the windows.

    Parameters
    ----------
    windows
        Oldest first, with running mileages.
    half_life_km
        Of forgetting; None for none.
    """
    newest = windows[-1].mileage_km
    weights = [1.0 if half_life_km is None else 0.5 ** ((newest - w.mileage_km) / half_life_km) for w in windows]
    return sum(weight * w.mileage_km for weight, w in zip(weights, windows, strict=True)) / sum(weights)


def most_km(seconds: float) -> float:
    """Return how far a vehicle can have run in some time, km.

    Parameters
    ----------
    seconds
        From 0.
    """
    return FASTEST_KM_S * min(seconds, HOUR_S) + MOST_KM_DAY * seconds / DAY_S
