"""Which estimate belongs to a measurement of the same wheels: of the same profile, at nearly the same mileage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.contact.profiles import MeasuredProfiles
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.trend import IdentityChange


@dataclass(frozen=True, slots=True)
class EstimateOfDate:
    """The estimate that belongs to a measurement; ``reason`` is why there is none, or why it holds no number."""

    record: GeometryRecord | None
    reason: Reason | None


def baseline_at(wheelset: WheelsetRecord, at_ns: int) -> tuple[int, float]:
    """Return the number of reprofilings up to a time, and the mileage of the last of them (0 where there is none).

    Args:
        at_ns: Time, ns UTC; the profile of a reprofiling at that time is the new one.
    """
    turned = [item for item in wheelset.reprofilings if item.at_ns <= at_ns]
    return len(turned), max(turned, key=lambda item: item.at_ns).mileage_km if turned else 0.0


def estimate_of_date(
    measurement: MeasuredProfiles,
    wheelset: WheelsetRecord,
    intervals: Sequence[GeometryRecord],
    interval_km: float,
    change: IdentityChange | None = None,
) -> EstimateOfDate:
    """Return the estimate that belongs to a measurement, or why there is none.

    It is that of the mileage interval which contains the measurement, since the last reprofiling before it and with no
    data of after the next. Where that interval has no conicity it is the nearest one that has, if its mileage is
    within an interval of the measurement: in that distance a profile hardly wears.

    Args:
        intervals: Geometries of its mileage intervals, of all baselines.
        change: Its last identity change: estimates of the other side are of another wheelset.
    """
    baseline, begin_km = baseline_at(wheelset, measurement.at_ns)
    own = [one for one in intervals if one.baseline == baseline and one.interval is not None and one.geometry.windows]
    if not own:
        since = "the wheelset was new" if baseline == 0 else f"reprofiling {baseline}"
        return EstimateOfDate(None, Reason(ReasonCode.NO_GEOMETRY, f"nothing was estimated since {since}"))
    same = [one for one in own if _same_side(one, measurement.at_ns, change)]
    if not same:
        text = "all estimates of this profile are of another wheelset, or of one mounted the other way round"
        return EstimateOfDate(None, Reason(ReasonCode.IDENTITY_DOUBTFUL, text))
    containing = int((measurement.mileage_km - begin_km) // interval_km)
    chosen = next((one for one in same if one.interval == containing), None)
    if chosen is None or not _has_conicity(chosen):
        chosen = _nearest(measurement, same, interval_km) or chosen
    if chosen is None:
        least = min(abs(one.mileage_km - measurement.mileage_km) for one in same)
        text = f"the nearest estimate of this profile is {least:.0f} km from the measurement"
        return EstimateOfDate(None, Reason(ReasonCode.NO_ESTIMATE_NEAR, text))
    return EstimateOfDate(chosen, None if _has_conicity(chosen) else _why_not(chosen))


def _nearest(
    measurement: MeasuredProfiles, records: Sequence[GeometryRecord], within_km: float
) -> GeometryRecord | None:
    def apart(record: GeometryRecord) -> float:
        return abs(record.mileage_km - measurement.mileage_km)

    near = [one for one in records if _has_conicity(one) and apart(one) <= within_km]
    return min(near, key=apart, default=None)


def _has_conicity(record: GeometryRecord) -> bool:
    return any(one.status is Status.ESTIMATED for one in record.geometry.conicity)


def _why_not(record: GeometryRecord) -> Reason | None:
    return record.geometry.reason or record.geometry.equivalent_conicity.reason


def _same_side(record: GeometryRecord, at_ns: int, change: IdentityChange | None) -> bool:
    if change is None:
        return True
    if at_ns >= change.after_ns:
        return record.from_ns >= change.after_ns
    return record.to_ns <= change.before_ns
