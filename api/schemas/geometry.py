"""The bin table of a wheelset and the conicity that follows from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field, JsonValue

from api.schemas.common import Links, Representation, Uncertain, finite, finite_list, uncertain
from api.schemas.registry import segment
from api.schemas.unestimated import UnestimatedBecause, unestimated_because
from api.times import Timestamp, to_rfc3339
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values import window_reasons
from estimation.values.geometry import (
    COMBINATIONS,
    LEFT_OUT,
    BinStatus,
    BinValues,
    Centre,
    CentreOrigin,
    GeometryRecord,
)
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.window_reasons import WithoutEstimate
from estimation.values.windows import WindowState
from fleet_db.stores.window_counts import WindowCounts

MM = 1000.0


class BinColumn(Representation):
    """One combination over the bins; null where its status is not `estimated`."""

    value: list[float | None]
    std: list[float | None]
    status: list[BinStatus]


class Bins(Representation):
    """The bin table, column by column; bins of lateral displacement of the wheelset, positive to the left."""

    lower_mm: list[float]
    upper_mm: list[float]
    samples_1: list[float | None] = Field(description="Effective number of samples.")
    rolling_radius_sum_mm: BinColumn = Field(description="rL + rR.")
    rolling_radius_difference_mm: BinColumn = Field(description="rL - rR.")
    contact_angle_sum_rad: BinColumn = Field(description="Left plus right contact angle.")
    contact_angle_difference_rad: BinColumn = Field(description="Left minus right contact angle.")


class ConicityAtAmplitude(Representation):
    """Equivalent conicity tan(gamma_e) at one amplitude of the wheelset's motion (EN 15302)."""

    amplitude_mm: float
    equivalent_conicity_1: Uncertain


class ConicityCentre(Representation):
    """The point a conicity is about; in EN 15302 it is the one about equal rolling radii."""

    displacement_mm: float | None = Field(
        description="Middle of the travel at `equivalent_conicity_amplitude_mm`, positive to the left."
    )
    rolling_line_std_mm: float | None = Field(
        description="Standard deviation of where both rolling radii are equal, against that: a bogie holds wheels of "
        "different diameters off it. What it changes is part of the intervals."
    )
    origin: CentreOrigin = Field(description="From where the displacement is counted.")


class Provenance(Representation):
    """What an estimate was made from; the same inputs and code give the same numbers."""

    code_version: str
    input_digest: str
    parameter_key: str
    parameters: dict[str, JsonValue]
    track_versions: dict[str, list[int]] = Field(
        description="By section, the versions of its alignment that the windows were estimated with, increasing."
    )


class Geometry(Representation):
    """Contact geometry of one wheelset, estimated from the data since its last reprofiling.

    Where nothing was ever estimated the numbers are null, the bins empty, and `unestimated_because` explains it.
    """

    wheelset: str = Field(examples=["WS-0001"])
    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    unestimated_because: UnestimatedBecause | None = Field(
        description="Why nothing is estimated now, by its windows; null where something is, and with `as_of`."
    )
    baseline: int = Field(description="Number of reprofilings before it.")
    mileage_km: float | None = Field(description="Weighted mean mileage of its windows since the wheelset was new.")
    measured_from: Timestamp | None = Field(description="Begin of its data; null without a geometry.")
    measured_to: Timestamp | None = Field(description="End of its data, not included; null without a geometry.")
    recorded_at: Timestamp | None = Field(description="When it was recorded; null without a geometry.")
    n_windows: int
    equivalent_conicity_1: Uncertain
    equivalent_conicity_amplitude_mm: float | None = Field(description="3 mm, or the largest amplitude covered.")
    centre: ConicityCentre | None = Field(description="The point the conicity is about; null without a conicity.")
    equivalent_conicity_at_3_mm_1: Uncertain = Field(
        description="What limits are compared with; where the motion does not cover 3 mm extrapolated, see `reason`."
    )
    windows_left_out: dict[str, int] | None = Field(
        description="Windows since the last reprofiling that are not believed, by reason; null without a geometry."
    )
    conicity_by_amplitude: list[ConicityAtAmplitude]
    nonlinearity_parameter_per_mm: Uncertain
    zero_crossing_mm: Uncertain = Field(description="Lateral displacement at which both rolling radii are equal.")
    bins: Bins
    provenance: Provenance | None = Field(description="What it was made from; null without a geometry.")
    links: Links


def _column(values: BinValues, scale: float) -> BinColumn:
    estimated = [status is BinStatus.ESTIMATED for status in values.status]
    return BinColumn(
        value=[finite(v, scale) if known else None for v, known in zip(values.value, estimated, strict=True)],
        std=[finite(v, scale) if known else None for v, known in zip(values.std, estimated, strict=True)],
        status=list(values.status),
    )


def _centre(found: Centre) -> ConicityCentre:
    return ConicityCentre(
        displacement_mm=finite(found.displacement, MM),
        rolling_line_std_mm=finite(found.std, MM),
        origin=found.origin,
    )


def geometry(record: GeometryRecord, without: WithoutEstimate | None = None) -> Geometry:
    """Return the representation of a geometry estimate.

    Args:
        without: Why it holds no number; None where it does, or as it was recorded at a time.
    """
    found = record.geometry
    reason = found.reason if without is None else without.reason
    own = f"/v1/wheelsets/{segment(record.wheelset)}"
    return Geometry(
        wheelset=record.wheelset,
        status=found.status,
        reason=text_of(reason),
        reason_code=code_of(reason),
        unestimated_because=None if without is None else unestimated_because(without),
        baseline=record.baseline,
        mileage_km=finite(record.mileage_km),
        measured_from=to_rfc3339(record.from_ns),
        measured_to=to_rfc3339(record.to_ns),
        recorded_at=to_rfc3339(record.recorded_ns),
        n_windows=found.windows,
        equivalent_conicity_1=uncertain(found.equivalent_conicity),
        equivalent_conicity_amplitude_mm=finite(found.reported_amplitude, MM),
        centre=None if found.centre is None else _centre(found.centre),
        equivalent_conicity_at_3_mm_1=uncertain(conicity_at_limit_amplitude(found)),
        windows_left_out=_left_out(record),
        conicity_by_amplitude=[
            ConicityAtAmplitude(amplitude_mm=float(amplitude) * MM, equivalent_conicity_1=uncertain(conicity))
            for amplitude, conicity in zip(found.amplitude, found.conicity, strict=True)
        ],
        nonlinearity_parameter_per_mm=uncertain(found.nonlinearity),
        zero_crossing_mm=uncertain(found.zero_crossing, MM),
        bins=bin_table(record),
        provenance=Provenance(
            code_version=record.code_version,
            input_digest=record.input_digest,
            parameter_key=found.parameter_key,
            parameters=dict(record.parameters),
            track_versions={section: list(versions) for section, versions in record.track_versions.items()},
        ),
        links={
            "self": f"{own}/geometry",
            "as_recorded": f"{own}/geometry?as_of={to_rfc3339(record.recorded_ns)}",
            "wheelset": own,
            "trend": f"{own}/trend",
            "windows": f"{own}/windows",
            **{
                f"alignment:{section}": f"/v1/track-sections/{segment(section)}/alignment?version={versions[-1]}"
                for section, versions in sorted(record.track_versions.items())
            },
        },
    )


def no_geometry(serial: str, baseline: int, reason: Reason, without: WithoutEstimate | None = None) -> Geometry:
    """Return the representation of a wheelset of which nothing was ever estimated.

    Args:
        without: The same by its windows; None of a time that has passed.
    """
    own = f"/v1/wheelsets/{segment(serial)}"
    unknown = uncertain(Estimate.unknown(reason))
    empty = BinColumn(value=[], std=[], status=[])
    return Geometry(
        wheelset=serial,
        status=Status.UNESTIMATED,
        reason=reason.text,
        reason_code=reason.code,
        unestimated_because=None if without is None else unestimated_because(without),
        baseline=baseline,
        mileage_km=None,
        measured_from=None,
        measured_to=None,
        recorded_at=None,
        n_windows=0,
        equivalent_conicity_1=unknown,
        equivalent_conicity_amplitude_mm=None,
        centre=None,
        equivalent_conicity_at_3_mm_1=unknown,
        windows_left_out=None,
        conicity_by_amplitude=[],
        nonlinearity_parameter_per_mm=unknown,
        zero_crossing_mm=unknown,
        bins=Bins(
            lower_mm=[],
            upper_mm=[],
            samples_1=[],
            rolling_radius_sum_mm=empty,
            rolling_radius_difference_mm=empty,
            contact_angle_sum_rad=empty,
            contact_angle_difference_rad=empty,
        ),
        provenance=None,
        links={"self": f"{own}/geometry", "wheelset": own, "trend": f"{own}/trend", "windows": f"{own}/windows"},
    )


def _left_out(record: GeometryRecord) -> dict[str, int] | None:
    stored = record.parameters.get(LEFT_OUT)
    if not isinstance(stored, dict):
        return None
    return {code: count for code, count in stored.items() if isinstance(count, int)}


def bin_table(record: GeometryRecord) -> Bins:
    """Return the bin table of an estimate."""
    found = record.geometry
    edges = [float(edge) * MM for edge in found.bin_edges]
    return Bins(
        lower_mm=edges[:-1],
        upper_mm=edges[1:],
        samples_1=finite_list(found.samples),
        rolling_radius_sum_mm=_column(found.rolling_radius_sum, MM),
        rolling_radius_difference_mm=_column(found.rolling_radius_difference, MM),
        contact_angle_sum_rad=_column(found.contact_angle_sum, 1.0),
        contact_angle_difference_rad=_column(found.contact_angle_difference, 1.0),
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
