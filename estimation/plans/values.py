"""What a turning plan is made from, and its lines."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.reasons import Reason
from estimation.values.served import MM, Served


@dataclass(frozen=True, slots=True)
class DiameterLimits:
    """Limits of the operator's maintenance plan; None is not checked, for no standard gives numbers for every vehicle.

    EN 15313 leaves them to the maintenance plan.
    """

    cut: Annotated[float | None, Served(name="cut_mm", scale=MM)] = None  # m, radius that a turning takes off at least
    minimum_radius: Annotated[float | None, Served(name="minimum_radius_mm", scale=MM)] = None  # m, of a wheel
    axle_difference: Annotated[float | None, Served(name="axle_difference_mm", scale=MM)] = (
        None  # m, greatest difference of diameters of the two wheels of an axle
    )
    bogie_difference: Annotated[float | None, Served(name="bogie_difference_mm", scale=MM)] = (
        None  # m, of any two wheels of a bogie
    )
    vehicle_difference: Annotated[float | None, Served(name="vehicle_difference_mm", scale=MM)] = (
        None  # m, of any two wheels of a vehicle
    )


@dataclass(frozen=True, slots=True)
class Radii:
    """Radii of a wheelset's wheels, m; one number where the two are not distinguished."""

    left: float
    right: float | None = None

    @property
    def wheels(self) -> tuple[float, ...]:
        """Those that are known."""
        return (self.left,) if self.right is None else (self.left, self.right)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A wheelset that runs under a vehicle, as the plan needs it.

    ``due_ns`` is when its limit may be reached (p10), None where that is beyond the horizon; ``unknown`` is why nothing
    can be said of it.
    """

    serial: str
    vehicle: str
    axle: int
    bogie: int | None
    over_limit: bool
    due_ns: int | None
    reason: str  # of its own, in words
    unknown: Reason | None
    radii: Radii | None


class Cause(StrEnum):
    """Why a wheelset is in the plan."""

    DUE = "due"
    TOGETHER = "together"  # with another, for the diameters
    REPLACE = "replace"  # turning it would leave too small a wheel
    NOT_ASSESSED = "not_assessed"  # nothing is known of it


@dataclass(frozen=True, slots=True)
class PlanLine:
    """One wheelset of the plan.

    ``visit`` numbers the visits of a vehicle to the lathe from 1, and ``turn_by_ns`` is when; both None where it is not
    assessed. ``not_checked`` says which limits could not be held against it.
    """

    candidate: Candidate
    cause: Cause
    visit: int | None
    turn_by_ns: int | None
    reason: str
    radius_after: float | None
    not_checked: tuple[str, ...]
