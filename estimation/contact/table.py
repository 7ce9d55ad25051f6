"""The contact table: what the contact geometry gives at each lateral displacement and gauge deviation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays


class ContactMethod(StrEnum):
    """How the contact points are found."""

    EN15302 = "en15302"  # no roll, smallest vertical gap on each side separately
    RIGID = "rigid"  # the wheelset rolls until both wheels touch


@dataclass(frozen=True, slots=True)
class ContactTable(FrozenArrays):
    """Contact geometry of a wheelset on a track; SI, n lateral displacements by g gauge deviations.

    Lateral displacement is that of the axle's middle relative to the track centre, positive to the left; gauge
    deviation is actual minus nominal gauge. For positive displacement the left wheel runs on its larger radius and
    steeper contact angle. Contact angles are those of the wheel's surface against the axle's axis, positive where the
    radius grows towards the flange; against the track plane the left one is larger by the roll, the right one smaller.
    ``contact_position_*`` is the wheel profile's lateral axis (from the tread datum, positive to the field side),
    ``rail_position_*`` the lateral distance from the track centre, positive on both sides. ``exists`` is False where
    there is no contact of both wheels: there the values are those of the nearest displacement that has one.
    ``jump`` marks the grid points with a contact jump between them and a neighbouring displacement: a contact point
    of either side moves by 0.4 mm while the wheelset moves by 4 um or less. Between two such neighbours the values
    must not be interpolated.
    """

    method: ContactMethod
    lateral_displacement: Annotated[FloatArray, "n"]  # m, strictly increasing
    gauge_deviation: Annotated[FloatArray, "g"]  # m, strictly increasing
    roll: Annotated[FloatArray, "n", "g"]  # rad, positive lifts the left wheel; 0 with EN 15302
    rolling_radius_left: Annotated[FloatArray, "n", "g"]  # m
    rolling_radius_right: Annotated[FloatArray, "n", "g"]  # m
    contact_angle_left: Annotated[FloatArray, "n", "g"]  # rad
    contact_angle_right: Annotated[FloatArray, "n", "g"]  # rad
    contact_position_left: Annotated[FloatArray, "n", "g"]  # m
    contact_position_right: Annotated[FloatArray, "n", "g"]  # m
    rail_position_left: Annotated[FloatArray, "n", "g"]  # m
    rail_position_right: Annotated[FloatArray, "n", "g"]  # m
    exists: Annotated[BoolArray, "n", "g"]
    jump: Annotated[BoolArray, "n", "g"]

    @property
    def rolling_radius_difference(self) -> FloatArray:
        """Left minus right rolling radius (n, g), m."""
        return self.rolling_radius_left - self.rolling_radius_right

    @property
    def rolling_radius_sum(self) -> FloatArray:
        """Left plus right rolling radius (n, g), m."""
        return self.rolling_radius_left + self.rolling_radius_right

    @property
    def contact_angle_difference(self) -> FloatArray:
        """Left minus right contact angle (n, g), rad."""
        return self.contact_angle_left - self.contact_angle_right

    @property
    def contact_angle_sum(self) -> FloatArray:
        """Left plus right contact angle (n, g), rad."""
        return self.contact_angle_left + self.contact_angle_right
