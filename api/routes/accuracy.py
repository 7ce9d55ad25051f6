"""Estimates against measurements: whether the intervals of a wheelset, and of a fleet, cover what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self
from urllib.parse import urlencode

import numpy as np
from fastapi import APIRouter, Path, Query, Response
from pydantic import Field

from api.accuracy import Placed, placed_comparisons
from api.answers import answer_payload, table_payload
from api.asking import AskedDep, FleetFilter, MeasuredFrom, MeasuredTo, Serial, require_order
from api.contract import TABLE, Accepted
from api.problems import described
from api.routes.design_contact import ProfileContact, comparison_reader, profile_contact
from api.schemas.common import Derived, Links, Representation, Uncertain, finite, finite_list, segment, uncertain, why
from api.schemas.geometry import Bins, bin_table
from api.services import require_known
from api.times import Moment, Timestamp, to_rfc3339
from estimation.accuracy.fleet_accuracy import (
    Comparison,
    ConicityPair,
    CoverageCount,
    CoveragePair,
    FleetAccuracy,
    Outcome,
    PlacedComparison,
    curve_origin,
    fleet_accuracy,
)
from estimation.accuracy.wheel_contact import WheelContact
from estimation.contact.profiles import Profile
from estimation.contact.wear import WearMeasures, wear_measures
from estimation.errors import ProfileError
from estimation.trend.extrapolation import LIMIT_AMPLITUDE
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import IN_MM
from fleet_db.rows import present
from fleet_db.stores.wheelset_events import newest_measurements

NOT_OBSERVABLE = Reason(
    ReasonCode.MEASURES_NOT_OBSERVABLE,
    "accelerations show how the wheels roll: the estimate gives the conicity, and no measures of flange and tread",
)


class WheelMeasures(Derived, of=WearMeasures):
    """Flange and tread of one wheel as measured (EN 15313); null where the profile does not show it."""

    profile: str = Field(description="Name of the profile.", examples=["WS-0001-left"])
    reason: str | None
    reason_code: ReasonCode | None


class BothWheels(Representation):
    """The wheelset's own left and right wheel."""

    left: WheelMeasures = Field(description="Its own left wheel, whichever way round it runs.")
    right: WheelMeasures = Field(description="Its own right wheel.")


class NotEstimated(Representation):
    """What an estimate does not give."""

    status: Status
    reason: str
    reason_code: ReasonCode


class EstimateOfDate(
    Derived,
    of=GeometryRecord,
    without=("wheelset", "interval", "geometry", "input_digest", "track_versions", "parameters", "code_version"),
    columns="status reason reason_code baseline mileage_km mileage_apart_km measured_from measured_to recorded_at"
    " n_windows bins",
):
    """The estimate that belongs to a measurement: of the same profile, of its mileage interval or the nearest."""

    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    mileage_km: float | None = Field(description="Weighted mean mileage of its windows.")
    mileage_apart_km: float | None = Field(description="Mileage of the estimate less that of the measurement.")
    n_windows: int
    bins: Bins = Field(description="Its bin table; intervals of 95 % are 1.96 of the standard deviations.")


class MeasuredAtBins(Representation):
    """The measured curve rL - rR at the bins of the estimate, counted from the origin of the estimated one.

    Band-limited signals carry no offset: the estimated curve is counted from the place that the wheelset runs at. That
    place is found by shifting the estimate along the measured curve until it fits best.
    """

    origin_displacement_mm: float = Field(description="Lateral displacement of the origin on the measured curve.")
    origin_radius_difference_mm: float = Field(description="rL - rR of the measured curve there.")
    rolling_radius_difference_mm: list[float | None] = Field(
        description="At each bin; null without contact and beyond the measured curve."
    )
    rolling_radius_difference_std_mm: list[float | None] = Field(description="Standard deviation at each bin.")


class ConicityCompared(Derived, of=ConicityPair, without=("amplitude",), also=("covered", "z")):
    """Equivalent conicity at one amplitude (EN 15302), measured and estimated."""

    amplitude_mm: float


class ProfileComparison(Representation):
    """A measurement of both wheels beside the estimate that belongs to it."""

    wheelset: str = Field(examples=["WS-0001"])
    measured_at: Timestamp
    mileage_km: float = Field(description="Of the wheelset since new, at the measurement.", examples=[151200.0])
    std_mm: float = Field(
        description="Standard deviation of the lateral displacement at a rolling radius difference.", examples=[0.1]
    )
    wheels: BothWheels = Field(description="Flange and tread as measured.")
    estimated_wheels: NotEstimated = Field(description="Why the estimate has no measures of flange and tread.")
    measured: ProfileContact = Field(description="What the measured profiles give.")
    estimate: EstimateOfDate | None = Field(description="Null where none belongs to the measurement.")
    reason: str | None = Field(description="Why the conicity at 3 mm is not compared; null where it is.")
    reason_code: ReasonCode | None
    independent: bool | None = Field(
        description="Whether the estimate was made without any measurement of the same profiles; only then does it"
        " check the product. Null without an estimate."
    )
    measured_at_bins: MeasuredAtBins | None = Field(
        description="Null where either curve is missing, or the measured one does not cross zero."
    )
    conicity_by_amplitude: list[ConicityCompared] = Field(description="At 1 to 8 mm.")
    links: Links


def _profile_comparison(comparison: Comparison) -> ProfileComparison:
    measured, record = comparison.measurement, comparison.estimate.record
    path = f"/v1/wheelsets/{segment(measured.wheelset)}"
    return ProfileComparison(
        wheelset=measured.wheelset,
        measured_at=to_rfc3339(measured.at_ns),
        mileage_km=measured.mileage_km,
        std_mm=measured.std * IN_MM,
        wheels=BothWheels(left=_measures(measured.left), right=_measures(measured.right)),
        estimated_wheels=NotEstimated(
            status=Status.UNESTIMATED, reason=NOT_OBSERVABLE.text, reason_code=NOT_OBSERVABLE.code
        ),
        measured=profile_contact(comparison.contact),
        estimate=None if record is None else _estimate(comparison, record),
        **why(comparison.reason),
        independent=comparison.independent,
        measured_at_bins=_at_bins(comparison),
        conicity_by_amplitude=[
            ConicityCompared.made(pair, amplitude_mm=round(pair.amplitude * IN_MM, 3)) for pair in comparison.conicity
        ],
        links={
            "self": _comparison_path(measured.wheelset, measured.at_ns),
            "wheelset": path,
            "measured_profiles": f"{path}/measured-profiles",
            "accuracy": "/v1/accuracy",
        },
    )


def _comparison_path(serial: str, at_ns: int) -> str:
    return f"/v1/wheelsets/{segment(serial)}/measured-profiles/{segment(to_rfc3339(at_ns))}/comparison"


def _measures(wheel: Profile) -> WheelMeasures:
    cause, measures = None, WearMeasures(*[np.nan] * 4)
    try:
        measures = wear_measures(wheel)
    except ProfileError as error:
        cause = Reason(ReasonCode.PROFILE_INCOMPLETE, str(error))
    return WheelMeasures.made(measures, profile=wheel.name, **why(cause))


def _estimate(comparison: Comparison, record: GeometryRecord) -> EstimateOfDate:
    return EstimateOfDate.made(
        record,
        status=record.geometry.status,
        **why(comparison.estimate.reason or record.geometry.reason),
        mileage_apart_km=finite(record.mileage_km - comparison.measurement.mileage_km),
        n_windows=record.geometry.windows,
        bins=bin_table(record.geometry),
    )


def _at_bins(comparison: Comparison) -> MeasuredAtBins | None:
    record, contact = comparison.estimate.record, comparison.contact
    if record is None or not isinstance(contact, WheelContact) or not np.isfinite(contact.zero_crossing):
        return None
    geometry, x = record.geometry, contact.displacement
    if not np.isfinite(geometry.rolling_radius_difference.value).any():
        return None
    touching = np.isfinite(contact.radius_difference)
    origin = curve_origin(geometry, x[touching], contact.radius_difference[touching], contact.zero_crossing)
    places = geometry.bin_centres + origin.displacement
    value = np.interp(places, x, contact.radius_difference, left=np.nan, right=np.nan) - origin.difference
    std = np.interp(places, x, contact.radius_difference_std, left=np.nan, right=np.nan)
    return MeasuredAtBins(
        origin_displacement_mm=origin.displacement * IN_MM,
        origin_radius_difference_mm=origin.difference * IN_MM,
        rolling_radius_difference_mm=finite_list(value, IN_MM),
        rolling_radius_difference_std_mm=finite_list(std, IN_MM),
    )


class Coverage(Derived, of=CoverageCount, without=("interval_95",), also=("fraction",)):
    """How many 95 % intervals cover what was measured, and z; what has no estimate or measurement is not counted."""

    fraction_interval_95_1: tuple[float, float] | None = Field(
        description="95 % interval of the share, as if wheelsets were independent; those of one wheelset are not."
    )

    @classmethod
    def made(cls, value: CoverageCount, **more: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of a count."""
        return super().made(value, fraction_interval_95_1=value.interval_95, **more)


class CoverageOfGroup(Derived, of=CoveragePair):
    """The coverage of some comparisons, and of the independent ones."""


class CoverageAtAmplitude(CoverageOfGroup):
    """The coverage at one amplitude."""

    amplitude_mm: float


class CoverageOfKey(CoverageOfGroup):
    """The coverage of one vehicle class or track section."""

    key: str = Field(description="Code of the class or section.")


class NotCompared(Representation):
    """How many measurements are not compared at 3 mm for one reason."""

    reason_code: ReasonCode
    measurements: int = Field(description="How many.")


class MeasurementRow(Representation):
    """One measurement: whether the interval of the estimate covers its conicity at 3 mm."""

    wheelset: str = Field(examples=["WS-0001"])
    measured_at: Timestamp
    mileage_km: float
    vehicle_class: str | None = Field(description="Of the vehicle that it was mounted on; null where it was on none.")
    track_sections: list[str] = Field(description="Those that the estimate is of.")
    outcome: Outcome = Field(description="Whether it is covered, or not compared and why.")
    independent: bool | None = Field(
        description="Whether the estimate was made without a measurement of the same profiles; null without estimate."
    )
    measured_1: Uncertain = Field(description="Equivalent conicity at 3 mm of the measured profiles.")
    estimated_1: Uncertain = Field(description="Equivalent conicity at 3 mm of the estimate.")
    z_1: float | None = Field(
        description="Estimate less measurement over the standard deviation of both; null where it is not compared."
    )
    reason: str | None = Field(description="Why it is not compared; null where it is.")
    reason_code: ReasonCode | None
    links: Links


class Unreadable(Representation):
    """A wheelset of which something stored is damaged."""

    wheelset: str = Field(examples=["WS-0001"])
    reason: str = Field(description="What cannot be read.")
    reason_code: ReasonCode


class Accuracy(Representation):
    """Estimates against measurements over a fleet: whether the 95 % intervals cover, and which do not."""

    amplitude_mm: float = Field(description="Of the conicity that is compared: that of limits.")
    on_file: int = Field(description="Measurements on file that fit the filter.")
    considered: int = Field(
        description="How many of the newest, as many as `limit` allows, can be read; what follows is of these."
    )
    coverage: CoverageOfGroup = Field(description="At 3 mm.")
    coverage_by_amplitude: list[CoverageAtAmplitude] = Field(description="At 1 to 8 mm.")
    coverage_by_vehicle_class: list[CoverageOfKey] = Field(description="At 3 mm, by class of the vehicle.")
    coverage_by_track_section: list[CoverageOfKey] = Field(
        description="At 3 mm, by section; an estimate of several sections counts in each."
    )
    not_compared: list[NotCompared] = Field(description="Measurements that are not compared at 3 mm, by reason.")
    measurements: list[MeasurementRow] = Field(description="Each measurement, the newest first.")
    unreadable: list[Unreadable] = Field(
        description="Wheelsets that `on_file` counts alone, because something stored of them is damaged."
    )
    links: Links


def _accuracy(accuracy: FleetAccuracy, placed: Placed, on_file: int, links: Mapping[str, str]) -> Accuracy:
    return Accuracy(
        amplitude_mm=LIMIT_AMPLITUDE * IN_MM,
        on_file=on_file,
        considered=len(placed.rows),
        coverage=CoverageOfGroup.made(accuracy.at_limit),
        coverage_by_amplitude=[
            CoverageAtAmplitude.made(pair, amplitude_mm=round(a * IN_MM, 3))
            for a, pair in accuracy.by_amplitude.items()
        ],
        coverage_by_vehicle_class=[CoverageOfKey.made(pair, key=k) for k, pair in accuracy.by_vehicle_class.items()],
        coverage_by_track_section=[CoverageOfKey.made(pair, key=k) for k, pair in accuracy.by_section.items()],
        not_compared=[NotCompared(reason_code=code, measurements=n) for code, n in accuracy.not_compared.items()],
        measurements=[_row(row) for row in placed.rows],
        unreadable=[
            Unreadable(wheelset=serial, reason=reason.text, reason_code=reason.code)
            for serial, reason in placed.unreadable.items()
        ],
        links=dict(links),
    )


def table(rows: Sequence[MeasurementRow]) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the measurements as a header and rows."""
    columns = "wheelset measured_at mileage_km vehicle_class track_sections outcome independent measured_1"
    columns += " measured_std_1 estimated_1 estimated_low_1 estimated_high_1 z_1 reason_code"
    return columns.split(), [
        (
            *(row.wheelset, row.measured_at, row.mileage_km, row.vehicle_class, " ".join(row.track_sections)),
            *(row.outcome.value, None if row.independent is None else str(row.independent).lower()),
            *(row.measured_1.value, row.measured_1.std, row.estimated_1.value),
            *(row.estimated_1.interval_95 or (None, None)),
            *(row.z_1, None if row.reason_code is None else row.reason_code.value),
        )
        for row in rows
    ]


def _row(row: PlacedComparison) -> MeasurementRow:
    comparison = row.comparison
    measured = comparison.measurement
    return MeasurementRow(
        wheelset=measured.wheelset,
        measured_at=to_rfc3339(measured.at_ns),
        mileage_km=measured.mileage_km,
        vehicle_class=row.vehicle_class,
        track_sections=list(row.sections),
        outcome=row.outcome,
        independent=comparison.independent,
        measured_1=uncertain(comparison.at_limit.measured),
        estimated_1=uncertain(comparison.at_limit.estimated),
        z_1=comparison.at_limit.z,
        **why(comparison.reason),
        links={
            "wheelset": f"/v1/wheelsets/{segment(measured.wheelset)}",
            "comparison": _comparison_path(measured.wheelset, measured.at_ns),
        },
    )


router = APIRouter(prefix="/v1", tags=["accuracy"])
MeasuredAt = Annotated[Moment, Path(description="When the profiles were measured.", examples=["2026-01-31T12:00:00Z"])]
Newest = Annotated[int, Query(ge=1, le=500, description="How many measurements at most, the newest.")]


@router.get(
    "/wheelsets/{serial}/measured-profiles/{measured_at}/comparison",
    response_model=ProfileComparison,
    responses=described(404),
)
def get_profile_comparison(asked: AskedDep, serial: Serial, measured_at: MeasuredAt) -> Response:
    """Return a measurement of both wheels beside the estimate that belongs to its date."""
    with asked.read() as unit:
        wheelset = unit.registry.wheelset(serial)
        of_date = [measured for measured in unit.registry.measured_profiles(serial) if measured.at_ns == measured_at]
        comparisons = comparison_reader(asked.services, unit).of_wheelset(wheelset, of_date)
    key = f"{serial} at {to_rfc3339(measured_at)}"
    return asked.answer(_profile_comparison(present(next(iter(comparisons), None), "measured profiles", key)))


@router.get("/accuracy", response_model=Accuracy, responses={**described(404), **TABLE})
def get_accuracy(
    asked: AskedDep,
    accepted: Accepted,
    fleet: FleetFilter = None,
    measured_from: MeasuredFrom = None,
    measured_to: MeasuredTo = None,
    limit: Newest = 100,
) -> Response:
    """Return whether the intervals of the estimates cover what was measured; as `text/csv`, the measurements alone."""
    require_order(measured_from, measured_to)
    with asked.read() as unit:
        require_known(unit, fleet=fleet)
        on_file, keys = newest_measurements(unit.connection, fleet, measured_from, measured_to, limit)
        placed = placed_comparisons(unit, comparison_reader(asked.services, unit), keys)
    query = f"?{urlencode(asked.request.query_params.multi_items())}" if asked.request.query_params else ""
    body = _accuracy(fleet_accuracy(placed.rows), placed, on_file, {"self": f"/v1/accuracy{query}"})
    return answer_payload(
        asked.request, table_payload(body, accepted, lambda shown: table(shown.measurements)), accepted
    )
