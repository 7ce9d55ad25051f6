"""The geometry before another estimator was chosen, where the samples that this one works on are gone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from estimation.storage import UnitOfWork
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import Member

KEPT = Reason(
    ReasonCode.SAMPLES_PURGED, "the samples are purged: it stays as another estimator found it, before one was chosen"
)
NOTHING = Reason(ReasonCode.SAMPLES_PURGED, "the samples that the estimator works on are purged")


def purged(members: Iterable[Member]) -> bool:
    """Whether windows whose tables are summed have no samples any more.

    Parameters
    ----------
    members
        Those that have tables: where none has, their samples were purged before.
    """
    return all(one.window.record.samples_purged for one in members)


def kept(unit: UnitOfWork, made: GeometryRecord) -> GeometryRecord:
    """Return the geometry that a record without samples would follow, with the reason that it stays.

    Parameters
    ----------
    unit
        Geometries are read.
    made
        Of no sample, with the digest of what it was made from.
    """
    before = former(unit, made.wheelset, made.baseline, made.interval)
    if before is None or before.geometry.equivalent_conicity.value is None:
        unknown = Estimate.unknown(NOTHING, made.geometry.equivalent_conicity.count)
        geometry = replace(made.geometry, equivalent_conicity=unknown, status=unknown.status, reason=NOTHING)
        return replace(made, geometry=geometry)
    geometry = replace(before.geometry, status=Status.ESTIMATED, reason=KEPT)
    return replace(before, geometry=geometry, input_digest=made.input_digest, recorded_ns=made.recorded_ns)


def former(unit: UnitOfWork, wheelset: str, baseline: int, interval: int | None) -> GeometryRecord | None:
    """Return the geometry that is stored of an interval, or the current one; None where there is none.

    Parameters
    ----------
    unit
        Geometries are read.
    wheelset
        Serial.
    baseline, interval
        Its key; None is the current geometry.
    """
    if interval is None:
        return next((one for one in unit.geometries.baselines(wheelset) if one.baseline == baseline), None)
    found = unit.geometries.intervals(wheelset, baseline, first=interval, last=interval)
    return next(iter(found), None)
