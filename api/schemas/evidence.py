"""What led to an alert, typed by its kind: numbers in the units of the API, times as RFC 3339.

A property is null where it does not apply, is not known, or was not stored by the release that raised the alert.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from api.schemas.common import Href, Representation, Uncertain
from api.schemas.trend import DateForecast, DistanceForecast
from api.times import Timestamp
from estimation.alerts.fleet_alerts import MOST_NAMED
from estimation.values.reasons import ReasonCode


class Delays(Representation):
    """The delays of the rule as they were when the alert was raised, and how far they have been counted."""

    on_evaluations: int | None = Field(description="Evaluations on end before it is raised.")
    off_evaluations: int | None = Field(description="Evaluations on end before it is cleared.")
    on_delay_km: float | None = Field(
        description="Distance that findings on end must cover before it is raised; null where evaluations are counted."
    )
    off_delay_km: float | None = Field(
        description="Distance that findings on end must cover before it is cleared; null where evaluations are counted."
    )
    acknowledgement_days: float | None = Field(description="After which an acknowledgement ends by itself.")
    clear_seen: int | None = Field(description="Evaluations on end beyond the clear limit so far.")
    counted_at: Timestamp | None = Field(description="Time of the newest data that were counted.")


class _OfRule(Representation):
    unknown_because: str | None = Field(description="Why the data decide nothing at present; null where they do.")
    unknown_because_code: ReasonCode | None = Field(description="The same as a code.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


class ConicityLimitEvidence(_OfRule):
    """Evidence of `conicity_limit`: equivalent conicity against its limit."""

    kind: Literal["conicity_limit"]
    quantity: str | None = Field(description="What is compared with the limit.", examples=["equivalent_conicity"])
    amplitude_mm: float | None = Field(description="Amplitude that the conicity is of.")
    conicity_1: Uncertain | None = Field(description="Equivalent conicity that is compared with the limit.")
    current_1: Uncertain | None = Field(description="Equivalent conicity of the current geometry.")
    windows: int | None = Field(description="Windows behind the geometry.")
    limit_1: float | None = Field(description="The raise limit.")


class LimitForecastEvidence(_OfRule):
    """Evidence of `limit_forecast`: when the trend reaches the limit."""

    kind: Literal["limit_forecast"]
    quantity: str | None = Field(description="What the trend is of.", examples=["equivalent_conicity"])
    slope_1_per_1000_km: Uncertain | None = Field(description="Slope of the trend.")
    fitted_1: Uncertain | None = Field(description="The fitted trend at its last point.")
    distance_to_limit_km: DistanceForecast = Field(description="Distance left to the limit.")
    date_of_limit: DateForecast = Field(description="When the limit is reached; to the second.")
    within_km: float | None = Field(description="Distance within which reaching the limit raises the alert.")
    limit_1: float | None = Field(description="Limit of the quantity.")
    points: int | None = Field(description="Points of the trend.")


class WheelAsymmetryEvidence(_OfRule):
    """Evidence of `wheel_asymmetry`: left and right wheel differ."""

    kind: Literal["wheel_asymmetry"]
    offset_mm: Uncertain | None = Field(
        description="Lateral displacement at which both wheels roll on one radius.",
    )
    shape_mm: Uncertain | None = Field(
        description="Even part of the rolling radius difference, outside against inside.",
    )
    raised_by: list[Literal["offset", "shape"]] = Field(description="What raised it.")
    windows: int | None = Field(description="Windows behind the geometry.")


class NoDataEvidence(Representation):
    """Evidence of `no_data`: how long nothing usable has come."""

    kind: Literal["no_data"]
    last_usable_at: Timestamp | None = Field(description="End of the newest usable window; null where there is none.")
    in_service_since: Timestamp | None = Field(description="When the wheelset was mounted.")
    limit_days: float | None = Field(description="Limit in days that the silence has passed.")
    refused_windows: int | None = Field(description="Windows since then, of the latest, that cannot be used.")
    reasons: dict[str, int] = Field(description="These windows by reason code.")
    reason: str | None = Field(description="Why the newest of the most frequent reason cannot be used.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


class SensorFaultEvidence(_OfRule):
    """Evidence of `sensor_fault`: too many of the latest windows are of a faulty sensor."""

    kind: Literal["sensor_fault"]
    faulty_windows: int | None = Field(description="Faulty ones of the latest windows.")
    windows: int | None = Field(description="How many windows were looked at.")
    reasons: dict[str, int] = Field(
        description="Faulty windows by what is wrong: `self_test_or_emergency`, `clipping`, `invalid_values`."
    )


class MountedAs(Representation):
    """How a wheelset is mounted on file."""

    vehicle: str = Field(description="Code of the vehicle.")
    axle: int = Field(description="Number of the axle, from 1.")
    mounted_from: Timestamp = Field(description="Since when.")
    reversed: bool = Field(description="The left wheel runs on the right-hand side.")


class IdentityEvidence(Representation):
    """Evidence of `identity`: the wheelset that runs is not the one on file, or not the way round."""

    kind: Literal["identity"]
    mistake: Literal["reversed", "swapped"] | None = Field(description="The mistake that explains the jump.")
    partner: str | None = Field(description="The other wheelset of a swap.")
    last_data_before_at: Timestamp | None = Field(description="End of the last data before it happened.")
    first_data_after_at: Timestamp | None = Field(description="Begin of the first data after it.")
    jump_1: float | None = Field(description="Standard deviations between the geometries before and after.")
    left_1: float | None = Field(description="Standard deviations that the explanation leaves.")
    reason: str | None = Field(description="The explanation, as a sentence.")
    mounted: MountedAs | None = Field(description="The mounting that it was raised on.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


class HuntingEvidence(_OfRule):
    """Evidence of `hunting`: several of the latest windows show it."""

    kind: Literal["hunting"]
    hunting_windows: int | None = Field(description="Windows of hunting among the latest.")
    windows: int | None = Field(description="How many windows were looked at.")
    frequency_hz: float | None = Field(description="Median frequency.")
    wavelength_m: float | None = Field(description="Median wavelength.")
    amplitude_mm: float | None = Field(description="Largest lateral amplitude.")
    speed_max_m_s: float | None = Field(description="Greatest speed of those windows.")


class SuspensionChangeEvidence(Representation):
    """Evidence of `suspension_change`: yaw stiffness over creep coefficient of a vehicle has changed."""

    kind: Literal["suspension_change"]
    vehicle: str | None = Field(description="Code of the vehicle.")
    change_1: Uncertain | None = Field(description="Relative change; -0.3 is softer by 30 %.")
    past_findings: int | None = Field(description="Findings of its own past.")
    recent_findings: int | None = Field(description="Findings that count as now.")
    other_vehicles: int | None = Field(description="Vehicles on the same sections at the same time.")
    limit_1: float | None = Field(description="Change that raises the alert.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


class DataQualityEvidence(_OfRule):
    """Evidence of `data_quality`: the data contradict themselves or the registry."""

    kind: Literal["data_quality"]
    implausible_windows: int | None = Field(description="Implausible ones of the latest windows.")
    windows: int | None = Field(description="How many windows were looked at.")
    reasons: dict[str, int] = Field(description="Implausible windows by reason code.")
    rejected_recordings: int | None = Field(description="Rejected recordings of the vehicle.")
    rejected_reasons: dict[str, int] = Field(description="Rejected recordings by reason code.")


class Stretch(Representation):
    """A stretch of a track section."""

    from_m: float = Field(description="Where it begins, along the section.")
    to_m: float = Field(description="Where it ends, along the section.")


class LowAdhesionEvidence(Representation):
    """Evidence of `low_adhesion`: rails of little friction along a track section."""

    kind: Literal["low_adhesion"]
    track_section: str | None = Field(description="Code of the section.")
    stretches: list[Stretch] = Field(description="Where friction is below the limit.")
    friction_1: Uncertain | None = Field(description="Coefficient of friction at the surest place of them.")
    passes: int | None = Field(description="Passes of wheelsets behind it.")
    windows: int | None = Field(description="Windows that are pooled along the section.")
    measured_from: Timestamp | None = Field(description="Start of the first of them.")
    measured_to: Timestamp | None = Field(description="Start of the last of them.")
    limit_1: float | None = Field(description="Friction below which the alert is raised.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


class WeakDamperEvidence(_OfRule):
    """Evidence of `weak_damper`: the lateral damper of a running gear has lost most of its damping."""

    kind: Literal["weak_damper"]
    vehicle: str | None = Field(description="Code of the vehicle.")
    first_axle: int | None = Field(description="First axle of the running gear, from 1.")
    damping_share_1: Uncertain | None = Field(description="Damping over that of the vehicle class on file.")
    windows: int | None = Field(description="Windows that show it.")
    measured_from: Timestamp | None = Field(description="Start of the first of them.")
    measured_to: Timestamp | None = Field(description="Start of the last of them.")
    limit_1: float | None = Field(description="Share below which the alert is raised.")


class WheelFlatEvidence(_OfRule):
    """Evidence of `wheel_flat`: a wheel strikes once a turn in many of the latest windows."""

    kind: Literal["wheel_flat"]
    striking_windows: int | None = Field(description="Windows in which it strikes, of the latest.")
    windows: int | None = Field(description="How many windows were looked at.")
    blow_m_s2: float | None = Field(description="Median lateral acceleration; at least that where the sensor clips.")
    wheel: Literal["left", "right"] | None = Field(description="Of the wheelset itself; null where it is not known.")
    turn_m: float | None = Field(description="Distance between two blows.")
    speed_max_m_s: float | None = Field(description="Greatest speed of those windows.")


class FleetAlertEvidence(Representation):
    """Evidence of a fleet alert of any kind: how many alerts it stands for. They themselves are under `members`."""

    kind: Literal["fleet_alert"]
    more_than: int | None = Field(description="How many alerts a flood has more than.")
    within_hours: float | None = Field(description="Span of opening times that counts as a flood.")
    member_count: int = Field(description="How many alerts it stands for, open and closed.")
    open_member_count: int = Field(description="How many of them are open.")
    wheelsets: list[str] = Field(
        description=f"At most {MOST_NAMED} wheelsets of its members, open ones first, then the most severe."
    )
    members: Href = Field(description="Where all of its members are listed.")
    delays: Delays | None = Field(description="The delays of the kind when it was raised.")


class OtherEvidence(Representation):
    """Evidence of a kind of its own: of a rule that is not among the shipped ones, or is gone."""

    kind: Literal["other"]
    numbers: dict[str, float | None] = Field(
        description="Numbers, each under its name; nested names are joined by a point."
    )
    texts: dict[str, str] = Field(description="Words, each under its name.")
    times: dict[str, Timestamp] = Field(description="Times, each under its name.")
    delays: Delays | None = Field(description="The delays that it was raised with.")


Evidence = Annotated[
    ConicityLimitEvidence
    | LimitForecastEvidence
    | WheelAsymmetryEvidence
    | NoDataEvidence
    | SensorFaultEvidence
    | IdentityEvidence
    | HuntingEvidence
    | SuspensionChangeEvidence
    | DataQualityEvidence
    | LowAdhesionEvidence
    | WeakDamperEvidence
    | WheelFlatEvidence
    | FleetAlertEvidence
    | OtherEvidence,
    Field(discriminator="kind"),
]
