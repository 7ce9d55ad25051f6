"""Track sections and what is known of their alignment and gauge."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Links, Representation, finite_list
from api.schemas.registry import segment
from estimation.ports import TrackSectionRecord
from estimation.types import Status, TrackAlignment

MM = 1000.0


class TrackSection(Representation):
    """A stretch of line; `number` is what the vehicle says on its bus."""

    code: str = Field(examples=["main-1"])
    number: int
    name: str
    rail_profile: str = Field(examples=["56E1"])
    rail_inclination_1: float = Field(examples=[0.05])
    nominal_gauge_mm: float = Field(examples=[1435.0])
    length_m: float
    links: Links


class Alignment(Representation):
    """Lateral alignment and gauge deviation along a section, column by column."""

    section: str
    version: int
    status: Status
    position_m: list[float]
    alignment_mm: list[float | None] = Field(description="Positive to the left.")
    alignment_std_mm: list[float | None]
    gauge_deviation_mm: list[float | None]
    gauge_deviation_std_mm: list[float | None]
    passes: list[int] = Field(description="Passes behind each value; 0 where a recording car measured it.")
    links: Links


def section(record: TrackSectionRecord) -> TrackSection:
    """Return the representation of a track section."""
    own = f"/v1/track-sections/{segment(record.code)}"
    return TrackSection(
        code=record.code,
        number=record.number,
        name=record.name,
        rail_profile=record.rail_profile,
        rail_inclination_1=record.rail_inclination,
        nominal_gauge_mm=record.nominal_gauge_m * MM,
        length_m=record.length_m,
        links={"self": own, "alignment": f"{own}/alignment"},
    )


def alignment(record: TrackAlignment) -> Alignment:
    """Return the representation of an alignment."""
    own = f"/v1/track-sections/{segment(record.section)}"
    return Alignment(
        section=record.section,
        version=record.version,
        status=record.status,
        position_m=[float(s) for s in record.s],
        alignment_mm=finite_list(record.alignment, MM),
        alignment_std_mm=finite_list(record.alignment_std, MM),
        gauge_deviation_mm=finite_list(record.gauge_deviation, MM),
        gauge_deviation_std_mm=finite_list(record.gauge_deviation_std, MM),
        passes=[int(n) for n in record.passes],
        links={"self": f"{own}/alignment?version={record.version}", "section": own},
    )
