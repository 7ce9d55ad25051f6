"""Contact and conicity of known wheels: cones by hand, standard wheels by the contact table, errors by hand."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.accuracy.wheel_contact import AMPLITUDES, RailShare, WheelContact, WheelPair, conicity_of, wheel_contact
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.smoothed_profile import profile_from_points
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import NORMAL_95

STEEP, FLAT = RailShare("60E1", 1 / 20, 1.435, 0.25), RailShare("60E1", 1 / 40, 1.435, 0.75)


def found(wheels: WheelPair, *rails: RailShare) -> WheelContact:
    contact = wheel_contact(wheels, rails)
    assert isinstance(contact, WheelContact)
    return contact


def test_an_error_of_the_displacement_stretches_a_straight_curve_by_its_share_of_the_amplitude() -> None:
    x = np.linspace(-12e-3, 12e-3, 241)
    std = 0.1e-3
    conicities = conicity_of(x, 0.1 * x, AMPLITUDES, std)  # rL - rR = 2 tan(gamma) y: a conicity of 0.05
    for amplitude, one in zip(AMPLITUDES, conicities, strict=True):
        least = 1.0 - NORMAL_95 * std / amplitude  # a curve pressed together by that is steeper by its inverse
        expected = 0.05 * (1.0 / least - 1.0) / NORMAL_95
        assert one.value == pytest.approx(0.05, rel=1e-6)
        assert one.std == pytest.approx(expected, rel=1e-4)
        assert one.high == pytest.approx(0.05 + NORMAL_95 * expected, rel=1e-4)


def test_an_error_as_large_as_the_amplitude_leaves_it_open() -> None:
    x = np.linspace(-12e-3, 12e-3, 241)
    first, *_, last = conicity_of(x, 0.1 * x, AMPLITUDES, 0.6e-3)
    assert first.value is None
    assert first.reason is not None
    assert first.reason.code is ReasonCode.CONICITY_OPEN
    assert last.status is Status.ESTIMATED


def test_a_drawing_has_no_error_and_what_the_wheels_do_not_reach_is_absent() -> None:
    contact = found(WheelPair(wheel_profile("S1002"), wheel_profile("S1002"), 0.46), FLAT)
    assert {one.std for one in contact.conicity if one.value is not None} == {0.0}
    assert contact.conicity[2].value == pytest.approx(0.174, abs=4e-3)  # as documented, without roll
    assert abs(contact.zero_crossing) < 1e-6
    middle = len(contact.displacement) // 2
    assert contact.radius_sum[middle] == pytest.approx(2 * 0.46, abs=1e-3)
    assert contact.radius_difference_std.max() == 0.0
    x = np.linspace(-5.5e-3, 5.5e-3, 221)
    *inside, last = conicity_of(x, 0.1 * x, AMPLITUDES[:6], 0.0)
    assert all(one.value == pytest.approx(0.05) for one in inside)
    assert last.value is None
    assert last.reason is not None
    assert last.reason.code is ReasonCode.AMPLITUDE_NOT_COVERED


def test_on_rails_of_two_kinds_the_radii_are_the_mean_by_the_running_on_each() -> None:
    left, right = wheel_profile("S1002"), wheel_profile("EN15302-A")
    wheels = WheelPair(left, right, 0.46)
    both, steep, flat = found(wheels, STEEP, FLAT), found(wheels, STEEP), found(wheels, FLAT)
    expected = 0.25 * steep.radius_difference + 0.75 * flat.radius_difference
    np.testing.assert_allclose(both.radius_difference, expected, atol=1e-12)
    rail = rail_profile("60E1")
    wheelset = WheelsetOnTrack(left, right, rail, rail, 1 / 40, 1.435, 0.46, 0.46)
    table = contact_table(wheelset, flat.displacement, method=ContactMethod.EN15302, outside="hold")
    exists = table.exists[:, 0]
    np.testing.assert_allclose(flat.radius_difference[exists], table.rolling_radius_difference[exists, 0])
    assert np.isnan(flat.radius_difference[~exists]).all()
    values = [one.conicity[2].value for one in (steep, both, flat)]
    assert values[0] is not None
    assert values[1] is not None
    assert values[2] is not None
    assert min(values[0], values[2]) < values[1] < max(values[0], values[2])


def test_what_cannot_run_has_a_reason() -> None:
    y = np.linspace(0.05, 0.06, 50)
    stub = profile_from_points("wheel", "stub", y, -y / 20)
    nowhere = wheel_contact(WheelPair(stub, stub, 0.46), (FLAT,))
    assert isinstance(nowhere, Reason)
    assert nowhere.code is ReasonCode.CONTACT_IMPOSSIBLE
    unknown = wheel_contact(WheelPair(stub, stub, 0.46), (RailShare("99E9", 0.0, 1.435, 1.0),))
    assert isinstance(unknown, Reason)
    assert "99E9" in unknown.text
    nothing = wheel_contact(WheelPair(stub, stub, 0.46), ())
    assert isinstance(nothing, Reason)
    assert nothing.code is ReasonCode.SECTION_UNKNOWN


def test_an_error_that_is_as_large_as_the_amplitude_leaves_the_conicity_open() -> None:
    """The stretch is 0 there to the last bit."""
    x = np.linspace(-0.02, 0.02, 401)
    (one,) = conicity_of(x, 0.1 * x, np.array([2.0**-9]), 2.0**-9)
    assert one.reason is not None
    assert one.reason.code is ReasonCode.CONICITY_OPEN
