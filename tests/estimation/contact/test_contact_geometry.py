"""Contact tables against published figures, closed forms, a brute-force search and symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table, radius_difference_curve, refined_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import profile_from_points
from estimation.contact.surfaces import rail_surface
from estimation.contact.wear import TreadWear, worn
from estimation.contact.wheel_definitions import RAIL_DEFINITIONS, WHEEL_DEFINITIONS, evaluate
from estimation.errors import ContactError

PAPER = WheelsetOnTrack.symmetric(wheel_profile("P8"), rail_profile("56E1"), 1 / 20, 1.435)
SHIFTS = np.array([0.5, 1, 2, 3, 4, 5, 6]) * 1e-3
EXACT_GAUGE_A = 1.4351645
"""Gauge at which the origin of rail A is 750.000 mm from the track centre; the standard rounds it to 1435.16."""

LOPSIDED = WheelsetOnTrack(
    left_wheel=worn(wheel_profile("P8"), TreadWear(0.8e-3, 3e-3, 44e-3, 1e-3)),
    right_wheel=wheel_profile("EN15302-A"),
    left_rail=rail_profile("56E1"),
    right_rail=rail_profile("60E2"),
    inclination=1 / 20,
    gauge=1.435,
    left_radius=0.4503,
    right_radius=0.4497,
)


@pytest.mark.parametrize(
    ("wheel", "difference_mm", "tangent"),
    [
        ("A", (0.116, 0.259, 0.667, 1.243, 1.913, 2.936, 4.327), (0.125, 0.155, 0.188, 0.216, 0.254, 0.303)),
        ("C", (0.515, 1.024, 1.271, 1.402, 1.533, 1.665, 1.801), (0.515, 0.365, 0.271, 0.221, 0.191, 0.170)),
    ],
)
def test_reference_results_of_en_15302(
    wheel: str, difference_mm: tuple[float, ...], tangent: tuple[float, ...]
) -> None:
    """EN 15302:2021, rail A at 1435.16 mm, diameters 920 mm."""
    y = np.arange(-900, 901) * 1e-5
    profile = wheel_profile(f"EN15302-{wheel}")
    wheelset = WheelsetOnTrack.symmetric(profile, rail_profile("EN15302-A"), 0.0, 1.43516, radius=0.46)
    table = contact_table(wheelset, y, method=ContactMethod.EN15302)
    difference = table.rolling_radius_difference[:, 0]
    found = np.interp(SHIFTS, y, difference) * 1e3
    assert np.sqrt(np.mean((found - difference_mm) ** 2)) < 0.0025
    as_drawn = WheelsetOnTrack.symmetric(profile, rail_profile("EN15302-A"), 0.0, EXACT_GAUGE_A, radius=0.46)
    exact = contact_table(as_drawn, SHIFTS, method=ContactMethod.EN15302).rolling_radius_difference[:, 0] * 1e3
    assert np.sqrt(np.mean((exact - difference_mm) ** 2)) < 0.0005
    error = np.abs(equivalent_conicity(y, difference, np.arange(1, 7) * 1e-3) - tangent)
    assert error.max() < 0.003
    assert not table.roll.any()


def test_the_papers_pair() -> None:
    """P8 on 56E1 1:20 at 1435 mm: half distance of the contacts 745.2 mm (Ward et al., Table A.1), Delta r 1-4 mm."""
    y = np.arange(-800, 801) * 1e-5
    table = contact_table(PAPER, y, method=ContactMethod.EN15302)
    assert table.rail_position_left[800, 0] == pytest.approx(0.7453, abs=1e-4)
    np.testing.assert_allclose(
        table.rolling_radius_difference[[900, 1000, 1100, 1200], 0] * 1e3, [0.454, 0.913, 1.057, 1.201], atol=6e-4
    )
    found = equivalent_conicity(y, table.rolling_radius_difference[:, 0], np.arange(1, 5) * 1e-3)
    np.testing.assert_allclose(found, [0.180, 0.239, 0.195, 0.167], atol=5e-3)


@given(
    conicity=st.floats(0.02, 0.2),
    displacement=st.floats(-8e-3, 8e-3).filter(lambda y: abs(y) > 1e-5),
    radius=st.floats(0.3, 0.6),
)
@settings(max_examples=25)
def test_cones_on_round_rails(conicity: float, displacement: float, radius: float) -> None:
    """Without roll rL - rR = 2 lambda y; with roll tan(phi) = lambda y / (Yc - lambda h), h the centre's depth."""
    head = 0.040
    wheelset = WheelsetOnTrack.symmetric(_cone(conicity), _round_rail(head), 0.0, 1.435, radius=radius)
    flat = contact_table(wheelset, [displacement], method=ContactMethod.EN15302)
    assert flat.rolling_radius_difference[0, 0] == pytest.approx(2 * conicity * displacement, abs=1e-9)
    centre = 1.435 / 2 + math.sqrt(head**2 - (head - 0.014) ** 2)
    normal = math.hypot(1.0, conicity)
    roll = 0.0
    for _ in range(50):
        reach = radius + conicity * 0.750 + head * normal
        depth = (reach + displacement * math.sin(roll)) / math.cos(roll) - conicity * centre
        roll = math.atan(conicity * displacement / (centre - conicity * depth))
    rigid = contact_table(wheelset, [displacement], method=ContactMethod.RIGID)
    assert rigid.roll[0, 0] == pytest.approx(roll, abs=2e-8)
    expected = 2 * conicity * (displacement * math.cos(roll) + depth * math.sin(roll))
    assert rigid.rolling_radius_difference[0, 0] == pytest.approx(expected, abs=2e-8)
    angles = [rigid.contact_angle_left[0, 0], rigid.contact_angle_right[0, 0]]
    np.testing.assert_allclose(angles, math.atan(conicity), atol=1e-6)


@pytest.mark.parametrize("displacement", [-5.1e-3, -1.7e-3, 0.6e-3, 3.3e-3, 6.0e-3])
@pytest.mark.parametrize("deviation", [-4e-3, 3e-3])
def test_rigid_contact_against_brute_force(displacement: float, deviation: float) -> None:
    table = contact_table(LOPSIDED, [displacement], [deviation])
    roll, left, right = _brute_force(displacement, deviation)
    assert table.roll[0, 0] == pytest.approx(roll, rel=1e-3, abs=3e-7)
    assert table.rolling_radius_left[0, 0] == pytest.approx(left, abs=1e-5)
    assert table.rolling_radius_right[0, 0] == pytest.approx(right, abs=1e-5)


@pytest.mark.parametrize("method", list(ContactMethod))
def test_swapping_the_sides_mirrors_the_table(method: ContactMethod) -> None:
    mirrored = WheelsetOnTrack(
        left_wheel=LOPSIDED.right_wheel,
        right_wheel=LOPSIDED.left_wheel,
        left_rail=LOPSIDED.right_rail,
        right_rail=LOPSIDED.left_rail,
        inclination=LOPSIDED.inclination,
        gauge=LOPSIDED.gauge,
        left_radius=LOPSIDED.right_radius,
        right_radius=LOPSIDED.left_radius,
    )
    y, e = np.linspace(-7e-3, 7e-3, 57), np.array([-3e-3, 0.0, 2e-3])
    first = contact_table(LOPSIDED, y, e, method=method)
    second = contact_table(mirrored, y, e, method=method)
    np.testing.assert_allclose(second.rolling_radius_left, first.rolling_radius_right[::-1], atol=1e-8)
    np.testing.assert_allclose(second.contact_angle_right, first.contact_angle_left[::-1], atol=1e-6)
    np.testing.assert_allclose(second.roll, -first.roll[::-1], atol=1e-9)
    np.testing.assert_array_equal(second.jump, first.jump[::-1])
    assert np.abs(first.rolling_radius_difference + first.rolling_radius_difference[::-1]).max() > 1e-3


def test_signs() -> None:
    table = contact_table(PAPER, [-4e-3, 0.0, 4e-3])
    assert table.rolling_radius_difference[2, 0] > 1e-3
    assert table.contact_angle_difference[2, 0] > 0.01
    assert table.roll[2, 0] > 0
    assert (table.contact_angle_sum > 0).all()
    np.testing.assert_allclose(table.rolling_radius_difference[1], 0.0, atol=1e-9)
    assert table.rolling_radius_sum[1, 0] == pytest.approx(0.9, abs=2e-3)


def test_a_gauge_deviation_moves_each_wheel_against_its_own_rail() -> None:
    """R(x, e) = rho_L(x - e/2) - rho_R(-x - e/2): exact without roll, within a few per cent of the range with it."""
    y, e = np.linspace(-4e-3, 4e-3, 81), np.array([-4e-3, 4e-3])
    wide = np.linspace(-8e-3, 8e-3, 161)
    for method, tolerance in ((ContactMethod.EN15302, 1e-9), (ContactMethod.RIGID, 0.15e-3)):
        table = contact_table(PAPER, y, e, method=method)
        at_nominal = contact_table(PAPER, wide, method=method)
        for column, deviation in enumerate(e):
            left = np.interp(y - deviation / 2, wide, at_nominal.rolling_radius_left[:, 0])
            right = np.interp(y + deviation / 2, wide, at_nominal.rolling_radius_right[:, 0])
            residual = table.rolling_radius_difference[:, column] - (left - right)
            assert np.sqrt(np.mean(residual**2)) < tolerance


def test_jumps_are_where_a_finer_grid_finds_a_discontinuity() -> None:
    wheelset = WheelsetOnTrack.symmetric(wheel_profile("S1002"), rail_profile("60E1"), 1 / 40, 1.435)
    y = np.linspace(-6e-3, 6e-3, 121)
    table = contact_table(wheelset, y)
    assert 4 <= table.jump.sum() <= 16
    fine = np.linspace(-6e-3, 6e-3, 12001)
    left = contact_table(wheelset, fine).contact_position_left[:, 0]
    right = contact_table(wheelset, fine).contact_position_right[:, 0]
    moved = np.maximum(np.abs(np.diff(left)), np.abs(np.diff(right)))
    for at in np.flatnonzero(moved > 1e-3):
        assert table.jump[int((fine[at] - y[0]) / 1e-4), 0]
    between = table.jump[:-1, 0] & table.jump[1:, 0]
    for i in np.flatnonzero(between):
        if i > 0 and between[i - 1]:
            continue
        assert moved[i * 100 : (i + 2) * 100].max() > 0.3e-3


def test_a_fast_but_continuous_movement_is_no_jump() -> None:
    table = contact_table(PAPER, np.linspace(-3e-3, 3e-3, 61), method=ContactMethod.EN15302)
    assert np.abs(np.diff(table.contact_position_left[:, 0])).max() > 1e-3
    assert not table.jump.any()


def test_the_gauge_is_where_it_is_said_to_be() -> None:
    """Rail A in track axes: at 1435.16 mm its origin is 750 mm from the track centre, as EN 15302 draws it."""
    wheelset = WheelsetOnTrack.symmetric(wheel_profile("EN15302-B"), rail_profile("EN15302-A"), 0.0, 1.43516)
    table = contact_table(wheelset, [0.0], method=ContactMethod.EN15302)
    rail, _ = evaluate(RAIL_DEFINITIONS["EN15302-A"], np.arange(-30.0, 35.0, 1e-3))
    wheel, _ = evaluate(WHEEL_DEFINITIONS["EN15302-B"], np.arange(-30.0, 35.0, 1e-3))
    expected = 0.750 + (-30.0 + 1e-3 * np.argmin(rail - wheel)) * 1e-3
    assert table.rail_position_left[0, 0] == pytest.approx(expected, abs=5e-6)


def test_profiles_that_never_touch() -> None:
    wide = WheelsetOnTrack.symmetric(wheel_profile("P8"), rail_profile("56E1"), 0.05, 1.8)
    for method in ContactMethod:
        with pytest.raises(ContactError, match="never touch"):
            contact_table(wide, np.linspace(-5e-3, 5e-3, 11), method=method)


def test_displacements_beyond_contact_are_refused_or_held_and_marked() -> None:
    y = np.linspace(-40e-3, 40e-3, 81)
    with pytest.raises(ContactError, match=r"lateral displacement [+-]\d+\.\d+ mm.*flange") as caught:
        contact_table(PAPER, y)
    assert caught.value.field == "lateral_displacement"
    held = contact_table(PAPER, y, outside="hold")
    assert held.exists[40, 0]
    assert not held.exists[0, 0]
    last = np.flatnonzero(held.exists[:, 0])[-1]
    assert (held.rolling_radius_left[last:, 0] == held.rolling_radius_left[last, 0]).all()
    assert np.isfinite(held.contact_angle_right).all()


@pytest.mark.parametrize(
    ("y", "e", "field"),
    [
        ([0.0, float("nan")], [0.0], "lateral_displacement"),
        ([1e-3, 0.0], [0.0], "lateral_displacement"),
        ([], [0.0], "lateral_displacement"),
        ([0.0], [0.0, 0.0], "gauge_deviation"),
    ],
)
def test_grids_must_be_finite_and_increase(y: list[float], e: list[float], field: str) -> None:
    with pytest.raises(ContactError) as caught:
        contact_table(PAPER, y, e)
    assert caught.value.field == field


def test_impossible_dimensions_are_refused() -> None:
    wheel, rail = wheel_profile("P8"), rail_profile("56E1")
    with pytest.raises(ContactError, match="no wheel"):
        WheelsetOnTrack.symmetric(rail, rail, 0.05, 1.435)
    with pytest.raises(ContactError, match="no rail"):
        WheelsetOnTrack.symmetric(wheel, wheel, 0.05, 1.435)
    with pytest.raises(ContactError, match="gauge"):
        WheelsetOnTrack.symmetric(wheel, rail, 0.05, float("nan"))
    with pytest.raises(ContactError, match="inclination"):
        WheelsetOnTrack.symmetric(wheel, rail, 20.0, 1.435)


def test_a_rail_too_shallow_for_the_gauge_is_refused() -> None:
    y = np.linspace(-0.02, 0.02, 81)
    shallow = profile_from_points("rail", "shallow", y, 5.0 * y**2)
    with pytest.raises(ContactError, match=r"ends 2\.00 mm below its top"):
        contact_table(WheelsetOnTrack.symmetric(wheel_profile("P8"), shallow, 0.0, 1.435), [0.0])


def _cone(conicity: float) -> Profile:
    y = np.linspace(-0.060, 0.060, 25)
    return Profile("wheel", "cone", y, -conicity * y, np.full(25, -conicity))


def _round_rail(radius: float) -> Profile:
    y = radius * np.sin(np.linspace(-1.45, 1.45, 4001))
    return Profile("rail", "round", y, radius - np.sqrt(radius**2 - y**2), y / np.sqrt(radius**2 - y**2))


def _brute_force(displacement: float, deviation: float) -> tuple[float, float, float]:
    """Return roll and radii of LOPSIDED by scanning the roll: every point of a fine polyline, no slopes, no search."""
    sides = []
    for sign, wheel, rail, radius in (
        (1, LOPSIDED.left_wheel, "56E1", LOPSIDED.left_radius),
        (-1, LOPSIDED.right_wheel, "60E2", LOPSIDED.right_radius),
    ):
        lateral = np.arange(-0.055, 0.058, 4e-6)
        points = (0.750 + lateral) + 1j * (radius + wheel.height(lateral))
        across = np.linspace(-36.2, 36.2, 120001)
        depth, _ = evaluate(RAIL_DEFINITIONS[rail], across)
        across, depth = across[np.isfinite(depth)], depth[np.isfinite(depth)]
        placed = (across + 1j * depth) * 1e-3 * np.exp(-1j * math.atan(LOPSIDED.inclination))
        placed -= 1j * placed.imag.min()
        placed += (LOPSIDED.gauge + deviation) / 2 - placed.real[placed.imag <= 0.014].min()
        placed = placed[np.concatenate([[True], np.diff(np.maximum.accumulate(placed.real)) > 0])]
        sides.append((sign, points, placed))

    def gaps(roll: float) -> tuple[float, float, float, float]:
        result = []
        for sign, points, rail in sides:
            turned = points * np.exp(-1j * sign * roll) + sign * displacement
            gap = np.interp(turned.real, rail.real, rail.imag, left=1.0, right=1.0) - turned.imag
            best = int(np.argmin(gap))
            result += [float(gap[best]), float(points[best].imag)]
        return result[0], result[2], result[1], result[3]

    rolls = np.linspace(-0.02, 0.02, 41)
    for last in (False, True):
        difference = np.array([(found := gaps(roll))[0] - found[1] for roll in rolls])
        up = int(np.flatnonzero((difference[:-1] <= 0) & (difference[1:] > 0))[0])
        if not last:
            rolls = np.linspace(rolls[up], rolls[up + 1], 101)
    share = difference[up] / (difference[up] - difference[up + 1])
    roll = float(rolls[up] + share * (rolls[up + 1] - rolls[up]))
    _, _, left, right = gaps(roll)
    return roll, left, right


@pytest.mark.parametrize("method", list(ContactMethod))
def test_a_refined_curve_is_that_of_a_fine_grid_with_jumps_where_they_are(method: ContactMethod) -> None:
    wheelset = WheelsetOnTrack.symmetric(wheel_profile("S1002"), rail_profile("60E1"), 1 / 40, 1.435)
    curve = radius_difference_curve(wheelset, np.linspace(-6e-3, 6e-3, 121), method=method)
    assert (np.diff(curve.displacement) > 0).all()
    assert len(curve.jumps) >= 2
    np.testing.assert_allclose(curve.jumps, -curve.jumps[::-1], atol=2e-9)
    fine = np.linspace(-6e-3, 6e-3, 2401)
    truth = contact_table(wheelset, fine, method=method).rolling_radius_difference[:, 0]
    away = np.abs(fine[:, np.newaxis] - curve.jumps).min(axis=1) > 1e-6
    error = np.interp(fine, curve.displacement, curve.difference) - truth
    assert np.abs(error[away]).max() < 0.3e-6
    for jump in curve.jumps:
        before, after = contact_table(wheelset, [jump - 3e-9, jump + 3e-9], method=method).contact_position_left[:, 0]
        both = contact_table(wheelset, [jump - 3e-9, jump + 3e-9], method=method).contact_position_right[:, 0]
        assert max(abs(after - before), abs(both[1] - both[0])) > 0.4e-3


def test_a_refined_curve_of_a_searched_table_is_that_of_a_search_of_its_own() -> None:
    wheelset = WheelsetOnTrack.symmetric(wheel_profile("S1002"), rail_profile("60E1"), 1 / 40, 1.435)
    x = np.linspace(-15e-3, 15e-3, 61)
    table = contact_table(wheelset, x, (-2e-3, 0.0), outside="hold")
    assert not table.exists[:, 0].all()
    for column, gauge_deviation in enumerate((-2e-3, 0.0)):
        expected = radius_difference_curve(wheelset, x, gauge_deviation, method=ContactMethod.RIGID)
        found = refined_curve(wheelset, table, column)
        np.testing.assert_array_equal(found.displacement, expected.displacement)
        np.testing.assert_array_equal(found.difference, expected.difference)
        np.testing.assert_array_equal(found.jumps, expected.jumps)


def test_a_notch_that_overhangs_when_the_rail_is_inclined_does_not_end_it() -> None:
    rail = rail_profile("60E1")
    near = int(np.searchsorted(rail.y, 20e-3))
    z, slope = rail.z.copy(), rail.slope.copy()
    z[near + 1 :] += 0.5e-3
    slope[near : near + 2] = 40.0
    y = rail.y.copy()
    y[near + 1] = y[near] + 1e-6
    notched = Profile("rail", "notched", y, z, slope)
    surface = rail_surface(notched, 1 / 20, 1.435)
    whole = rail_surface(rail, 1 / 20, 1.435)
    assert surface.step * len(surface.height) == pytest.approx(whole.step * len(whole.height), abs=2e-4)
