"""Measured profiles that are a known design: found, moved to the points, and left where the points differ."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.contact.design_curve import nearest_design
from estimation.contact.profiles import Profile, ProfileKind, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import smoothed_profile
from estimation.values.arrays import FloatArray

STEP = 0.1  # mm


def _points(profile: Profile, noise: float = 0.02) -> FloatArray:
    y = np.arange(profile.y[0] * 1e3, profile.y[-1] * 1e3, STEP)
    z = profile.height(y * 1e-3) * 1e3
    return np.column_stack([y, z + np.random.default_rng(4).normal(0.0, noise, len(y))])


@pytest.mark.parametrize(
    ("kind", "profile", "name"),
    [
        ("wheel", wheel_profile("P8"), "P8"),
        ("wheel", wheel_profile("EN13715-S1002/h30/e30"), "EN13715-S1002/h30/e30"),
        ("rail", rail_profile("49E1"), "49E1"),
        ("rail", rail_profile("60E2"), "60E2"),
    ],
)
def test_a_design_is_found_where_the_points_are(kind: ProfileKind, profile: Profile, name: str) -> None:
    turn = 0.02 if kind == "rail" else 0.002
    turned = _points(profile) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [0.7, -0.3]
    design = nearest_design(kind, turned)
    assert design is not None
    assert design.name == name
    assert design.turn == pytest.approx(turn, abs=3e-4)


def test_points_of_no_known_shape_have_no_design() -> None:
    y = np.linspace(-70.0, 60.0, 1300)
    assert (
        nearest_design(
            "wheel", np.column_stack([y, 28.0 * np.exp(-(((y + 55.0) / 12.0) ** 2)) + 2.0 * np.sin(y / 5.0)])
        )
        is None
    )


def test_the_corner_of_a_design_is_kept() -> None:
    profile = wheel_profile("EN13715-S1002/h30/e30")  # with a bend of 0.03 rad at the datum
    smooth = smoothed_profile("wheel", "measured", _points(profile))
    assert smooth.design is not None
    y = np.array([-0.3e-3, 0.3e-3])
    np.testing.assert_allclose(smooth.profile.gradient(y), profile.gradient(y), atol=1e-3)


@pytest.mark.parametrize(("depth_mm", "designs"), [(0.002, 1), (0.1, 0)])
def test_a_worn_wheel_is_no_design(depth_mm: float, designs: int) -> None:
    points = _points(wheel_profile("S1002"))
    points[:, 1] -= depth_mm * np.exp(-0.5 * ((points[:, 0] - 5.0) / 8.0) ** 2)
    assert int(smoothed_profile("wheel", "measured", points).design is not None) == designs


def test_what_a_design_hides_is_in_the_std() -> None:
    points = _points(wheel_profile("S1002"))
    off = 0.01 * np.exp(-0.5 * ((points[:, 0] - 5.0) / 8.0) ** 2)
    points[:, 1] -= off
    smooth = smoothed_profile("wheel", "measured", points)
    assert smooth.design is not None
    random = np.random.default_rng(1)
    y = np.array([5e-3, 25e-3])
    drawn = np.array([np.diff(smooth.draw(random).height(y))[0] for _ in range(40)])
    truth = float(np.diff(wheel_profile("S1002").height(y))[0]) + 0.01e-3 * (1.0 - np.exp(-0.5 * 2.5**2))
    assert abs(float(np.diff(smooth.profile.height(y))[0]) - truth) < 3.0 * drawn.std()
    assert drawn.std() > 8e-7
