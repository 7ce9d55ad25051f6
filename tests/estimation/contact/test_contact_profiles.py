"""Analytic profiles against their standards' properties, wear and wear measures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import (
    Profile,
    rail_profile,
    wheel_profile,
)
from estimation.contact.smoothed_profile import profile_from_points
from estimation.contact.wear import TreadWear, WearFamily, wear_course, wear_measures, worn
from estimation.contact.wheel_definitions import RAIL_DEFINITIONS, WHEEL_DEFINITIONS, Segment, evaluate
from estimation.errors import ParameterError, ProfileError

DEFINITIONS = [*WHEEL_DEFINITIONS.items(), *RAIL_DEFINITIONS.items()]


@pytest.mark.parametrize(("name", "segments"), DEFINITIONS)
def test_segments_join_without_a_step(name: str, segments: tuple[Segment, ...]) -> None:
    for before, after in pairwise(segments):
        joint = np.array([before.end])
        assert before.end == after.start, name
        assert abs(before.height(joint)[0] - after.height(joint)[0]) < 9e-4  # mm, as printed in the standards


@pytest.mark.parametrize(("name", "segments"), DEFINITIONS)
def test_slope_is_the_derivative_of_the_height(name: str, segments: tuple[Segment, ...]) -> None:
    for segment in segments:
        y = np.linspace(segment.start, segment.end, 13)[1:-1]
        d = (segment.end - segment.start) * 1e-5
        difference = (segment.height(y + d) - segment.height(y - d)) / (2 * d)
        np.testing.assert_allclose(segment.slope(y), difference, rtol=1e-4, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("name", ["P8", "S1002", "EN15302-A", "EN15302-B"])
def test_a_sampled_profile_meets_its_definition_between_its_points(name: str) -> None:
    profile = wheel_profile(name)
    y = np.linspace(-58.0, 55.0, 7001)
    exact, slope = evaluate(WHEEL_DEFINITIONS[profile.name], y)
    inner = np.abs(slope) < 3.0
    assert np.abs(profile.height(y * 1e-3) * 1e3 - exact)[inner].max() < 9e-4


@pytest.mark.parametrize(
    ("rail", "width_mm", "depth_mm"),
    [
        ("56E1", 69.85, 14.53),
        ("60E1", 72.0, 14.3),
        ("60E2", 72.0, 14.3),
        ("54E1", 70.0, 14.1),
        ("46E1", 65.0, 14.3),
        ("46E2", 62.0, 13.42),
        ("46E3", 73.72, 14.18),  # 72 mm where its sides, continued, meet the top
        ("46E4", 65.0, 13.745),
        ("49E1", 67.0, 14.0),
        ("49E2", 67.0, 13.621),
        ("49E5", 67.0, 14.28),
        ("50E1", 65.0, 13.58),
        ("50E2", 72.0, 14.3),
        ("50E3", 70.0, 14.23),
        ("50E4", 70.0, 14.1),
        ("50E5", 67.0, 13.621),
        ("50E6", 65.0, 13.58),
        ("52E1", 65.0, 12.622),
        ("54E3", 67.0, 14.0),
        ("54E4", 67.0, 14.28),
        ("55E1", 62.0, 13.42),
    ],
)
def test_rail_heads_have_the_published_width(rail: str, width_mm: float, depth_mm: float) -> None:
    profile = rail_profile(rail)
    side = profile.y > 20e-3
    half = np.interp(depth_mm * 1e-3, profile.z[side], profile.y[side])
    assert 2e3 * half == pytest.approx(width_mm, abs=2e-3)
    np.testing.assert_allclose(profile.height(-profile.y), profile.z, atol=1e-12)


def test_names_are_free_in_case_and_punctuation() -> None:
    for spelling in ("en 15302 wheel a", "EN15302_A", "En15302-a"):
        assert wheel_profile(spelling).name == "EN15302-A"
    np.testing.assert_array_equal(rail_profile("bs-113a").z, rail_profile("56e1").z)
    assert rail_profile("EN 15302 rail A").name == "EN15302-A"


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ProfileError, match="P8, S1002") as caught:
        wheel_profile("P9")
    assert caught.value.field == "wheel"
    with pytest.raises(ProfileError, match="56E1"):
        rail_profile("S1002")


def test_a_profile_refuses_what_is_not_finite_or_not_in_order() -> None:
    y = np.linspace(0.0, 1.0, 6)
    with pytest.raises(ProfileError, match="point 3 is not a finite number") as caught:
        profile_from_points("rail", "x", y, np.array([0, 0, np.nan, 0, 0, 0]))
    assert caught.value.field == "z"
    with pytest.raises(ProfileError, match="does not increase at point 4"):
        profile_from_points("rail", "x", np.array([0, 1, 2, 2, 3.0]), np.zeros(5))
    with pytest.raises(ProfileError, match="3 points"):
        profile_from_points("rail", "x", y[:3], y[:3])


@pytest.mark.parametrize(
    ("wheel", "height", "thickness", "gradient"), [("S1002", 28.00, 32.50, 10.79), ("P8", 30.00, 29.94, 12.13)]
)
def test_new_wheels_have_the_published_wear_measures(
    wheel: str, height: float, thickness: float, gradient: float
) -> None:
    measures = wear_measures(wheel_profile(wheel))
    assert measures.flange_height * 1e3 == pytest.approx(height, abs=0.006)
    assert measures.flange_thickness * 1e3 == pytest.approx(thickness, abs=0.006)
    assert measures.flange_gradient * 1e3 == pytest.approx(gradient, abs=0.006)
    assert measures.hollow == pytest.approx(0.0, abs=1e-6)


def test_wear_measures_refuse_a_rail_and_a_wheel_without_a_flange() -> None:
    with pytest.raises(ProfileError, match="rail"):
        wear_measures(rail_profile("60E1"))
    y = np.linspace(-0.02, 0.06, 50)
    with pytest.raises(ProfileError, match="flange"):
        wear_measures(profile_from_points("wheel", "tread", y, -y / 20))


def test_no_wear_gives_the_new_profile() -> None:
    new = wheel_profile("P8")
    same = worn(new, TreadWear(0.0))
    np.testing.assert_allclose(same.z, new.z, atol=1e-15)
    np.testing.assert_allclose(same.slope, new.slope, atol=1e-9)


@given(
    depth=st.floats(0.0, 5e-3),
    centre=st.floats(-5e-3, 15e-3),
    half_width=st.floats(20e-3, 50e-3),
    flange_wear=st.floats(0.0, 4e-3),
)
@settings(max_examples=50)
def test_wear_only_takes_material_away_and_keeps_slopes_true(
    depth: float, centre: float, half_width: float, flange_wear: float
) -> None:
    new = wheel_profile("S1002")
    old = worn(new, TreadWear(depth, centre, half_width, flange_wear))
    outer = new.y > -0.055
    assert (old.z - new.z)[outer].max() < 1e-9
    y = np.linspace(-0.047, 0.055, 401)
    difference = (old.height(y + 1e-6) - old.height(y - 1e-6)) / 2e-6
    assert np.abs(old.gradient(y) - difference).max() < 0.02


def test_the_depth_is_the_height_lost_at_the_centre_and_the_flange_gets_thinner() -> None:
    new = wheel_profile("P8")
    old = worn(new, TreadWear(1e-3, 5e-3, 40e-3, 2e-3))
    at = np.array([5e-3, 45e-3])
    np.testing.assert_allclose(new.height(at) - old.height(at), [1e-3, 0.0], atol=1e-9)
    flange_only = worn(new, TreadWear(0.0, flange_wear=2e-3))
    lost = wear_measures(new).flange_thickness - wear_measures(flange_only).flange_thickness
    assert lost == pytest.approx(2e-3, abs=2e-5)


@pytest.mark.parametrize(
    "bad",
    [
        {"depth": -1e-3},
        {"depth": 0.01},
        {"depth": float("nan")},
        {"depth": 1e-3, "half_width": 0.0},
        {"depth": 1e-3, "centre": float("inf")},
        {"depth": 1e-3, "flange_wear": 5e-3},
    ],
)
def test_impossible_wear_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        TreadWear(**bad)


def test_wear_is_for_wheels() -> None:
    with pytest.raises(ProfileError, match="rail"):
        worn(rail_profile("60E1"), TreadWear(1e-3))


@pytest.mark.parametrize(
    ("family", "wheel", "rail", "inclination", "depths"),
    [
        (WearFamily.P8_ON_56E1, "P8", "56E1", 1 / 20, np.linspace(0.0, 2.2e-3, 9)),
        (WearFamily.S1002_ON_60E1, "S1002", "60E1", 1 / 40, np.linspace(0.0, 1.3e-3, 9)),
    ],
)
@pytest.mark.parametrize("method", list(ContactMethod))
def test_conicity_grows_with_the_course_of_wear(
    family: WearFamily, wheel: str, rail: str, inclination: float, depths: np.ndarray, method: ContactMethod
) -> None:
    y = np.linspace(-6e-3, 6e-3, 241)

    def conicity(profile: Profile) -> float:
        wheelset = WheelsetOnTrack.symmetric(profile, rail_profile(rail), inclination, 1.435)
        table = contact_table(wheelset, y, method=method)
        return float(equivalent_conicity(y, table.rolling_radius_difference[:, 0], [3e-3])[0])

    course = np.array([conicity(worn(wheel_profile(wheel), wear_course(family, float(depth)))) for depth in depths])
    assert 0.1 < course[0] < 0.21
    assert 0.40 < course[-1] < 0.47
    assert np.diff(course).min() > 0.0
