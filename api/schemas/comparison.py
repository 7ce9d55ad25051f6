"""A measurement of a wheelset's profiles beside the estimate of its date."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, finite, finite_list, uncertain
from api.schemas.geometry import MM, Bins, bin_table
from api.schemas.registry import segment
from api.schemas.wheel_contact import ProfileContact, profile_contact
from api.times import Timestamp, to_rfc3339
from estimation.accuracy.comparison import Comparison, ConicityPair
from estimation.accuracy.curve_origin import curve_origin
from estimation.accuracy.wheel_contact import WheelContact
from estimation.contact.profiles import Profile
from estimation.contact.wear_measures import wear_measures
from estimation.errors import ProfileError
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of

NOT_OBSERVABLE = Reason(
    ReasonCode.MEASURES_NOT_OBSERVABLE,
    "accelerations show how the wheels roll: the estimate gives the conicity, and no measures of flange and tread",
)


class WheelMeasures(Representation):
    """Flange and tread of one wheel as measured (EN 15313); null where the profile does not show it."""

    profile: str = Field(description="Name of the profile.", examples=["WS-0001-left"])
    flange_thickness_mm: float | None = Field(
        description="Sd: flange face to flange back, 10 mm beyond the tread.", examples=[32.5]
    )
    flange_height_mm: float | None = Field(
        description="Sh: tip of the flange over the tread 70 mm from the flange back.", examples=[28.0]
    )
    flange_gradient_mm: float | None = Field(
        description="qR: lateral distance of the face 10 mm beyond the tread from that 2 mm short of the tip.",
        examples=[10.8],
    )
    hollow_mm: float | None = Field(
        description="Depth of the tread below the highest point farther out; 0 for a new wheel.", examples=[0.0]
    )
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


class EstimateOfDate(Representation):
    """The estimate that belongs to a measurement: of the same profile, of its mileage interval or the nearest."""

    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    baseline: int
    mileage_km: float | None = Field(description="Weighted mean mileage of its windows.")
    mileage_apart_km: float | None = Field(description="Mileage of the estimate less that of the measurement.")
    measured_from: Timestamp
    measured_to: Timestamp
    recorded_at: Timestamp
    n_windows: int
    bins: Bins = Field(description="Its bin table; intervals of 95 % are 1.96 of the standard deviations.")


class MeasuredAtBins(Representation):
    """The measured curve rL - rR at the bins of the estimate, counted from the origin of the estimated one.

    Band-limited signals carry no offset: the estimated curve is counted from the place that the wheelset runs at. It is
    the one on the measured curve at which the estimate fits best.
    """

    origin_displacement_mm: float = Field(description="Lateral displacement of the origin on the measured curve.")
    origin_radius_difference_mm: float = Field(description="rL - rR of the measured curve there.")
    rolling_radius_difference_mm: list[float | None] = Field(description="At each bin; null without contact.")
    rolling_radius_difference_std_mm: list[float | None] = Field(description="Standard deviation at each bin.")


class ConicityCompared(Representation):
    """Equivalent conicity at one amplitude (EN 15302), measured and estimated."""

    amplitude_mm: float
    measured_1: Uncertain = Field(description="From the measured profiles; `n_windows` is 0.")
    estimated_1: Uncertain = Field(description="Of the estimate; at 3 mm it may be extrapolated, see its reason.")
    covered: bool | None = Field(
        description="Whether the estimate's 95 % interval, widened by the error of the measurement, covers it; null"
        " where either is unknown."
    )


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
    measured_at_bins: MeasuredAtBins | None = Field(description="Null where either curve is missing.")
    conicity_by_amplitude: list[ConicityCompared] = Field(description="At 1 to 8 mm.")
    links: Links


def profile_comparison(found: Comparison) -> ProfileComparison:
    """Return the representation of a measurement beside the estimate of its date."""
    one, record = found.measurement, found.estimate.record
    own = f"/v1/wheelsets/{segment(one.wheelset)}"
    return ProfileComparison(
        wheelset=one.wheelset,
        measured_at=to_rfc3339(one.at_ns),
        mileage_km=one.mileage_km,
        std_mm=one.std * MM,
        wheels=BothWheels(left=_measures(one.left), right=_measures(one.right)),
        estimated_wheels=NotEstimated(
            status=Status.UNESTIMATED, reason=NOT_OBSERVABLE.text, reason_code=NOT_OBSERVABLE.code
        ),
        measured=profile_contact(found.contact),
        estimate=None if record is None else _estimate(found, record),
        reason=text_of(found.reason),
        reason_code=code_of(found.reason),
        independent=found.independent,
        measured_at_bins=_at_bins(found),
        conicity_by_amplitude=[conicity_compared(pair) for pair in found.conicity],
        links={
            "self": comparison_path(one.wheelset, one.at_ns),
            "wheelset": own,
            "measured_profiles": f"{own}/measured-profiles",
            "accuracy": "/v1/accuracy",
        },
    )


def comparison_path(serial: str, at_ns: int) -> str:
    """Return the path of a comparison."""
    return f"/v1/wheelsets/{segment(serial)}/measured-profiles/{segment(to_rfc3339(at_ns))}/comparison"


def conicity_compared(pair: ConicityPair) -> ConicityCompared:
    """Return the representation of the conicity at one amplitude, measured and estimated."""
    return ConicityCompared(
        amplitude_mm=round(pair.amplitude * MM, 3),
        measured_1=uncertain(pair.measured),
        estimated_1=uncertain(pair.estimated),
        covered=pair.covered,
    )


def _measures(wheel: Profile) -> WheelMeasures:
    try:
        found = wear_measures(wheel)
    except ProfileError as error:
        why = Reason(ReasonCode.PROFILE_INCOMPLETE, str(error))
        nothing = dict.fromkeys(("flange_thickness_mm", "flange_height_mm", "flange_gradient_mm", "hollow_mm"), None)
        return WheelMeasures(profile=wheel.name, **nothing, reason=why.text, reason_code=why.code)
    return WheelMeasures(
        profile=wheel.name,
        flange_thickness_mm=finite(found.flange_thickness, MM),
        flange_height_mm=finite(found.flange_height, MM),
        flange_gradient_mm=finite(found.flange_gradient, MM),
        hollow_mm=finite(found.hollow, MM),
        reason=None,
        reason_code=None,
    )


def _estimate(found: Comparison, record: GeometryRecord) -> EstimateOfDate:
    why = found.estimate.reason or record.geometry.reason
    apart = record.mileage_km - found.measurement.mileage_km
    return EstimateOfDate(
        status=record.geometry.status,
        reason=text_of(why),
        reason_code=code_of(why),
        baseline=record.baseline,
        mileage_km=finite(record.mileage_km),
        mileage_apart_km=finite(apart),
        measured_from=to_rfc3339(record.from_ns),
        measured_to=to_rfc3339(record.to_ns),
        recorded_at=to_rfc3339(record.recorded_ns),
        n_windows=record.geometry.windows,
        bins=bin_table(record),
    )


def _at_bins(found: Comparison) -> MeasuredAtBins | None:
    record, contact = found.estimate.record, found.contact
    if record is None or not isinstance(contact, WheelContact) or not np.isfinite(contact.zero_crossing):
        return None
    geometry, x = record.geometry, contact.displacement
    if not np.isfinite(geometry.rolling_radius_difference.value).any():
        return None
    known = np.isfinite(contact.radius_difference)
    origin = curve_origin(geometry, x[known], contact.radius_difference[known], contact.zero_crossing)
    at = geometry.bin_centres + origin.displacement
    value = np.interp(at, x, contact.radius_difference, left=np.nan, right=np.nan) - origin.difference
    std = np.interp(at, x, contact.radius_difference_std, left=np.nan, right=np.nan)
    return MeasuredAtBins(
        origin_displacement_mm=origin.displacement * MM,
        origin_radius_difference_mm=origin.difference * MM,
        rolling_radius_difference_mm=finite_list(value, MM),
        rolling_radius_difference_std_mm=finite_list(std, MM),
    )
