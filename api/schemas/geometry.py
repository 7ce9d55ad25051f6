"""The bin table of a wheelset and the conicity that follows from it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import Field

from api.schemas.common import Derived, Links, Representation, Uncertain, finite, finite_list, segment, uncertain, why
from api.schemas.windows import UnestimatedBecause, unestimated_because
from api.times import Timestamp, to_rfc3339
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values.arrays import FloatArray
from estimation.values.error_parts import CommonTo, ErrorSource
from estimation.values.geometry import (
    COMBINATIONS,
    LEFT_OUT,
    BinStatus,
    BinValues,
    Centre,
    GeometryRecord,
    WheelsetGeometry,
)
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.trend import FleetWear
from estimation.values.units import IN_MM
from estimation.values.windows import WindowsOfReason as ReasonOfWindows
from estimation.values.windows import WindowState, WithoutEstimate
from fleet_db.stores.window_counts import WindowCounts

Counts = Counter[tuple[WindowState, ReasonCode | None]]


class BinColumn(Representation):
    """One combination over the bins; null where its status is not `estimated`."""

    value: list[float | None] = Field(description="Value in each bin; null where it is not estimated.")
    std: list[float | None] = Field(description="Standard deviation in each bin; null where it is not estimated.")
    status: list[BinStatus] = Field(description="Of each bin; only an estimated one has a value.")


class Bins(Representation):
    """The bin table, column by column; bins of lateral displacement of the wheelset, positive to the left."""

    lower_mm: list[float] = Field(description="Lower edge of each bin.")
    upper_mm: list[float] = Field(description="Upper edge of each bin.")
    samples_1: list[float | None] = Field(description="Effective number of samples.")
    rolling_radius_sum_mm: BinColumn = Field(description="rL + rR.")
    rolling_radius_difference_mm: BinColumn = Field(description="rL - rR.")
    contact_angle_sum_rad: BinColumn = Field(description="Left plus right contact angle.")
    contact_angle_difference_rad: BinColumn = Field(description="Left minus right contact angle.")


class ConicityAtAmplitude(Representation):
    """Equivalent conicity tan(gamma_e) at one amplitude of the wheelset's motion (EN 15302)."""

    amplitude_mm: float
    equivalent_conicity_1: Uncertain = Field(description="Equivalent conicity at this amplitude.")


class ErrorPart(Representation):
    """A part of the error of the conicity, which several numbers have in common: their differences are without it."""

    source: ErrorSource = Field(description="Where it comes from.")
    common_to: CommonTo = Field(description="The numbers that err alike by it.")
    change_1: float = Field(description="Change of the conicity per standard deviation; parts add up as squares.")


class ConicityCentre(Derived, of=Centre):
    """The point a conicity is about; in EN 15302 it is the one about equal rolling radii."""


_NOT_MADE_FROM = ("wheelset", "baseline", "interval", "mileage_km", "from_ns", "to_ns", "geometry", "recorded_ns")


class Provenance(Derived, of=GeometryRecord, without=_NOT_MADE_FROM):
    """What an estimate was made from; the same inputs and code give the same numbers."""

    parameter_key: str = Field(description="Digest of the parameters of its bin tables.")
    track_versions: dict[str, list[int]] = Field(
        description="By section, the versions of its alignment that the windows were estimated with, increasing."
    )


_AS_BINS = (
    *("bin_edges", "samples", "rolling_radius_sum", "rolling_radius_difference", "contact_angle_sum"),
    *("contact_angle_difference", "amplitude", "conicity", "parameter_key", "error_sources", "error_effects"),
)


class Geometry(Derived, of=WheelsetGeometry, without=_AS_BINS):
    """Contact geometry of one wheelset, estimated from the data since its last reprofiling.

    Where nothing was ever estimated the numbers are null, the bins empty, and `unestimated_because` explains it.
    """

    wheelset: str = Field(examples=["WS-0001"])
    unestimated_because: UnestimatedBecause | None = Field(
        description="Why nothing is estimated now, by its windows; null where something is, and with `as_of`."
    )
    baseline: int = Field(description="Number of reprofilings before it.")
    mileage_km: float | None = Field(description="Weighted mean mileage of its windows since the wheelset was new.")
    measured_from: Timestamp | None = Field(description="Begin of its data; null without a geometry.")
    measured_to: Timestamp | None = Field(description="End of its data, not included; null without a geometry.")
    recorded_at: Timestamp | None = Field(description="When it was recorded; null without a geometry.")
    equivalent_conicity_at_3_mm_1: Uncertain = Field(
        description="What limits are compared with; where the motion does not cover 3 mm extrapolated, see `reason`."
    )
    windows_left_out: dict[str, int] | None = Field(
        description="Windows since the last reprofiling that are not believed, by reason; null without a geometry."
    )
    conicity_by_amplitude: list[ConicityAtAmplitude] = Field(
        description="Equivalent conicity at each amplitude (EN 15302)."
    )
    error_parts: list[ErrorPart] = Field(
        description="What the error of `equivalent_conicity_1` is made of; empty without a conicity."
    )
    bins: Bins = Field(description="The bin table.")
    provenance: Provenance | None = Field(description="What it was made from; null without a geometry.")
    links: Links


def _column(values: BinValues, scale: float) -> BinColumn:
    def served(numbers: FloatArray) -> list[float | None]:
        pairs = zip(numbers, values.status, strict=True)
        return [finite(number, scale) if status is BinStatus.ESTIMATED else None for number, status in pairs]

    return BinColumn(value=served(values.value), std=served(values.std), status=list(values.status))


def geometry(
    record: GeometryRecord, without: WithoutEstimate | None = None, fleet: FleetWear | None = None
) -> Geometry:
    """Return the representation of a geometry estimate.

    Args:
        without: Why it holds no number now.
        fleet: What its trend knows of wheelsets like it, which say how its conicity goes on up to 3 mm.
    """
    shown = _geometry(record.wheelset, record.baseline, record.geometry, without, fleet)
    here = shown.links["self"]
    shown.links["as_recorded"] = f"{here}?as_of={to_rfc3339(record.recorded_ns)}"
    for section, versions in sorted(record.track_versions.items()):
        path = f"/v1/track-sections/{segment(section)}/alignment?version={versions[-1]}"
        shown.links[f"alignment:{section}"] = path
    of_record = {
        "mileage_km": finite(record.mileage_km),
        "measured_from": to_rfc3339(record.from_ns),
        "measured_to": to_rfc3339(record.to_ns),
        "recorded_at": to_rfc3339(record.recorded_ns),
        "windows_left_out": _left_out(record),
        "provenance": Provenance.made(
            record,
            parameter_key=record.geometry.parameter_key,
            track_versions={section: list(versions) for section, versions in record.track_versions.items()},
        ),
    }
    return shown.model_copy(update=of_record)


def no_geometry(serial: str, baseline: int, reason: Reason, without: WithoutEstimate | None = None) -> Geometry:
    """Return the representation of a wheelset of which nothing was ever estimated."""
    empty = BinValues(np.zeros(0), np.zeros(0), ())
    parts: dict[str, Any] = dict.fromkeys(COMBINATIONS, empty)
    parts |= dict.fromkeys(("equivalent_conicity", "nonlinearity", "zero_crossing"), Estimate.unknown(reason))
    parts |= {"bin_edges": np.zeros(1), "samples": np.zeros(0), "amplitude": np.zeros(0), "conicity": ()}
    parts |= {"reported_amplitude": np.nan, "windows": 0, "parameter_key": "", "status": Status.UNESTIMATED}
    return _geometry(serial, baseline, WheelsetGeometry(**parts, reason=reason), without)


def _geometry(
    serial: str,
    baseline: int,
    estimate: WheelsetGeometry,
    without: WithoutEstimate | None,
    fleet: FleetWear | None = None,
) -> Geometry:
    reason = estimate.reason if without is None else without.reason
    path = f"/v1/wheelsets/{segment(serial)}"
    of_record = ("mileage_km", "measured_from", "measured_to", "recorded_at", "windows_left_out", "provenance")
    return Geometry.made(
        estimate,
        **dict.fromkeys(of_record, None),
        wheelset=serial,
        **why(reason),
        unestimated_because=unestimated_because(without),
        baseline=baseline,
        equivalent_conicity_at_3_mm_1=uncertain(conicity_at_limit_amplitude(estimate, fleet)),
        conicity_by_amplitude=[
            ConicityAtAmplitude(amplitude_mm=float(amplitude) * IN_MM, equivalent_conicity_1=uncertain(conicity))
            for amplitude, conicity in zip(estimate.amplitude, estimate.conicity, strict=True)
        ],
        error_parts=_error_parts(estimate),
        bins=bin_table(estimate),
        links={"self": f"{path}/geometry", "wheelset": path, "trend": f"{path}/trend", "windows": f"{path}/windows"},
    )


def _error_parts(estimate: WheelsetGeometry) -> list[ErrorPart]:
    if estimate.equivalent_conicity.value is None or not estimate.error_sources:
        return []
    place = int(np.argmin(np.abs(estimate.amplitude - estimate.reported_amplitude)))
    effects = zip(estimate.error_sources, estimate.error_effects[:, place], strict=True)
    return [
        ErrorPart(source=source, common_to=source.common_to, change_1=float(change))
        for source, change in effects
        if np.isfinite(change)
    ]


def _left_out(record: GeometryRecord) -> dict[str, int] | None:
    stored = record.parameters.get(LEFT_OUT)
    if not isinstance(stored, dict):
        return None
    return {code: count for code, count in stored.items() if isinstance(count, int)}


def bin_table(estimate: WheelsetGeometry) -> Bins:
    """Return the bin table of an estimate."""
    edges = [float(edge) * IN_MM for edge in estimate.bin_edges]
    return Bins(
        lower_mm=edges[:-1],
        upper_mm=edges[1:],
        samples_1=finite_list(estimate.samples),
        rolling_radius_sum_mm=_column(estimate.rolling_radius_sum, IN_MM),
        rolling_radius_difference_mm=_column(estimate.rolling_radius_difference, IN_MM),
        contact_angle_sum_rad=_column(estimate.contact_angle_sum, 1.0),
        contact_angle_difference_rad=_column(estimate.contact_angle_difference, 1.0),
    )


def table(geometry_: Geometry) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the bin table as a header and rows, one row a bin."""
    bins = geometry_.bins
    units = {name: "mm" if name.startswith("rolling") else "rad" for name in COMBINATIONS}
    header = ["lower_mm", "upper_mm", "samples_1"]
    columns: list[Sequence[object]] = [bins.lower_mm, bins.upper_mm, bins.samples_1]
    for name, unit in units.items():
        column: BinColumn = getattr(bins, f"{name}_{unit}")
        header += [f"{name}_{unit}", f"{name}_std_{unit}", f"{name}_status"]
        columns += [column.value, column.std, [str(status) for status in column.status]]
    return header, list(zip(*columns, strict=True))


class Interval(
    Derived,
    of=GeometryRecord,
    without=("geometry", "input_digest", "track_versions", "parameters", "code_version", "recorded_ns"),
    columns="wheelset baseline interval mileage_km measured_from measured_to n_windows status reason reason_code"
    " equivalent_conicity_at_3_mm_1",
):
    """What was estimated from one stretch of mileage between two visits to the lathe."""

    interval: int = Field(description="Number of the mileage interval since the last reprofiling, from 0.")
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


def interval(record: GeometryRecord, fleet: FleetWear | None = None) -> Interval:
    """Return the representation of what was estimated from one stretch of mileage; ``fleet`` as of a geometry."""
    return Interval.made(
        record,
        interval=record.interval or 0,
        n_windows=record.geometry.windows,
        status=record.geometry.status,
        **why(record.geometry.reason),
        equivalent_conicity_at_3_mm_1=uncertain(conicity_at_limit_amplitude(record.geometry, fleet)),
    )


def data_quality(serial: str, counted: WindowCounts, waiting: Sequence[ReasonOfWindows]) -> DataQuality:
    """Return the representation of the windows of a wheelset over time."""
    stretches: dict[int, Counts] = {}
    total: Counts = Counter()
    for count in counted.counts:
        stretches.setdefault(count.from_ns, Counter())[count.state, count.code] = count.windows
        if count.state is not WindowState.PENDING:
            total[count.state, count.code] += count.windows
    for windows in waiting:
        total[windows.state, code_of(windows.reason)] += windows.windows
    path = f"/v1/wheelsets/{segment(serial)}"
    return DataQuality(
        wheelset=serial,
        total=_by_reason(dict(total.most_common())),
        over_time=[
            QualityOfTime(
                measured_from=to_rfc3339(from_ns),
                measured_to=to_rfc3339(from_ns + counted.stretch_ns),
                windows_by_reason=_by_reason(counts),
            )
            for from_ns, counts in stretches.items()
        ],
        links={"self": f"{path}/data-quality", "wheelset": path, "windows": f"{path}/windows"},
    )


def _by_reason(counts: Mapping[tuple[WindowState, ReasonCode | None], int]) -> list[WindowsOfReason]:
    return [WindowsOfReason(state=state, reason_code=code, windows=n) for (state, code), n in counts.items()]
