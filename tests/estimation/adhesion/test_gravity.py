"""Contact angles over the rolling radius difference: those of the profiles, and only where the profiles fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.adhesion.parameters import FORCES
from estimation.adhesion.window_adhesion import DISPLACEMENT, ContactAngles, contact_angles
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackSectionRecord

SECTION = TrackSectionRecord("S", 1, "S", "56E1", 0.05, 1.435, 1000.0)
CENTRES = np.arange(-14, 15) * 0.25e-3
WHEEL = worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, 0.55e-3))
PAIR = WheelsetOnTrack.symmetric(WHEEL, rail_profile("56E1"), 0.05, 1.435, radius=0.46)
TABLE = contact_table(PAIR, DISPLACEMENT, method=ContactMethod.EN15302, outside="hold")
R = TABLE.rolling_radius_difference[:, 0]


def found(offset: float = 0.0) -> ContactAngles:
    curve = np.interp(CENTRES, DISPLACEMENT, R) + offset
    curve[[3, 9]] = np.nan  # a contact jump crosses these bins
    angles = contact_angles(CENTRES, curve, "P8", SECTION, 0.46)
    assert isinstance(angles, ContactAngles), angles
    return angles


def test_angles_are_those_of_the_wear_that_meets_the_curve() -> None:
    inner = np.abs(DISPLACEMENT) < 3.5e-3
    difference = (TABLE.contact_angle_left - TABLE.contact_angle_right)[inner, 0]
    total = (TABLE.contact_angle_left + TABLE.contact_angle_right)[inner, 0]
    angles = found()
    assert np.median(np.abs(angles.at(R[inner])[0] - difference)) < 0.1 * difference.std()
    assert np.median(np.abs(angles.at(R[inner])[1] - total)) < 0.1 * total.mean()
    assert angles.misfit < 0.5 * FORCES.most_profile_misfit


def test_a_difference_of_diameters_is_no_wear() -> None:
    np.testing.assert_array_equal(found(0.8e-3).angle_difference, found().angle_difference)


def test_profiles_that_do_not_have_the_curve_are_refused() -> None:
    steep = contact_angles(CENTRES, 1.2 * CENTRES, "P8", SECTION, 0.46)
    assert isinstance(steep, Reason)
    assert steep.code is ReasonCode.PROFILES_UNKNOWN
    assert FORCES.most_profile_misfit == 0.15e-3


def test_names_without_a_shape_and_curves_without_values_are_refused() -> None:
    curve = np.interp(CENTRES, DISPLACEMENT, R)
    unnamed = contact_angles(CENTRES, curve, "measured at Derby", SECTION, 0.46)
    assert isinstance(unnamed, Reason)
    assert unnamed.code is ReasonCode.PROFILES_UNKNOWN
    other_rail = contact_angles(CENTRES, curve, "P8", replace(SECTION, rail_profile="grooved"), 0.46)
    assert isinstance(other_rail, Reason)
    nothing = contact_angles(CENTRES, np.full(len(CENTRES), np.nan), "P8", SECTION, 0.46)
    assert isinstance(nothing, Reason)
    assert nothing.code is ReasonCode.NO_CREEP_CURVE
