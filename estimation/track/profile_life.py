"""The life of a profile: a wheelset between two reprofilings, and an interval of mileage in which it hardly wears."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.values.registry import WheelsetRecord
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True, order=True)
class ProfileLife:
    """A wheelset whose passes share one curve h(R); later lives of a wheelset are greater."""

    wheelset: str  # serial
    profile: int = 0  # number of reprofilings before
    interval: int = 0  # of mileage since the last reprofiling


def profile_life(wheelset: WheelsetRecord, record: WindowRecord, interval_km: float) -> ProfileLife:
    """Return the profile life that a window belongs to."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= record.start_ns]
    begin_km = max((item.mileage_km for item in turned), default=0.0)
    return ProfileLife(record.wheelset, len(turned), int((record.mileage_km - begin_km) // interval_km))
