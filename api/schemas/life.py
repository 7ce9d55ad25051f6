"""A wheelset over its life: the conicity of every mileage interval, and its windows counted over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, finite, uncertain
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values import window_reasons
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of, text_of
from estimation.values.windows import WindowState
from fleet_db.stores.window_counts import WindowCounts


class Interval(Representation):
    """What was estimated from one stretch of mileage between two visits to the lathe."""

    wheelset: str = Field(examples=["WS-0001"])
    baseline: int
    interval: int = Field(description="Number of the mileage interval since the last reprofiling, from 0.")
    mileage_km: float | None = Field(description="Weighted mean mileage of its windows since the wheelset was new.")
    measured_from: Timestamp
    measured_to: Timestamp
    n_windows: int
    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    equivalent_conicity_at_3_mm_1: Uncertain = Field(
        description="What limits are compared with; where the motion does not cover 3 mm extrapolated, see `reason`."
    )


class WindowsOfReason(Representation):
    """How many windows have one state for one reason."""

    state: WindowState
    reason_code: ReasonCode | None = Field(description="Why they are refused, or wait; null for the others.")
    windows: int = Field(description="How many.")


class QualityOfTime(Representation):
    """The windows that begin in one stretch of time."""

    measured_from: Timestamp
    measured_to: Timestamp
    windows_by_reason: list[WindowsOfReason] = Field(description="By state and reason.")


class DataQuality(Representation):
    """Windows of a wheelset over time: how many are accepted, and why the others are not."""

    wheelset: str = Field(examples=["WS-0001"])
    total: list[WindowsOfReason] = Field(description="Over all time, by state and reason; the most frequent first.")
    over_time: list[QualityOfTime] = Field(
        description="Stretches of time that have windows, the oldest first; at most 100, in whole days."
    )
    links: Links


def interval(record: GeometryRecord) -> Interval:
    """Return the representation of what was estimated from one stretch of mileage."""
    found = record.geometry
    return Interval(
        wheelset=record.wheelset,
        baseline=record.baseline,
        interval=record.interval or 0,
        mileage_km=finite(record.mileage_km),
        measured_from=to_rfc3339(record.from_ns),
        measured_to=to_rfc3339(record.to_ns),
        n_windows=found.windows,
        status=found.status,
        reason=text_of(found.reason),
        reason_code=code_of(found.reason),
        equivalent_conicity_at_3_mm_1=uncertain(conicity_at_limit_amplitude(found)),
    )


def data_quality(serial: str, found: WindowCounts, waiting: Sequence[window_reasons.WindowsOfReason]) -> DataQuality:
    """Return the representation of the windows of a wheelset over time.

    Args:
        waiting: Those that wait, by what they wait for.
    """
    stretches: dict[int, dict[tuple[WindowState, ReasonCode | None], int]] = {}
    total: dict[tuple[WindowState, ReasonCode | None], int] = {}
    for one in found.counts:
        key = one.state, one.code
        stretches.setdefault(one.from_ns, {})[key] = one.windows
        if one.state is not WindowState.PENDING:
            total[key] = total.get(key, 0) + one.windows
    for item in waiting:
        key = item.state, code_of(item.reason)
        total[key] = total.get(key, 0) + item.windows
    own = f"/v1/wheelsets/{segment(serial)}"
    return DataQuality(
        wheelset=serial,
        total=_by_reason(dict(sorted(total.items(), key=lambda item: -item[1]))),
        over_time=[
            QualityOfTime(
                measured_from=to_rfc3339(from_ns),
                measured_to=to_rfc3339(from_ns + found.stretch_ns),
                windows_by_reason=_by_reason(counts),
            )
            for from_ns, counts in stretches.items()
        ],
        links={"self": f"{own}/data-quality", "wheelset": own, "windows": f"{own}/windows"},
    )


def _by_reason(counts: Mapping[tuple[WindowState, ReasonCode | None], int]) -> list[WindowsOfReason]:
    return [WindowsOfReason(state=state, reason_code=code, windows=n) for (state, code), n in counts.items()]
