"""Conicities that follow from profiles: of the wheel as designed, and of measured wheels, on rails as on file."""

from __future__ import annotations

import numpy as np

from estimation.accuracy.wheel_contact import REACH, STEP, RailShare, WheelPair, conicity_of
from estimation.contact.geometry import WheelsetOnTrack
from estimation.contact.profiles import is_design, rail_profile, wheel_profile
from estimation.contact.radius_difference import radius_difference_curve
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray


def conicity_on_rails(wheels: WheelPair, rails: RailShare, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the conicity (k,) of wheels on rails and its standard deviation; NaN where they have none.

    Args:
        wheels: Profiles, radius and their standard deviation.
        amplitude: (k,) m.
    """
    nothing = np.full(len(amplitude), np.nan)
    try:
        rail = rail_profile(rails.rail)
        radius = wheels.nominal_radius
        wheelset = WheelsetOnTrack(
            wheels.left, wheels.right, rail, rail, rails.inclination, rails.gauge, radius, radius
        )
        x = STEP * np.arange(-round(REACH / STEP), round(REACH / STEP) + 1)
        curve = radius_difference_curve(wheelset, x)
    except (ContactError, ProfileError, ParameterError):
        return nothing, nothing
    found = conicity_of(curve.displacement, curve.difference, amplitude, wheels.std)
    value = np.array([np.nan if one.value is None else one.value for one in found])
    return value, np.array([np.nan if one.std is None else one.std for one in found])


def designed_wheel(profile: str, nominal_radius: float) -> WheelPair | None:
    """Return the wheels of a profile as designed; None where no such profile is built in.

    Args:
        nominal_radius: At the tread datum, m.
    """
    if not is_design(profile):
        return None
    try:
        wheel = wheel_profile(profile)
    except ProfileError:  # it is a rail
        return None
    return WheelPair(wheel, wheel, nominal_radius)
