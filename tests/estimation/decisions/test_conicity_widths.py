"""Conicity and nonlinearity of curves whose answer is known, and the widths of their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_curves import (
    AT_3,
    BINS,
    CENTRE,
    CONE,
    EDGES,
    EXACT,
    GROUPS,
    PARAMETERS,
    STRETCHED,
    WIDTH,
    cubic,
    curve,
    deviates,
    estimates,
    line,
    nodes,
    std,
    usable,
    value,
)
from scipy import stats
from scipy.special import ndtr

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.geometry.conicity import (
    CurveReplicates,
)
from estimation.geometry.sharpening import SLOPES, held_difference_std, jumps_displaced, sharpen
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import FloatArray
from estimation.values.geometry import CentreOrigin
from estimation.values.quantities import jackknife_std


def test_a_cone_has_its_conicity_at_every_amplitude_and_no_width() -> None:
    found = estimates(curve())
    for estimate in found.conicity:
        assert value(estimate) == pytest.approx(CONE, rel=1e-4)
        assert std(estimate) == pytest.approx(0.0, abs=1e-7)
        assert estimate.count == 8.0
    assert value(found.nonlinearity) == pytest.approx(0.0, abs=1e-7)
    assert (found.reported_amplitude, found.at_reference) == (3e-3, found.conicity[AT_3])


@pytest.mark.parametrize("groups", [4, 6])
def test_the_spread_of_the_groups_is_the_interval_of_students_t(groups: int) -> None:
    cones = CONE * (1.0 + 0.01 * np.cos(np.arange(groups)))
    found = estimates(curve(line(2 * CONE), *(line(2 * cone) for cone in cones))).at_reference
    expected = np.sqrt((groups - 1) / groups * ((cones - cones.mean()) ** 2).sum())
    assert std(found) == pytest.approx(expected, rel=1e-3)
    assert found.high is not None
    assert found.high - value(found) == pytest.approx(stats.t.ppf(0.975, groups - 1) * expected, rel=1e-3)


@pytest.mark.parametrize(
    ("error", "conicity", "width"),
    [
        (DisplacementError(0.0, 0.0, 0.02), CONE, STRETCHED),
        (DisplacementError(0.0, 0.05, 0.0), CONE / 0.95, CONE / 0.95 - CONE),  # what was taken back
        (DisplacementError(0.1e-3, 0.0, 0.0), CONE, 0.0),  # a straight line has nothing to be sharpened
    ],
)
def test_an_error_of_the_displacement_stretches_a_cone(error: DisplacementError, conicity: float, width: float) -> None:
    found = estimates(curve(error=error)).at_reference
    assert value(found) == pytest.approx(conicity, rel=1e-4)
    assert std(found) == pytest.approx(width, rel=1e-3, abs=1e-7)


def test_uncertain_parameters_add_up() -> None:
    sensitivity = np.stack([line(0.006), line(-0.008)], axis=1)
    found = estimates(curve(sensitivity=sensitivity)).at_reference
    assert std(found) == pytest.approx(np.hypot(0.003, 0.004), rel=1e-3)


def test_four_fifths_of_what_is_systematic_at_one_end_of_the_nonlinearity_is_not_at_the_other() -> None:
    """A stretch changes the conicity of a cone alike at 2 and 4 mm; NP is their difference over 2 mm."""
    found = estimates(curve(error=DisplacementError(0.0, 0.0, 0.02))).nonlinearity
    assert std(found) == pytest.approx(0.8 * np.sqrt(2.0) * STRETCHED / 2.0, rel=1e-3)


def test_the_nonlinearity_is_the_change_of_conicity_over_two_millimetres() -> None:
    third = np.array([3.0, 2.0, 2.5, 3.2, 3.9, 3.4]) * 1e3
    item = curve(cubic(), *(cubic(third=each) for each in third))
    found = estimates(item)
    low, high = (PARAMETERS.amplitudes.index(a) for a in (2e-3, 4e-3))
    change = value(found.conicity[high]) - value(found.conicity[low])
    assert change > 0.01
    assert value(found.nonlinearity) == pytest.approx(change / 2.0)
    conicity, others = by_hand(item, (2e-3, 4e-3))
    jackknife = float(jackknife_std((conicity[:, 1] - conicity[:, 0]) / 2.0))
    assert std(found.nonlinearity) == pytest.approx(np.hypot(jackknife, 0.4 * np.sqrt((others**2).sum())), rel=1e-6)


def by_hand(item: CurveReplicates, amplitudes: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the conicities (1 + g, a) of all replicates, and what each systematic error changes (k, a)."""
    at, rows = nodes(item)
    error, low, high = item.error, EDGES[:-1], EDGES[1:]
    known = np.sqrt(error.std**2 + error.jump_position_std**2)
    blur = float(np.sqrt(known**2 + 0.1e-3**2) if item.band_limited else known)
    sharp = sharpen(low, high, rows[0], jackknife_std(np.stack(rows)), blur)
    x, row = (1.0 - error.excess) * sharp.displacement, sharp.curve(rows[0])

    def conicity(at: FloatArray, curve: FloatArray) -> FloatArray:
        return equivalent_conicity(at, curve, amplitudes)

    found = np.stack([conicity(x, sharp.curve(each)) for each in rows])
    shifted = []
    for k in range(item.sensitivity.shape[1]):
        _, (further,) = nodes(replace(item, difference=item.sensitivity[None, :, k]))
        shifted.append(conicity(x, sharp.curve(rows[0] + further)) - found[0])
    stated = np.hypot(error.std, 0.1e-3) if item.band_limited else error.std
    excess = np.sqrt(max(sharp.blur**2 - stated**2, 0.0))
    place = np.sqrt(0.03e-3**2 + (0.08 * excess) ** 2 + (0.3 * sharp.left) ** 2 + error.jump_mean_std**2)
    middle = zero_crossing(x, row)
    stretches, places = [], []
    for share in deviates():
        stretches.append(conicity((1.0 + share * error.scale) * x, row) - found[0])
        places.append(conicity(x, jumps_displaced(x, row, middle, share * place)) - found[0])
    blurred = 0.3 * (conicity((1.0 - error.excess) * at, rows[0]) - found[0])
    others = [conicity(sharp.displacement, row) - found[0], blurred]
    others += [np.sqrt(np.nanmean(np.square(changes), axis=0)) for changes in (stretches, places)]
    filtered = [lost(x, row, np.array(amplitudes))] if item.band_limited else []
    return found, np.stack([*shifted, *others, *filtered])


def lost(x: FloatArray, row: FloatArray, amplitudes: FloatArray) -> FloatArray:
    """Return 0.15 of the mean of what both sides have in common, up to 3 mm or the nearer end, as conicities (a,)."""
    reach = min(3e-3, -x[0], x[-1])
    alike = [
        np.interp(by, x, row) / 2.0 + np.interp(-by, x, row) / 2.0 - np.interp(0.0, x, row)
        for by in reach * np.arange(61) / 60.0
    ]
    return np.asarray(0.15 * np.mean(np.abs(alike)) / (2.0 * amplitudes))


@pytest.mark.parametrize(
    "error",
    [
        EXACT,
        DisplacementError(0.0, 0.0, 0.03),
        DisplacementError(0.15e-3, 0.01, 0.004, 0.0, 0.05e-3),
        DisplacementError(0.15e-3, 0.01, 0.004, 0.0, 0.3e-3, 0.1e-3),
    ],
)
@pytest.mark.parametrize("band_limited", [True, False])
def test_the_width_at_every_amplitude_is_the_sum_over_all_that_is_uncertain(
    error: DisplacementError, *, band_limited: bool
) -> None:
    shape = cubic() + np.column_stack([0.2e-3 * ndtr((CENTRE - 1.6e-3) / 0.2e-3), np.zeros(BINS), np.zeros(BINS)])
    replicates = [shape + line(0.002 * np.sin(k)) for k in range(GROUPS)]
    sensitivity = np.stack([line(0.004), cubic(0.002, 100.0)], axis=1)
    item = curve(shape, *replicates, error=error, sensitivity=sensitivity, band_limited=band_limited)
    amplitudes = (1e-3, 1.75e-3, 3e-3, 5e-3)
    conicity, others = by_hand(item, amplitudes)
    expected = np.hypot(jackknife_std(conicity), np.sqrt((others**2).sum(axis=0)))
    found = estimates(item)
    for a, wanted, true in zip(amplitudes, expected, conicity[0], strict=True):
        estimate = found.conicity[PARAMETERS.amplitudes.index(a)]
        assert value(estimate) == pytest.approx(true, rel=1e-9)
        assert std(estimate) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(("low", "high", "reach"), [(-28, 28, 3e-3), (-6, 28, 1.625e-3), (-28, 6, 1.625e-3)])
def test_what_both_sides_have_in_common_widens_what_the_high_pass_has_passed(low: int, high: int, reach: float) -> None:
    """A parabola k x^2, on 61 points up to 3 mm or the nearer end; a cubic has nothing that is alike on both sides."""
    k = 10.0
    parabola = np.column_stack([k * CENTRE**2, 2 * k * CENTRE * WIDTH, np.full(BINS, k * WIDTH**2)])
    mean = k * reach**2 * np.mean((np.arange(61) / 60.0) ** 2)
    for shape, expected in ((line(2 * CONE) + parabola, 0.15 * mean), (cubic(), 0.0)):
        item = curve(shape, **usable(low, high))
        as_blurred = replace(item, band_limited=False, error=DisplacementError(0.1e-3, 0.0, 0.0))
        passed, whole = estimates(item).conicity, estimates(as_blurred).conicity
        covered = [k for k, one in enumerate(passed) if one.value is not None]
        assert len(covered) >= 5
        for k in covered:
            added = np.sqrt(std(passed[k]) ** 2 - std(whole[k]) ** 2)
            assert added == pytest.approx(expected / (2.0 * PARAMETERS.amplitudes[k]), rel=1e-3, abs=1e-6)
            assert std(whole[k]) < 2e-5


def test_a_stretch_widens_alike_at_every_amplitude_up_to_the_end_of_the_range() -> None:
    """Shrunk, the curve does not reach the largest amplitudes: there the conicity goes on as at its end."""
    found = estimates(curve(error=DisplacementError(0.0, 0.0, 0.3), **usable(-13, 13)))
    published = [one for one in found.conicity if one.value is not None]
    assert found.reported_amplitude == 3e-3
    for one in published:
        assert std(one) == pytest.approx(std(published[0]), rel=1e-3)
    changes = CONE / (1.0 + 0.3 * deviates()) - CONE
    assert std(published[0]) == pytest.approx(np.sqrt(np.mean(changes**2)), rel=1e-3)


def test_where_nothing_fits_all_that_the_blur_changes_once_more_is_unknown() -> None:
    """Centres 40 um inwards of a line and edges 40 um outwards: no curve within the bounds gives them."""
    wave = 40e-6 * np.sign(CENTRE)
    item = curve(line(2 * CONE) + np.column_stack([-wave, np.zeros(BINS), 8.0 * wave]))
    amplitudes = PARAMETERS.amplitudes[:-4]
    at, (row, *_) = nodes(item)
    left = np.sqrt(0.1e-3**2 + WIDTH**2 / 12.0)
    here = equivalent_conicity(at, row, amplitudes)
    again = equivalent_conicity(at, DisplacementError(left, 0.0, 0.0).rounded(at, row), amplitudes)
    place, middle = np.hypot(0.03e-3, 0.3 * left), zero_crossing(at, row)
    moved = [
        equivalent_conicity(at, jumps_displaced(at, row, middle, share * place), amplitudes) - here
        for share in deviates()
    ]
    found = estimates(item).conicity[:-4]
    np.testing.assert_allclose([value(estimate) for estimate in found], here, rtol=1e-9)
    stds = [std(estimate) for estimate in found]
    np.testing.assert_allclose(
        stds, np.hypot(again - here, np.sqrt(np.nanmean(np.square(moved), axis=0))), rtol=1e-5, atol=1e-9
    )
    assert max(stds) > 0.004


def test_what_a_bogie_holds_off_the_rolling_line_widens_a_bent_curve_and_is_said() -> None:
    shares = (0.5,) * len(SLOPES)
    bent = curve(cubic(), *(cubic() for _ in range(6)), band_limited=True)
    free, held = estimates(bent), estimates(replace(bent, held_shares=shares))
    assert free.at_reference.value == held.at_reference.value
    assert std(held.at_reference) > std(free.at_reference)
    assert free.centre is not None
    assert held.centre is not None
    assert (free.centre.std, held.centre.origin) == (0.0, CentreOrigin.MEAN_RUNNING_POSITION)
    expected = held_difference_std(shares, value(held.at_reference)) / (2.0 * value(held.at_reference))
    assert held.centre.std == pytest.approx(expected)
    assert held.centre.displacement == pytest.approx(0.0, abs=1e-6)
    absolute = estimates(replace(bent, held_shares=shares, band_limited=False))
    assert absolute.centre is not None
    assert (absolute.centre.std, absolute.centre.origin) == (0.0, CentreOrigin.TRACK_CENTRE)


def test_a_known_gauge_blurs_also_what_the_nodes_do_not_allow_to_take_away() -> None:
    """A sharp jump: none of the blur that is stated can be taken away, and all of it is there."""
    jump = 0.3e-3 * (CENTRE > 1.6e-3) - 0.3e-3 * (CENTRE < -1.6e-3)
    shape = line(2 * CONE) + np.column_stack([jump, np.zeros(BINS), np.zeros(BINS)])
    error = DisplacementError(0.0, 0.0, 0.0, 0.0, 0.3e-3)
    place = PARAMETERS.amplitudes.index(2e-3)
    unknown, known = (
        estimates(curve(shape, *[shape] * 6, error=replace(error, gauge_known=gauge_known))).conicity[place]
        for gauge_known in (False, True)
    )
    assert value(known) == value(unknown)
    assert std(known) > 1.5 * std(unknown)
