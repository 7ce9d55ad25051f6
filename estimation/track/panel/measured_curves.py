"""A wheelset's h(R) = y - d from measured profiles: its contact geometry on the section's rail, inverted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile
from estimation.values.arrays import FloatArray, FrozenArrays

REACH = 8e-3  # m of lateral displacement
STEP = 0.05e-3  # m
ROOM = 0.2e-3  # m beyond the contact table within which a measured profile has no weight


@dataclass(frozen=True, slots=True)
class MeasuredCurve(FrozenArrays):
    """The lateral displacement relative to the track over rL - rR, as it follows from measured profiles.

    Zero at rL = rR: band-limited signals carry no offset.
    """

    name: str  # of what was measured, for reports
    difference: Annotated[FloatArray, "n"]  # rL - rR, m, increasing
    displacement: Annotated[FloatArray, "n"]  # y - d, m
    std: float  # m, of the displacement

    def at(self, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the displacement (k,), m, at some rL - rR (k,), m, and 1 where the profiles reach it, else 0 (k,)."""
        reached = (knots >= self.difference[0] + ROOM) & (knots <= self.difference[-1] - ROOM)
        return np.interp(knots, self.difference, self.displacement), reached.astype(np.float64)

    @property
    def spread(self) -> float:
        """Half of the range of the displacement, m: an error ``std`` of it is a stretch by their ratio."""
        return float(np.ptp(self.displacement)) / 2.0


def measured_curve(
    name: str,
    left: Profile,
    right: Profile,
    std: float,
    *,
    rail: str,
    inclination: float,
    gauge: float,
    at_rails: bool = True,
) -> MeasuredCurve:
    """Return the curve of the measured profiles of a wheelset on a track.

    Args:
        std: Of the displacement that follows, m.
        rail, inclination, gauge: Name of the rail's profile; tangent; nominal gauge, m.
        at_rails: Whether passes have their displacement at rail level, as EN 15302, or that of the axle, which rolls.

    Raises:
        ContactError, ProfileError: The profiles do not meet the rails; no such rail.
    """
    rails = rail_profile(rail)
    wheelset = WheelsetOnTrack(left, right, rails, rails, inclination, gauge)
    x = STEP * np.arange(-round(REACH / STEP), round(REACH / STEP) + 1)
    curve = radius_difference_curve(wheelset, x, method=ContactMethod.EN15302 if at_rails else ContactMethod.RIGID)
    x, R = curve.displacement, curve.difference
    risen = np.maximum.accumulate(R)  # h(R) is the inverse of what rises: a step of R is a flat of h
    first = np.concatenate([[True], np.diff(risen) > 0.0])
    difference, displacement = risen[first], x[first]
    return MeasuredCurve(name, difference, displacement - float(np.interp(0.0, difference, displacement)), std)
