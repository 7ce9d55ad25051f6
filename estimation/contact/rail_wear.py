"""Wear of a rail head: a band of the running surface that is worn away, smooth at both ends.

The head loses ``depth * (1 - u^2)^3`` of height, u the distance from the middle of the band over its half width: the
form of the hollow in a tread (``estimation.contact.wear``), twice continuously differentiable, so that wear adds no
corner to the contact. A band towards the gauge side lets the contact of a wheel near its flange go down to the field
side; one in the middle flattens the head. Where the band reaches over the gauge corner, the gauge face is worn too,
because its steep surface is lowered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.contact.profiles import Profile
from estimation.errors import ParameterError, ProfileError

DEEPEST_BAND = 4e-3
"""Largest depth that the form is meant for, m."""


@dataclass(frozen=True, slots=True)
class RailWear:
    """Material that a rail head has lost; metres on the profile's lateral axis.

    Raises:
        ParameterError: Depth outside 0 to 4 mm, a half width that is not positive, a middle that is no number.
    """

    depth: float  # at the middle of the band
    centre: float = 0.0  # lateral, from the middle of the head, negative to the gauge side
    half_width: float = 0.030  # from the middle to where the band ends

    def __post_init__(self) -> None:
        if not 0.0 <= self.depth <= DEEPEST_BAND:
            raise ParameterError(f"{self.depth!r} m is outside 0 to {DEEPEST_BAND} m", field="depth")
        if not (math.isfinite(self.half_width) and self.half_width > 0.0):
            raise ParameterError(f"{self.half_width!r} is not a positive length", field="half_width")
        if not math.isfinite(self.centre):
            raise ParameterError(f"{self.centre!r} is not a position", field="centre")


def worn_rail(rail: Profile, wear: RailWear) -> Profile:
    """Return the rail profile after it has lost that material; the new profile is not touched.

    Raises:
        ProfileError: The profile is a wheel.
    """
    if rail.kind != "rail":
        raise ProfileError(f"{rail.name!r} is a wheel; a band is worn into rails", field="kind")
    if wear.depth == 0.0:
        return rail
    u = np.clip((rail.y - wear.centre) / wear.half_width, -1.0, 1.0)
    rest = 1.0 - u * u
    loss, slope = wear.depth * rest**3, -6.0 * wear.depth / wear.half_width * u * rest**2
    return Profile("rail", f"{rail.name} worn", rail.y, rail.z + loss, rail.slope + slope)
