"""What a trend needs of the geometry of a mileage interval: the conicities that are known, without the bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimation.values.geometry import GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import Reason


class KnownConicity(NamedTuple):
    """An equivalent conicity that is estimated, with its amplitude in m."""

    amplitude: float
    value: float
    std: float


@dataclass(frozen=True, slots=True)
class IntervalConicities:
    """The known conicities of one interval of one wheelset, in the order of their amplitudes.

    ``reason`` is why there is none; None where there is one.
    """

    baseline: int
    interval: int | None
    mileage_km: float
    from_ns: int
    to_ns: int
    windows: int
    input_digest: str
    code_version: str
    known: tuple[KnownConicity, ...]
    reason: Reason | None


def known_conicities(geometry: WheelsetGeometry) -> tuple[KnownConicity, ...]:
    """Return the conicities of a geometry that are estimated, in the order of their amplitudes."""
    pairs = list(zip(geometry.amplitude.tolist(), geometry.conicity, strict=True))
    if np.isfinite(geometry.reported_amplitude):
        pairs.append((geometry.reported_amplitude, geometry.equivalent_conicity))
    known = [
        KnownConicity(amplitude, estimate.value, estimate.std)
        for amplitude, estimate in pairs
        if estimate.status is Status.ESTIMATED and estimate.value is not None and estimate.std is not None
    ]
    return tuple(sorted(known, key=lambda one: one.amplitude))


def why_no_conicity(geometry: WheelsetGeometry) -> Reason | None:
    """Return why a geometry has no conicity, of the conicity or else of the geometry; None where it has one."""
    return None if known_conicities(geometry) else geometry.equivalent_conicity.reason or geometry.reason


def interval_conicities(record: GeometryRecord) -> IntervalConicities:
    """Return the conicities of an interval's geometry."""
    geometry = record.geometry
    return IntervalConicities(
        baseline=record.baseline,
        interval=record.interval,
        mileage_km=record.mileage_km,
        from_ns=record.from_ns,
        to_ns=record.to_ns,
        windows=geometry.windows,
        input_digest=record.input_digest,
        code_version=record.code_version,
        known=known_conicities(geometry),
        reason=why_no_conicity(geometry),
    )
