"""Worn rail heads: what is taken off, and what it does to the conicity."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.accuracy.wheel_contact import RailShare, WheelPair
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table, refined_curve
from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import RailWear, WearFamily, wear_course, worn, worn_rail
from estimation.errors import ParameterError, ProfileError
from estimation.rails.cell import conicity_on_rails, designed_wheel
from estimation.rails.parameters import RailsParameters
from estimation.values.arrays import FloatArray

WEAR = RailWear(0.6e-3, -2e-3, 24e-3)


def test_the_head_is_lower_by_the_depth_at_the_middle_of_the_band_and_nowhere_beyond_it() -> None:
    new = rail_profile("56E1")
    head = worn_rail(new, WEAR)
    y = np.linspace(-26e-3, 22e-3, 97)
    lost = head.height(y) - new.height(y)  # z is down
    u = (y + 2e-3) / 24e-3
    assert lost == pytest.approx(0.6e-3 * (1.0 - u**2) ** 3, abs=2e-6)
    outside = np.abs(new.y + 2e-3) >= 24e-3
    assert np.array_equal(head.z[outside], new.z[outside])


def test_slopes_are_the_derivatives_of_the_heights() -> None:
    head = worn_rail(rail_profile("60E1"), WEAR)
    y = np.linspace(-15e-3, 15e-3, 61)
    assert head.gradient(y) == pytest.approx((head.height(y + 1e-6) - head.height(y - 1e-6)) / 2e-6, abs=2e-3)


def test_no_wear_is_the_new_rail() -> None:
    new = rail_profile("56E1")
    assert worn_rail(new, RailWear(0.0)) is new


def test_a_wheel_is_refused_and_so_is_wear_beyond_the_form() -> None:
    with pytest.raises(ProfileError, match="is a wheel"):
        worn_rail(wheel_profile("P8"), WEAR)
    RailWear(PROFILES.deepest_band)
    for depth, centre, half_width, field in (
        (PROFILES.deepest_band + 1e-6, 0.0, 0.02, "depth"),
        (-1e-6, 0.0, 0.02, "depth"),
        (1e-3, np.nan, 0.02, "centre"),
        (1e-3, 0.0, 0.0, "half_width"),
    ):
        with pytest.raises(ParameterError) as error:
            RailWear(depth, centre, half_width)
        assert error.value.field == field


def test_the_wheel_as_designed_has_the_conicity_of_its_drawing() -> None:
    """P8 on 56E1 1:20 at 1435 mm: 0.195 at 3 mm without roll (EN 15302), 0.199 with it."""
    amplitude = np.array([2e-3, 3e-3])
    wheel = designed_wheel("P8", 0.45)
    assert wheel is not None
    value, std = conicity_on_rails(wheel, RailShare("56E1", 0.05, 1.435, 1.0), amplitude)
    assert value[1] == pytest.approx(0.197, abs=0.004)
    assert (std == 0.0).all()


def test_measured_wheels_have_the_std_of_their_measurement() -> None:
    wheel = wheel_profile("P8")
    pair = WheelPair(wheel, wheel, 0.45, 0.1e-3)
    _, std = conicity_on_rails(pair, RailShare("56E1", 0.05, 1.435, 1.0), np.array([3e-3]))
    assert 0.001 < std[0] < 0.02


def test_what_rails_add_is_nearly_a_straight_line_over_the_conicity_of_the_wheel() -> None:
    """The numbers of the decision; the slopes are what ``slope_std`` is about."""
    depths, slopes = (0.0, 0.3e-3, 0.6e-3, 1.0e-3), []
    wheels = [worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, depth)) for depth in depths]
    new = rail_profile("56E1")
    on_new = np.array([_at_2_mm(wheel, new, 1.435) for wheel in wheels])
    band = worn_rail(new, RailWear(1e-3, 0.0, 25e-3))
    for rail, gauge, least, most in (
        (new, 1.432, -0.137, -0.169),
        (new, 1.438, -0.012, -0.047),
        (band, 1.435, 0.213, 0.184),
    ):
        added = np.array([_at_2_mm(wheel, rail, gauge) for wheel in wheels]) - on_new
        assert (added[0], added[-1]) == pytest.approx((least, most), abs=1.5e-3)
        line = np.polyfit(on_new, added, 1)
        assert np.abs(np.polyval(line, on_new) - added).max() < 0.006
        slopes.append(line[0])
    assert all(-0.6 < slope < 0.0 for slope in slopes)


def test_what_neither_wheel_nor_rail_explains_is_what_is_known_beforehand() -> None:
    """Pins ``interaction`` of the model: three quarters of the rails leave less, away from contact jumps."""
    wheels = [worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, 1e-4 * d)) for d in (1, 3, 5, 7)]
    new = rail_profile("56E1")
    rails = [(new, 1.433), (new, 1.434), (new, 1.436), (new, 1.437)]
    rails += [
        (worn_rail(new, RailWear(depth, centre, 25e-3)), 1.435)
        for depth in (0.3e-3, 0.7e-3)
        for centre in (-1e-3, 1e-3, 3e-3)
    ]
    on_new = np.array([_conicity(wheel, new, 1.435) for wheel in wheels])
    left = []
    for rail, gauge in rails:
        added = np.array([_conicity(wheel, rail, gauge) for wheel in wheels]) - on_new
        for x, y in zip(on_new.T, added.T, strict=True):
            residual = y - np.polyval(np.polyfit(x, y, 1), x)
            left.append(np.sqrt((residual**2).sum() / (len(x) - 2)))
    assert 0.0005 < np.median(left) < 0.5 * RailsParameters().interaction
    assert np.quantile(left, 0.75) < RailsParameters().interaction < np.quantile(left, 0.95)


def _conicity(wheel: Profile, rail: Profile, gauge: float) -> FloatArray:
    """Return the conicity at 1.75 to 3 mm."""
    wheelset = WheelsetOnTrack.symmetric(wheel, rail, 0.05, gauge)
    curve = refined_curve(wheelset, contact_table(wheelset, 0.05e-3 * np.arange(-160, 161), outside="hold"), 0)
    return equivalent_conicity(curve.displacement, curve.difference, 0.25e-3 * np.arange(7, 13))


def _at_2_mm(wheel: Profile, rail: Profile, gauge: float) -> float:
    wheelset = WheelsetOnTrack.symmetric(wheel, rail, 0.05, gauge)
    table = contact_table(wheelset, 0.05e-3 * np.arange(-160, 161), outside="hold")
    curve = refined_curve(wheelset, table, 0)
    return float(equivalent_conicity(curve.displacement, curve.difference, np.array([2e-3]))[0])


def test_what_is_not_built_in_gives_no_reference() -> None:
    assert designed_wheel("P99", 0.45) is None
    assert designed_wheel("56E1", 0.45) is None
    pair = designed_wheel("P8", 0.45)
    assert pair is not None
    value, _ = conicity_on_rails(pair, RailShare("no rail", 0.05, 1.435, 1.0), np.array([3e-3]))
    assert np.isnan(value).all()
