"""Wheel and rail apart: what belongs to the rails of a section, and to the wheels of a wheelset."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.derived import Derived, provenance
from api.schemas.registry import segment
from api.times import Timestamp
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Status
from estimation.values.rails import RailPart, RailsFinding, RailTrend, WheelPart, WheelsFinding
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.results import Result

MM = 1000.0
NO_GEOMETRY = Estimate.unknown(Reason(ReasonCode.NO_GEOMETRY, "there is no geometry at this amplitude yet"))


class ConicityMethod(StrEnum):
    """How a conicity was found; those of different methods are never mixed."""

    GEOMETRY = "geometry"  # from all windows of the wheelset, whatever rails they ran on
    WHEEL_AND_RAIL_APART = "wheel_and_rail_apart"  # without what belongs to the rails of the sections


class RailsAtAmplitude(Representation):
    """What belongs to the rails, at one amplitude of the wheelsets' motion."""

    amplitude_mm: float
    rail_part_1: Uncertain = Field(
        description="Conicity of the fleet's mean wheel on these rails, less that on the reference."
    )
    reference_wheel_conicity_1: Uncertain = Field(
        description="Equivalent conicity of the wheel as designed, on these rails."
    )
    excess_1: Uncertain = Field(description="Of that over what it would be on the rails as on file.")


class RailsPeriod(Derived, of=RailPart, without=("rail", "part", "reference_wheel", "excess")):
    """What was found of the rails over one period."""

    by_amplitude: list[RailsAtAmplitude] = Field(description="Smallest amplitude first.")


class RailsTrend(Derived, of=RailTrend):
    """How fast the excess grows."""


class SectionRails(Derived, of=RailsFinding, without=("amplitude",)):
    """The rails of a section, from the conicities of the wheelsets that ran on it and on others."""

    section: str
    periods: list[RailsPeriod] = Field(description="Oldest first.")
    code_version: str
    input_digest: str
    recorded_at: Timestamp
    links: Links


class ConicityBySource(Representation):
    """The conicity at one amplitude, by one method."""

    method: ConicityMethod = Field(description="How it was found.")
    equivalent_conicity_1: Uncertain = Field(description="At this amplitude, by this method.")


class ConicitiesAtAmplitude(Representation):
    """Conicities at one amplitude, side by side."""

    amplitude_mm: float
    conicities: list[ConicityBySource] = Field(description="One by each method.")


class _WheelPart(Derived, of=WheelPart, without=("wheel", "conicity")):
    """What belongs to the wheels."""


class WheelsetRails(_WheelPart, of=WheelsFinding, without=("amplitude", "part")):
    """The wheels of a wheelset without the rails that it ran on, beside the geometry of all its windows."""

    wheelset: str = Field(examples=["WS-0001"])
    baseline: int = Field(description="Number of reprofilings before it.")
    geometry_baseline: int | None = Field(description="That of the geometry; null without one.")
    interval: int = Field(description="Mileage interval since the last reprofiling.")
    by_amplitude: list[ConicitiesAtAmplitude] = Field(description="Smallest amplitude first.")
    status: Status = Field(description="`estimated` where a conicity is published at some amplitude.")
    code_version: str
    input_digest: str
    recorded_at: Timestamp
    links: Links


def section_rails(found: Result[RailsFinding]) -> SectionRails:
    """Return the representation of what was found of a section's rails."""
    assert found.value is not None
    record, own = found.value, f"/v1/track-sections/{segment(found.subject)}"
    no_trend = record.no_trend if record.trend is None else None
    return SectionRails.made(
        record,
        **provenance(found),
        section=found.subject,
        periods=[_period(one, record.amplitude) for one in record.periods],
        trend_reason=text_of(no_trend),
        trend_reason_code=code_of(no_trend),
        links={"self": f"{own}/rails", "track_section": own},
    )


def wheelset_rails(found: Result[WheelsFinding], geometry: GeometryRecord | None) -> WheelsetRails:
    """Return the representation of a wheelset's wheels, beside its geometry."""
    assert found.value is not None
    record, part, own = found.value, found.value.part, f"/v1/wheelsets/{segment(found.subject)}"
    rows = []
    for amplitude, apart in zip(record.amplitude, part.conicity, strict=True):
        beside = ((ConicityMethod.WHEEL_AND_RAIL_APART, apart), (ConicityMethod.GEOMETRY, _at(geometry, amplitude)))
        conicities = [ConicityBySource(method=how, equivalent_conicity_1=uncertain(one)) for how, one in beside]
        rows.append(ConicitiesAtAmplitude(amplitude_mm=amplitude * MM, conicities=conicities))
    known = any(one.status is Status.ESTIMATED for one in part.conicity)
    return WheelsetRails.made(
        record,
        **_WheelPart.parts(part),
        **provenance(found),
        wheelset=found.subject,
        baseline=part.wheel.baseline,
        geometry_baseline=None if geometry is None else geometry.baseline,
        interval=part.wheel.interval,
        by_amplitude=rows,
        status=Status.ESTIMATED if known else Status.UNESTIMATED,
        links={
            "self": f"{own}/rails",
            "wheelset": own,
            "geometry": f"{own}/geometry",
            **{f"rails:{code}": f"/v1/track-sections/{segment(code)}/rails" for code in part.sections},
        },
    )


def _period(part: RailPart, amplitude: Sequence[float]) -> RailsPeriod:
    columns = zip(amplitude, part.part, part.reference_wheel, part.excess, strict=True)
    return RailsPeriod.made(
        part,
        by_amplitude=[
            RailsAtAmplitude(
                amplitude_mm=at * MM,
                rail_part_1=uncertain(own),
                reference_wheel_conicity_1=uncertain(wheel),
                excess_1=uncertain(excess),
            )
            for at, own, wheel, excess in columns
        ],
    )


def _at(geometry: GeometryRecord | None, amplitude: float) -> Estimate:
    """Return the conicity of a geometry at an amplitude."""
    if geometry is not None:
        for at, one in zip(geometry.geometry.amplitude, geometry.geometry.conicity, strict=True):
            if abs(float(at) - amplitude) < SAME_AMPLITUDE:
                return one
    return NO_GEOMETRY


SAME_AMPLITUDE = 1e-9  # m
