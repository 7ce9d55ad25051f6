"""Creep forces of a wheelset, and the friction along a track section."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field

from api.schemas.common import Links
from api.schemas.derived import Derived
from api.schemas.evidence import Stretch
from api.schemas.registry import segment
from estimation.values import opinions as values


class WindowCreep(
    Derived,
    of=values.WindowAdhesion,
    without=("sums", "smoothed"),
    columns="wheelset measured_from vehicle track_section contact_force_n lateral_creep_force_n yaw_creep_moment_n_m"
    " used_adhesion_1 status reason reason_code content_digest",
):
    """What the rails did to a wheelset over a window: root mean squares, and how much of its adhesion it used."""


class PlaceFriction(Derived, of=values.CellFriction, without=("cell", "at_least", "vehicles"), also=("from_m", "to_m")):
    """The friction of a place, pooled over passes of wheelsets."""

    at_least_1: float | None = Field(description="Lower end of the 95 % interval; null where nothing is known.")

    @classmethod
    def made(cls, value: values.CellFriction, **own: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of a place."""
        return super().made(value, at_least_1=value.at_least or None, **own)


class LeftOutFriction(Derived, of=values.LeftOut):
    """A vehicle, or one wheelset of it, that shows another friction than the others at the same places."""


class SectionAdhesion(Derived, of=values.SectionAdhesion, without=("certain_stretches",)):
    """The friction along a section over some hours, and where it is low."""

    low_stretches: list[Stretch] = Field(description="Where friction is below the limit.")
    links: Links


def section_adhesion(found: values.SectionAdhesion) -> SectionAdhesion:
    """Return the representation of the friction of a section."""
    own = f"/v1/track-sections/{segment(found.track_section)}"
    return SectionAdhesion.made(
        found,
        low_stretches=[Stretch(**dict(zip(("from_m", "to_m"), ends, strict=True))) for ends in found.low_stretches],
        links={"self": f"{own}/adhesion", "section": own, "alerts": "/v1/alerts?kind=low_adhesion"},
    )
