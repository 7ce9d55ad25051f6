"""Flange and tread measures: of a wheel of straight lines, where they follow by hand, and of worn standard wheels."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.contact.profiles import Profile, wheel_profile
from estimation.contact.smoothed_profile import profile_from_points
from estimation.contact.wear import TreadWear, wear_measures, worn

SLOPE = 2.5  # of the flange face: 2.5 mm down a millimetre towards the tip


def straight_wheel(hollow: float = 0.0, raised: float = 0.0) -> Profile:
    """Return a wheel of straight lines, m: tip level at 30 mm from y = -60 to -52, face of slope 2.5 to the tread.

    The tread is level at 0 from y = -40 on, ``hollow`` deep at y = -10 to 10, and ends ``raised`` above 0 from y = 30.
    """
    corners = [(-70, 12), (-62, 29.9), (-60, 30), (-52, 30), (-40, 0), (-20, 0), (-10, -hollow), (10, -hollow)]
    corners += [(20, 0), (30, raised), (60, raised)]
    y, z = np.array(corners, dtype=float).T
    fine = np.unique(np.concatenate([np.arange(-70.0, 60.01, 0.1), y]))
    heights = np.interp(fine, y, z)
    return Profile("wheel", "straight", 1e-3 * fine, 1e-3 * heights, np.gradient(heights, fine))


def test_a_wheel_of_straight_lines_has_the_measures_that_follow_by_hand() -> None:
    found = wear_measures(straight_wheel())
    # the face z = -2.5 (y + 40) is 10 mm deep at y = -44 and 28 mm deep at y = -51.2; the flange back is at y = -70
    assert found.flange_height == pytest.approx(30e-3, abs=1e-6)
    assert found.flange_thickness == pytest.approx(26e-3, abs=2e-5)
    assert found.flange_gradient == pytest.approx(7.2e-3, abs=2e-5)
    assert found.hollow == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("hollow", "raised", "expected"), [(1.5, 0.0, 1.5), (2.0, 0.75, 2.75), (0.0, -2.0, 0.0)])
def test_a_hollow_counts_from_the_highest_point_farther_out(hollow: float, raised: float, expected: float) -> None:
    found = wear_measures(straight_wheel(hollow, raised))
    assert found.hollow == pytest.approx(1e-3 * expected, abs=1e-5)  # the curve through the points rounds corners
    assert found.flange_height == pytest.approx(1e-3 * (30.0 + hollow), abs=1e-5), "counted from the tread at 70 mm"


def test_a_hollow_tread_raises_and_thickens_the_flange_that_is_counted_from_it() -> None:
    old = wear_measures(worn(wheel_profile("S1002"), TreadWear(2e-3, 0.0, 30e-3)))
    assert old.flange_height == pytest.approx(30e-3, abs=1e-5)
    # 8 mm deep on the arc of 13 mm about (-26.210665, 16.446): y = -26.210665 - sqrt(13^2 - 8.446^2) = -36.0932
    assert old.flange_thickness == pytest.approx(33.9068e-3, abs=1e-5)
    assert 1.2e-3 < old.hollow < 2e-3, "less than was worn off, for the new tread falls towards the field side"


def test_the_measures_do_not_depend_on_where_the_points_are() -> None:
    wheel = wheel_profile("P8")
    y = np.sort(np.random.default_rng(3).uniform(wheel.y[0] + 1e-4, wheel.y[-1] - 1e-4, 4000))
    again = wear_measures(profile_from_points("wheel", "P8 again", y, wheel.height(y)))
    for name in ("flange_height", "flange_thickness", "flange_gradient"):
        assert getattr(again, name) == pytest.approx(getattr(wear_measures(wheel), name), abs=2e-5)
