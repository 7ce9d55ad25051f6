"""What else is said of wheels and rails: apart from each other, the friction between them, and wear signatures."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Query, Response
from pydantic import Field

from api.asking import AskedDep, AskedListDep, Code, MeasuredFrom, MeasuredTo, Serial, require_order
from api.problems import described
from api.schemas.common import Derived, Links, Page, Representation, Uncertain, provenance, segment, uncertain
from api.schemas.evidence import Stretch
from api.times import Moment, Timestamp
from estimation.errors import NotFoundError
from estimation.signatures.answer import most_likely
from estimation.values.geometry import GeometryRecord
from estimation.values.opinions import (
    SECTION_RAILS,
    WHEELSET_RAILS,
    CellFriction,
    LeftOut,
    RailPart,
    RailsFinding,
    RailTrend,
    WheelPart,
    WheelsFinding,
    WindowAdhesion,
)
from estimation.values.opinions import SectionAdhesion as FrictionValue
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.runs import Result
from estimation.values.signatures import ANSWERS, METHOD, Disagreement, SignatureFinding, StateProbability
from estimation.values.signatures import SignatureAnswer as AnswerValue
from estimation.values.signatures import UsedEntry as UsedValue
from estimation.values.units import IN_MM
from fleet_db.rows import present

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


def section_rails(result: Result[RailsFinding]) -> SectionRails:
    """Return the representation of what was found of a section's rails."""
    assert result.value is not None
    record, path = result.value, f"/v1/track-sections/{segment(result.subject)}"
    no_trend = record.no_trend if record.trend is None else None
    return SectionRails.made(
        record,
        **provenance(result),
        section=result.subject,
        periods=[_period(part, record.amplitude) for part in record.periods],
        trend_reason=text_of(no_trend),
        trend_reason_code=code_of(no_trend),
        links={"self": f"{path}/rails", "track_section": path},
    )


def wheelset_rails(result: Result[WheelsFinding], geometry: GeometryRecord | None) -> WheelsetRails:
    """Return the representation of a wheelset's wheels, beside its geometry."""
    assert result.value is not None
    record, part, path = result.value, result.value.part, f"/v1/wheelsets/{segment(result.subject)}"
    rows = []
    for amplitude, apart in zip(record.amplitude, part.conicity, strict=True):
        beside = ((ConicityMethod.WHEEL_AND_RAIL_APART, apart), (ConicityMethod.GEOMETRY, _at(geometry, amplitude)))
        conicities = [ConicityBySource(method=how, equivalent_conicity_1=uncertain(value)) for how, value in beside]
        rows.append(ConicitiesAtAmplitude(amplitude_mm=amplitude * IN_MM, conicities=conicities))
    is_known = any(conicity.status is Status.ESTIMATED for conicity in part.conicity)
    return WheelsetRails.made(
        record,
        **_WheelPart.parts(part),
        **provenance(result),
        wheelset=result.subject,
        baseline=part.wheel.baseline,
        geometry_baseline=None if geometry is None else geometry.baseline,
        interval=part.wheel.interval,
        by_amplitude=rows,
        status=Status.ESTIMATED if is_known else Status.UNESTIMATED,
        links={
            "self": f"{path}/rails",
            "wheelset": path,
            "geometry": f"{path}/geometry",
            **{f"rails:{code}": f"/v1/track-sections/{segment(code)}/rails" for code in part.sections},
        },
    )


def _period(part: RailPart, amplitude: Sequence[float]) -> RailsPeriod:
    columns = zip(amplitude, part.part, part.reference_wheel, part.excess, strict=True)
    return RailsPeriod.made(
        part,
        by_amplitude=[
            RailsAtAmplitude(
                amplitude_mm=motion * IN_MM,
                rail_part_1=uncertain(rail),
                reference_wheel_conicity_1=uncertain(wheel),
                excess_1=uncertain(excess),
            )
            for motion, rail, wheel, excess in columns
        ],
    )


def _at(geometry: GeometryRecord | None, amplitude: float) -> Estimate:
    if geometry is not None:
        for other, conicity in zip(geometry.geometry.amplitude, geometry.geometry.conicity, strict=True):
            if abs(float(other) - amplitude) < SAME_AMPLITUDE:
                return conicity
    return NO_GEOMETRY


SAME_AMPLITUDE = 1e-9  # m


class WindowCreep(
    Derived,
    of=WindowAdhesion,
    without=("sums", "smoothed"),
    columns="wheelset measured_from vehicle track_section contact_force_n lateral_creep_force_n yaw_creep_moment_n_m"
    " used_adhesion_1 status reason reason_code content_digest",
):
    """What the rails did to a wheelset over a window: root mean squares, and how much of its adhesion it used."""


class PlaceFriction(Derived, of=CellFriction, without=("cell", "at_least", "vehicles"), also=("from_m", "to_m")):
    """The friction of a place, pooled over passes of wheelsets."""

    at_least_1: float | None = Field(description="Lower end of the 95 % interval; null where nothing is known.")

    @classmethod
    def made(cls, value: CellFriction, **more: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of a place."""
        return super().made(value, at_least_1=value.at_least or None, **more)


class LeftOutFriction(Derived, of=LeftOut):
    """A vehicle, or one wheelset of it, that shows another friction than the others at the same places."""


class SectionAdhesion(Derived, of=FrictionValue, without=("certain_stretches",)):
    """The friction along a section over some hours, and where it is low."""

    low_stretches: list[Stretch] = Field(description="Where friction is below the limit.")
    links: Links


def section_adhesion(friction: FrictionValue) -> SectionAdhesion:
    """Return the representation of the friction of a section."""
    path = f"/v1/track-sections/{segment(friction.track_section)}"
    return SectionAdhesion.made(
        friction,
        low_stretches=[Stretch(**dict(zip(("from_m", "to_m"), ends, strict=True))) for ends in friction.low_stretches],
        links={"self": f"{path}/adhesion", "section": path, "alerts": "/v1/alerts?kind=low_adhesion"},
    )


class StateOfWear(Derived, of=StateProbability):
    """A range of the equivalent conicity at 3 mm, and how likely the wheelset is in it."""


class UsedEntry(Derived, of=UsedValue):
    """A wheelset of the library on a section, and how much it counts for the answer."""


class MethodsCompared(Derived, of=Disagreement):
    """How far signature and geometry are apart, both at 3 mm."""


class _Said(Derived, of=AnswerValue, without=("used",)):
    """What the library says."""


class SignatureAnswer(_Said, of=SignatureFinding, without=("answer", "signatures")):
    """What a library of other wheelsets' raw signals says of this one; never mixed into its geometry."""

    method: Literal["signature"] = Field(description="How the conicity was found; that of the geometry is `geometry`.")
    state: StateOfWear | None = Field(description="The most likely state; null where nothing is said.")
    used_entries: list[UsedEntry] = Field(
        description="Those that count most, at most ten; without those of fleets that you do not see."
    )
    recorded_at: Timestamp
    code_version: str
    input_digest: str
    links: Links


def signature_answer(result: Result[SignatureFinding], seen: Collection[str]) -> SignatureAnswer:
    """Return the representation of an answer."""
    assert result.value is not None
    said, path = result.value.answer, f"/v1/wheelsets/{segment(result.subject)}"
    return SignatureAnswer.made(
        result.value,
        **provenance(result),
        **dict(_Said.made(said)),
        method=METHOD,
        state=StateOfWear.made(most_likely(said.states)) if said.states else None,
        used_entries=[UsedEntry.made(entry) for entry in said.used if entry.wheelset in seen],
        links={
            "self": f"{path}/signature",
            "wheelset": path,
            "geometry": f"{path}/geometry",
            "windows": f"{path}/windows",
        },
    )


router = APIRouter(prefix="/v1")


@router.get("/wheelsets/{serial}/rails", tags=["wheelsets"], response_model=WheelsetRails, responses=described(404))
def get_wheelset_rails(asked: AskedDep, serial: Serial) -> Response:
    """Return the conicity of the wheels without the rails they ran on, beside that of the geometry."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        rails, current = unit.results.latest(WHEELSET_RAILS, serial), unit.geometries.current(serial)
    return asked.answer(wheelset_rails(present(rails, "rails yet of wheelset", serial), current))


@router.get(
    "/wheelsets/{serial}/creep-forces",
    tags=["wheelsets"],
    response_model=Page[WindowCreep],
    responses=described(400, 404),
)
def list_creep_forces(
    asked: AskedListDep, serial: Serial, measured_from: MeasuredFrom = None, measured_to: MeasuredTo = None
) -> Response:
    """List the creep forces of the wheelset's windows that begin in `[from, to)`, oldest first."""
    require_order(measured_from, measured_to)
    filters = {"wheelset": serial, "from": measured_from, "to": measured_to}
    after = asked.after_time(filters, measured_from)
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        windows = unit.adhesion.of_wheelset(serial, after, asked.limit + 1)
    rows = [window for window in windows if measured_to is None or window.start_ns < measured_to]
    return asked.page(filters, rows, lambda window: window.start_ns, WindowCreep.made)


@router.get(
    "/wheelsets/{serial}/signature", tags=["wheelsets"], response_model=SignatureAnswer, responses=described(404)
)
def get_signature(asked: AskedDep, serial: Serial) -> Response:
    """Return what a library of the other wheelsets' raw signals says of the wheelset, beside its geometry."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        latest = unit.results.latest(ANSWERS, serial)
        if latest is None or latest.value is None:
            raise NotFoundError("signature yet of wheelset", serial)
        used = [entry.wheelset for entry in latest.value.answer.used]
        seen = {wheelset.serial for wheelset in unit.registry.wheelsets_of(used)}
    return asked.answer(signature_answer(latest, seen))


@router.get(
    "/track-sections/{code}/adhesion", tags=["track sections"], response_model=SectionAdhesion, responses=described(404)
)
def get_adhesion(
    asked: AskedDep,
    code: Code,
    at: Annotated[Moment | None, Query(description="Of the hours that hold this time; left out, of the last.")] = None,
) -> Response:
    """Return the friction along the section, pooled over the fleets, and where it is low."""
    with asked.read() as unit:
        unit.tracks.section(code)
        friction = unit.adhesion.section(code, at)
    return asked.answer(section_adhesion(present(friction, "adhesion yet of track section", code)))


@router.get(
    "/track-sections/{code}/rails", tags=["track sections"], response_model=SectionRails, responses=described(404)
)
def get_section_rails(asked: AskedDep, code: Code) -> Response:
    """Return what belongs to the rails of the section, in the conicities of the wheelsets that ran on it."""
    with asked.read() as unit:
        unit.tracks.section(code)
        rails = unit.results.latest(SECTION_RAILS, code)
    return asked.answer(section_rails(present(rails, "rails yet of track section", code)))
