"""Creep forces of a wheelset, and the friction along a track section."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.evidence import Stretch
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.adhesion import SectionAdhesion as SectionAdhesionValue
from estimation.values.adhesion import WindowAdhesion
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of, text_of


class WindowCreep(Representation):
    """What the rails did to a wheelset over a window: root mean squares, and how much of its adhesion it used."""

    wheelset: str = Field(examples=["WS-0001"])
    measured_from: Timestamp = Field(description="Start of the window.")
    vehicle: str
    track_section: str | None
    contact_force_n: Uncertain = Field(description="Lateral force at the contacts: creep and gravitational stiffness.")
    lateral_creep_force_n: Uncertain = Field(description="Lateral creep force of both wheels.")
    yaw_creep_moment_n_m: Uncertain = Field(description="Moment of the creep forces about the vertical.")
    used_adhesion_1: Uncertain = Field(
        description="Creep force of a wheel over its normal force, which a hundredth of the samples exceed."
    )
    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    content_digest: str = Field(description="Of the samples.")


class PlaceFriction(Representation):
    """The friction of a place, pooled over passes of wheelsets."""

    from_m: float = Field(description="Where it begins, along the section.")
    to_m: float = Field(description="Where it ends, along the section.")
    friction_1: Uncertain = Field(description="Coefficient of friction; null where creep shows a lower bound alone.")
    at_least_1: float | None = Field(description="Lower end of the 95 % interval; null where nothing is known.")
    low_probability_1: float = Field(
        description="Probability of a friction below the limit of `low_adhesion`, load and sensors being as on file."
    )
    passes: int = Field(description="Passes of wheelsets behind it.")


class LeftOutFriction(Representation):
    """A vehicle, or one wheelset of it, that shows another friction than the others at the same places."""

    vehicle: str
    wheelset: str | None = Field(description="Null where all passes of the vehicle are left out.")
    reason: str | None
    reason_code: ReasonCode | None


class SectionAdhesion(Representation):
    """The friction along a section over some hours, and where it is low."""

    section: str = Field(examples=["main-1"])
    measured_from: Timestamp = Field(description="Start of the first window.")
    measured_to: Timestamp = Field(description="Start of the last window.")
    windows: int = Field(description="Windows that are pooled along the section.")
    left_out: list[LeftOutFriction] = Field(description="Vehicles and wheelsets that contradict the others.")
    low_stretches: list[Stretch] = Field(description="Where friction is below the limit.")
    places: list[PlaceFriction] = Field(description="Places that were passed, in order of distance.")
    links: Links


def window_creep(found: WindowAdhesion) -> WindowCreep:
    """Return the representation of the creep of a window."""
    return WindowCreep(
        wheelset=found.wheelset,
        measured_from=to_rfc3339(found.start_ns),
        vehicle=found.vehicle,
        track_section=found.track_section,
        contact_force_n=uncertain(found.contact_force),
        lateral_creep_force_n=uncertain(found.lateral_creep),
        yaw_creep_moment_n_m=uncertain(found.yaw_creep),
        used_adhesion_1=uncertain(found.used_adhesion),
        status=found.status,
        reason=text_of(found.reason),
        reason_code=code_of(found.reason),
        content_digest=found.content_digest,
    )


def section_adhesion(found: SectionAdhesionValue) -> SectionAdhesion:
    """Return the representation of the friction of a section."""
    own = f"/v1/track-sections/{segment(found.track_section)}"
    return SectionAdhesion(
        section=found.track_section,
        measured_from=to_rfc3339(found.from_ns),
        measured_to=to_rfc3339(found.to_ns),
        windows=found.windows,
        left_out=[
            LeftOutFriction(
                vehicle=one.vehicle,
                wheelset=one.wheelset,
                reason=text_of(one.reason),
                reason_code=code_of(one.reason),
            )
            for one in found.left_out
        ],
        low_stretches=[Stretch(from_m=begin, to_m=end) for begin, end in found.low_stretches],
        places=[
            PlaceFriction(
                from_m=cell.from_m,
                to_m=cell.to_m,
                friction_1=uncertain(cell.friction),
                at_least_1=cell.at_least or None,
                low_probability_1=cell.low_probability,
                passes=cell.passes,
            )
            for cell in found.cells
        ],
        links={"self": f"{own}/adhesion", "section": own, "alerts": "/v1/alerts?kind=low_adhesion"},
    )
