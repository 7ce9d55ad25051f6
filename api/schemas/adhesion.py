"""The friction along a track section."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.evidence import Stretch
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.adhesion import SectionAdhesion as SectionAdhesionValue


class PlaceFriction(Representation):
    """The friction of a place, pooled over passes of wheelsets."""

    from_m: float = Field(description="Where it begins, along the section.")
    to_m: float = Field(description="Where it ends, along the section.")
    friction_1: Uncertain = Field(description="Coefficient of friction; null where creep shows a lower bound alone.")
    at_least_1: float | None = Field(description="Lower end of the 95 % interval; null where nothing is known.")
    low_probability_1: float = Field(description="Probability of a friction below the limit of `low_adhesion`.")
    passes: int = Field(description="Passes of wheelsets behind it.")


class SectionAdhesion(Representation):
    """The friction along a section over some hours, and where it is low."""

    section: str = Field(examples=["main-1"])
    measured_from: Timestamp = Field(description="Start of the first window.")
    measured_to: Timestamp = Field(description="Start of the last window.")
    windows: int = Field(description="Windows that are pooled along the section.")
    low_stretches: list[Stretch] = Field(description="Where friction is below the limit.")
    places: list[PlaceFriction] = Field(description="Places that were passed, in order of distance.")
    links: Links


def section_adhesion(found: SectionAdhesionValue) -> SectionAdhesion:
    """Return the representation of the friction of a section."""
    own = f"/v1/track-sections/{segment(found.track_section)}"
    return SectionAdhesion(
        section=found.track_section,
        measured_from=to_rfc3339(found.from_ns),
        measured_to=to_rfc3339(found.to_ns),
        windows=found.windows,
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
