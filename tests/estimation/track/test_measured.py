"""Freshly measured profiles determine the track where the passes alone cannot, and hardly matter where they can."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smooth_wheelset import SmoothTable, track
from test_panel import PARAMETERS, fleet_passes

from estimation.contact.geometry import WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.errors import ContactError, ProfileError
from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.panel.basis import MeasuredCurve, measured_curve
from estimation.track.passes import Pass, ProfileLife
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import SectionParameters
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of

STD = 0.1e-3  # m


def curve(cone: float = 0.10, *, stretched: float = 1.0) -> MeasuredCurve:
    """Return the curve of a wheelset of the simulation, as somebody would have measured it."""
    table = SmoothTable(cone)
    x = table.lateral_displacement
    return MeasuredCurve(
        "W of 2026-01-02", table.left(x) - table.right(x), stretched * table.standard_displacement, STD
    )


def estimated(passes: list[Pass], measured: dict[ProfileLife, MeasuredCurve] | None) -> SectionEstimate:
    return estimate_section("S", passes, None, SectionParameters(panel=PARAMETERS), measured)


@cache
def alike() -> SectionEstimate:
    passes = list(fleet_passes(alike=True))
    return estimated(passes, {passes[0].life: curve()})


def alignment_error(found: SectionEstimate) -> float:
    """Return the std of the error of the alignment over that of the true one."""
    assert found.alignment is not None
    weights = local_cubic_kernel(found.alignment.cutoff_wavelength, PARAMETERS.step)
    truth = track(1)
    true = high_pass(np.interp(found.alignment.s, truth.s, truth.alignment), weights)
    seen = np.isfinite(found.alignment.alignment) & (found.alignment.s > 200) & (found.alignment.s < 1700)
    assert seen.sum() > 1000
    return float((found.alignment.alignment - true)[seen].std() / true[seen].std())


@pytest.mark.parametrize("depth", [0.0, 0.8e-3])
def test_the_curve_is_the_contact_geometry_turned_round(depth: float) -> None:
    wheel = worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, depth))
    found = measured_curve("W", wheel, wheel, STD, rail="56E1", inclination=0.05, gauge=1.435)
    rail = rail_profile("56E1")
    grid = np.arange(-70, 71) * 0.05e-3
    wheelset = WheelsetOnTrack.symmetric(wheel, rail, 0.05, 1.435)
    table = contact_table(wheelset, grid, method=ContactMethod.EN15302)
    back, reached = found.at(table.rolling_radius_difference[:, 0])
    assert reached.all()
    np.testing.assert_allclose(back, grid, atol=0.06e-3)  # a step of the grid, where R hardly rises
    assert found.at(np.zeros(1))[0][0] == pytest.approx(0.0, abs=1e-9)
    assert found.at(np.array([1.0]))[1][0] == 0.0


def test_a_contact_jump_is_a_level_part_of_the_curve() -> None:
    """As deep as the jump itself; on a grid it would be a slope as wide as the grid's step."""
    wheel = worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, 0.8e-3))
    found = measured_curve("W", wheel, wheel, STD, rail="56E1", inclination=0.05, gauge=1.435)
    wheelset = WheelsetOnTrack.symmetric(wheel, rail_profile("56E1"), 0.05, 1.435)
    jumps = radius_difference_curve(wheelset, np.arange(-70, 71) * 0.05e-3).jumps
    assert len(jumps) == 2
    beside = np.sort(np.concatenate([jumps - 2e-9, jumps + 2e-9]))
    across = contact_table(wheelset, beside, method=ContactMethod.EN15302).rolling_radius_difference
    for before, after in across[:, 0].reshape(2, 2):
        assert after - before > 20e-6
        displacement, reached = found.at(np.linspace(before, after, 5)[1:-1])
        assert reached.all()
        assert np.ptp(displacement) < 5e-9


def test_profiles_that_cannot_be_used_are_named() -> None:
    wheel, rail = wheel_profile("P8"), rail_profile("56E1")
    with pytest.raises(ProfileError, match="99E9"):
        measured_curve("W", wheel, wheel, STD, rail="99E9", inclination=0.05, gauge=1.435)
    with pytest.raises(ContactError, match="wheel"):
        measured_curve("W", rail, wheel, STD, rail="56E1", inclination=0.05, gauge=1.435)


def test_one_measured_wheelset_lets_a_fleet_of_alike_ones_determine_the_track() -> None:
    found = alike()
    assert found.report.status is Status.ESTIMATED
    assert found.report.diversity < 0.15
    assert found.report.evidence == ("measured profiles of W of 2026-01-02",)
    assert alignment_error(found) < 0.15
    assert found.alignment is not None
    known = np.isfinite(found.alignment.alignment_std)
    assert (found.alignment.alignment_std[known] > 0.9 * STD).all()
    assert found.alignment.scale_std > STD / curve().spread
    assert found.alignment.findings is not None
    assert set(found.alignment.findings.stiffness_ratio.values()) == {1.0}  # nothing was learnt of the vehicles
    assert found.alignment.findings.stiffness_ratio_std > 0.1


def test_a_measurement_a_tenth_too_wide_is_accepted_without_other_information() -> None:
    passes = list(fleet_passes(alike=True))
    wide = estimated(passes, {passes[0].life: curve(stretched=1.1)})
    assert alignment_error(wide) > 1.15 * alignment_error(alike())


def test_one_measured_wheelset_alone_is_enough() -> None:
    own = [
        replace(item, life=ProfileLife("W"), start_ns=i * 10**14) for i, item in enumerate(fleet_passes(alike=True)[:3])
    ]
    assert code_of(estimated(own, None).report.reason) is ReasonCode.SINGLE_WHEELSET
    assert code_of(estimated(own, {ProfileLife("another"): curve()}).report.reason) is ReasonCode.SINGLE_WHEELSET
    found = estimated(own, {ProfileLife("W"): curve()})
    assert found.report.status is Status.ESTIMATED
    assert alignment_error(found) < 0.2


def test_a_fleet_that_determines_the_track_hardly_heeds_a_wrong_measurement() -> None:
    passes = list(fleet_passes())
    without = estimated(passes, None)
    wrong = estimated(passes, {ProfileLife("cone 0.1"): curve(stretched=1.2)})
    assert wrong.report.evidence
    assert alignment_error(wrong) < alignment_error(without) + 0.02


def test_passes_with_the_displacement_of_the_axle_are_held_against_a_curve_that_rolls() -> None:
    wheel = wheel_profile("P8")
    grid = np.arange(-40, 41) * 0.05e-3
    table = contact_table(WheelsetOnTrack.symmetric(wheel, rail_profile("56E1"), 0.05, 1.435), grid)
    found = measured_curve("W", wheel, wheel, STD, rail="56E1", inclination=0.05, gauge=1.435, at_rails=False)
    back, reached = found.at(table.rolling_radius_difference[:, 0])
    assert reached.all()
    np.testing.assert_allclose(back, grid, atol=0.06e-3)
