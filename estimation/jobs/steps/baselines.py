"""The lives of a profile between reprofilings."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.values.registry import WheelsetRecord


@dataclass(frozen=True, slots=True)
class Baseline:
    """The life of a profile between two reprofilings, ``[from_ns, to_ns)``."""

    number: int
    from_ns: int
    to_ns: int | None
    mileage_km: float  # of the wheelset at its begin


def baselines(wheelset: WheelsetRecord) -> list[Baseline]:
    """Return the baselines of a wheelset, oldest first; number 0 begins when it was new."""
    turned = sorted(wheelset.reprofilings, key=lambda item: item.at_ns)
    starts = [(0, 0.0), *((item.at_ns, item.mileage_km) for item in turned)]
    ends: list[int | None] = [item.at_ns for item in turned] + [None]
    return [Baseline(i, a, b, km) for i, ((a, km), b) in enumerate(zip(starts, ends, strict=True))]
