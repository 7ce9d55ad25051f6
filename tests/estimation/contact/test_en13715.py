"""EN 13715 wheels by designation: printed points, joints, ranges."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from estimation.contact.profiles import en13715_wheel, is_design, wheel_profile
from estimation.contact.wheel_definitions import Arc
from estimation.errors import ProfileError


def test_s1002_of_28_and_32_5_is_s1002() -> None:
    y = np.linspace(-69e-3, 59e-3, 500)
    found = wheel_profile("EN13715-S1002/h28/e32.5").height(y)
    np.testing.assert_allclose(found, wheel_profile("S1002").height(y), atol=3e-7)


@pytest.mark.parametrize(
    ("height", "radius", "centre", "joint", "face"),
    [
        (28, 20.0, (-58.558, 8.835), -49.663, -39.765),
        (30, 21.5, (-60.733, 10.425), -47.758, -40.530),
        (32, 23.0, (-63.110, 12.558), -46.153, -41.497),
    ],
)
@pytest.mark.parametrize("thickness", [28.5, 32.5])
def test_the_flange_has_the_printed_centres(
    height: int, radius: float, centre: tuple[float, float], joint: float, face: float, thickness: float
) -> None:
    segments = en13715_wheel(f"1/40/h{height}/e{thickness}")
    assert segments is not None
    arc = next(segment for segment in segments if isinstance(segment, Arc) and segment.radius == radius)
    thinner = 32.5 - thickness
    assert (arc.centre_y, arc.centre_z) == (
        pytest.approx(centre[0] - thinner, abs=2e-3),
        pytest.approx(centre[1], abs=0.011),
    )
    assert (arc.start, arc.end) == pytest.approx((joint - thinner, face - thinner), abs=2e-3)


@pytest.mark.parametrize("name", ["S1002/h30/e30", "1/40/h31.5/e29.5/10%", "EN 13715 - 1:40 - h28 - e32.5 - 6.7 %"])
def test_joints_are_closed_and_the_flange_has_its_height_and_thickness(name: str) -> None:
    segments = en13715_wheel(name)
    assert segments is not None
    for before, after in pairwise(segments):
        joint = np.array([before.end])
        assert before.end == after.start
        assert float(after.height(joint)[0] - before.height(joint)[0]) == pytest.approx(0.0, abs=2e-3)
    wheel = wheel_profile(name)
    height, thickness = {"S": (30.0, 30.0), "1": (31.5, 29.5), "E": (28.0, 32.5)}[name[0]]
    assert wheel.z.max() * 1e3 == pytest.approx(height - 0.1, abs=0.11)  # the tip is lower by up to 0.17 mm
    face = (wheel.y > -60e-3) & (wheel.y < -30e-3)
    assert 70.0 + float(np.interp(-10e-3, -wheel.z[face], wheel.y[face]) * 1e3) == pytest.approx(thickness, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "words"), [("S1002/h27/e30", "h = 27"), ("1/40/h30/e33", "e = 33"), ("S1002/h30/e30/20%", "slope = 20")]
)
def test_dimensions_outside_the_standard_are_refused(name: str, words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        wheel_profile(name)


def test_other_names_are_no_designation() -> None:
    assert en13715_wheel("P8") is None
    assert is_design("1/40/h28/e32.5")
    assert not is_design("wheels/h28.whl")
    with pytest.raises(ProfileError, match=r"EN13715-S1002/h28/e32\.5"):
        wheel_profile("EPS")
