"""Conicity, nonlinearity and zero crossing of curves whose answer is known, and the widths of their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.geometry.conicity import (
    CurveEstimates,
    CurveParameters,
    CurveReplicates,
    at_reference_amplitude,
    curve_estimates,
    not_covered,
    too_few_blocks,
)
from estimation.geometry.sharpening import jumps_displaced, sharpen
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import FloatArray
from estimation.values.intervals import NORMAL_95, jackknife_std
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode, code_of

WIDTH = 0.25e-3
EDGES = (np.arange(-28, 30) - 0.5) * WIDTH
CENTRE = 0.5 * (EDGES[:-1] + EDGES[1:])
BINS = len(CENTRE)
EXACT = DisplacementError(0.0, 0.0, 0.0)
PARAMETERS = CurveParameters()
CONE = 0.1  # tan gamma_e: rL - rR = 2 x 0.1 x
GROUPS = 6
AT_3 = PARAMETERS.amplitudes.index(3e-3)
STRETCHED = (CONE / (1.0 - NORMAL_95 * 0.02) - CONE) / NORMAL_95  # by a scale of 0.02, at the end of 95 %


def line(slope: float, offset: float = 0.0) -> FloatArray:
    """Return the quadratics (b, 3) over u of a straight curve, m."""
    return np.column_stack([slope * (CENTRE - offset), np.full(BINS, slope * WIDTH), np.zeros(BINS)])


def cubic(linear: float = 2 * CONE, third: float = 3e3) -> FloatArray:
    """Return the quadratics that osculate a cubic at the centres."""
    value = linear * CENTRE + third * CENTRE**3
    slope = (linear + 3 * third * CENTRE**2) * WIDTH
    return np.column_stack([value, slope, 3 * third * CENTRE * WIDTH**2])


def curve(shape: FloatArray | None = None, *others: FloatArray, **changes: object) -> CurveReplicates:
    whole = line(2 * CONE) if shape is None else shape
    rows = np.stack([whole, *(others or (whole,) * GROUPS)])
    made = CurveReplicates(
        EDGES, rows, np.zeros((BINS, 0, 3)), np.ones(BINS, dtype=bool), EXACT, 8.0, band_limited=True
    )
    return replace(made, **changes)


def estimates(item: CurveReplicates) -> CurveEstimates:
    return curve_estimates(item, PARAMETERS)


def std(estimate: Estimate) -> float:
    assert estimate.std is not None
    return estimate.std


def value(estimate: Estimate) -> float:
    assert estimate.value is not None
    return estimate.value


def test_the_amplitudes_of_en_15302_and_their_neighbours_are_published() -> None:
    np.testing.assert_allclose(PARAMETERS.amplitudes, np.linspace(0.5e-3, 6e-3, 23), atol=1e-12)
    assert PARAMETERS.reference_amplitude == 3e-3
    assert (PARAMETERS.nonlinearity_low, PARAMETERS.nonlinearity_high) == (2e-3, 4e-3)


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


def nodes(item: CurveReplicates) -> tuple[FloatArray, list[FloatArray]]:
    """Return edges and centres (2 b + 1,) and every replicate there: the mean of both bins at an edge."""
    x, rows = [], []
    for replicate in item.difference:
        places, values = [], []
        for b, (r, slope, bend) in enumerate(replicate):
            left = r + slope * -0.5 + bend * 0.25
            if b:
                before = replicate[b - 1]
                left = 0.5 * (left + before[0] + before[1] * 0.5 + before[2] * 0.25)
            places += [EDGES[b], CENTRE[b]]
            values += [left, r]
        last = replicate[-1]
        x = np.array([*places, EDGES[-1]])
        rows.append(np.array([*values, last[0] + last[1] * 0.5 + last[2] * 0.25]))
    return np.asarray(x), rows


def by_hand(item: CurveReplicates, amplitudes: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the conicities (1 + g, a) of all replicates, and what each systematic error changes (k, a)."""
    at, rows = nodes(item)
    error, low, high = item.error, EDGES[:-1], EDGES[1:]
    blur = float(np.hypot(error.std, error.jump_position_std))
    sharp = sharpen(low, high, rows[0], jackknife_std(np.stack(rows)), blur)
    x, row = (1.0 - error.excess) * sharp.displacement, sharp.curve(rows[0])

    def conicity(at: FloatArray, curve: FloatArray) -> FloatArray:
        return equivalent_conicity(at, curve, amplitudes)

    found = np.stack([conicity(x, sharp.curve(each)) for each in rows])
    shifted = []
    for k in range(item.sensitivity.shape[1]):
        _, (further,) = nodes(replace(item, difference=item.sensitivity[None, :, k]))
        shifted.append(conicity(x, sharp.curve(rows[0] + further)) - found[0])
    place = np.sqrt(0.03e-3**2 + (0.3 * (sharp.blur + sharp.left)) ** 2 + error.jump_mean_std**2)
    middle = zero_crossing(x, row)
    stretches, places = [], []
    for share in (-1.959964, -1.0, 1.0, 1.959964):
        stretches.append(conicity((1.0 + share * error.scale) * x, row) - found[0])
        places.append(conicity(x, jumps_displaced(x, row, middle, share * place)) - found[0])
    per_std = np.array([1.959964, 1.0, 1.0, 1.959964])[:, None]
    blurred = 0.5 * (conicity((1.0 - error.excess) * at, rows[0]) - found[0])
    others = [conicity(sharp.displacement, row) - found[0], blurred]
    others += [np.max(np.abs(changes) / per_std, axis=0) for changes in (stretches, places)]
    return found, np.stack([*shifted, *others, lost(x, row, np.array(amplitudes))])


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
def test_the_width_at_every_amplitude_is_the_sum_over_all_that_is_uncertain(error: DisplacementError) -> None:
    shape = cubic() + np.column_stack([0.2e-3 * ndtr((CENTRE - 1.6e-3) / 0.2e-3), np.zeros(BINS), np.zeros(BINS)])
    replicates = [shape + line(0.002 * np.sin(k)) for k in range(GROUPS)]
    item = curve(shape, *replicates, error=error, sensitivity=np.stack([line(0.004), cubic(0.002, 100.0)], axis=1))
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
        passed, whole = (estimates(replace(item, band_limited=limited)).conicity for limited in (True, False))
        covered = [k for k, one in enumerate(passed) if one.value is not None]
        assert len(covered) >= 5
        for k in covered:
            added = np.sqrt(std(passed[k]) ** 2 - std(whole[k]) ** 2)
            assert added == pytest.approx(expected / (2.0 * PARAMETERS.amplitudes[k]), rel=1e-3, abs=1e-6)
            assert std(whole[k]) < 1e-5


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_conicity_that_is_open_by_more_than_a_fifth_is_not_published(share: float) -> None:
    item = curve(sensitivity=line(2 * 0.1 * share)[:, None])
    found = estimates(item)
    for a, one in zip(found.amplitude, found.conicity, strict=True):
        assert one.count == 8.0
        assert code_of(one.reason) is (None if share < 1.0 else ReasonCode.CONICITY_OPEN)
        text = f"the data leave the conicity at {1e3 * a:g} mm open by 0.20 either way"
        assert one.reason is None or one.reason.text == text
    assert found.reported_amplitude == 3e-3
    assert found.at_reference.reason == (None if share < 1.0 else found.conicity[0].reason)
    assert value(found.nonlinearity) == pytest.approx(0.0, abs=1e-7)
    assert std(found.nonlinearity) == pytest.approx(0.8 * np.sqrt(2.0) * 0.1 * share / 2.0, rel=1e-3)
    assert value(estimates(replace(item, band_limited=False)).zero_crossing) == pytest.approx(0.0, abs=1e-9)


def test_a_stretch_widens_alike_at_every_amplitude_up_to_the_end_of_the_range() -> None:
    """Shrunk, the curve does not reach the largest amplitudes: there the conicity goes on as at its end."""
    found = estimates(curve(error=DisplacementError(0.0, 0.0, 0.3), **usable(-13, 13)))
    published = [one for one in found.conicity if one.value is not None]
    assert found.reported_amplitude == 3e-3
    for one in published:
        assert std(one) == pytest.approx(std(published[0]), rel=1e-3)
    assert std(published[0]) == pytest.approx(max(CONE / 0.7 - CONE, (CONE / (1 - 0.588) - CONE) / 1.96), rel=1e-3)


def test_reported_is_the_largest_amplitude_that_is_not_open() -> None:
    """A cubic t x^3 has the conicity 3/8 t a^2: with t = 4.5e4 1/m^2 it is 0.085 at 2.25 mm and 0.105 at 2.5 mm."""
    found = estimates(curve(sensitivity=cubic(0.0, 4.5e4)[:, None]))
    published = [a for a, one in zip(found.amplitude, found.conicity, strict=True) if one.value is not None]
    assert max(published) == found.reported_amplitude == pytest.approx(2.25e-3)
    assert value(found.at_reference) == pytest.approx(CONE, rel=1e-4)
    assert code_of(found.conicity[AT_3].reason) is ReasonCode.CONICITY_OPEN
    assert value(found.nonlinearity) == pytest.approx(0.0, abs=1e-7)


def test_where_nothing_fits_all_that_the_blur_changes_once_more_is_unknown() -> None:
    """Centres 40 um inwards of a line and edges 40 um outwards: no curve within the bounds gives them."""
    wave = 40e-6 * np.sign(CENTRE)
    item = curve(line(2 * CONE) + np.column_stack([-wave, np.zeros(BINS), 8.0 * wave]))
    amplitudes = PARAMETERS.amplitudes[:-4]
    at, (row, *_) = nodes(item)
    left = WIDTH / np.sqrt(12.0)
    here = equivalent_conicity(at, row, amplitudes)
    again = equivalent_conicity(at, DisplacementError(left, 0.0, 0.0).rounded(at, row), amplitudes)
    place, middle = np.hypot(0.03e-3, 0.3 * left), zero_crossing(at, row)
    moved = [
        np.abs(equivalent_conicity(at, jumps_displaced(at, row, middle, share * place), amplitudes) - here) / abs(share)
        for share in (-1.959964, -1.0, 1.0, 1.959964)
    ]
    found = estimates(item).conicity[:-4]
    np.testing.assert_allclose([value(estimate) for estimate in found], here, rtol=1e-9)
    stds = [std(estimate) for estimate in found]
    np.testing.assert_allclose(stds, np.hypot(again - here, np.max(moved, axis=0)), rtol=1e-5, atol=1e-9)
    assert max(stds) > 0.01


def test_a_scale_whose_interval_holds_zero_leaves_the_conicity_open() -> None:
    """Of a cone of 0.02, so that its width alone would not leave it open: stretched to nothing it has any conicity."""
    cone = 0.2 * CONE
    for scale in (0.4, 0.52, 1.5):
        found = estimates(curve(line(2 * cone), error=DisplacementError(0.0, 0.0, scale)))
        if scale < 0.5:
            wanted = (cone / (1.0 - 1.959964 * scale) - cone) / 1.959964
            assert std(found.conicity[0]) == pytest.approx(wanted, rel=1e-3)
            continue
        assert found.nonlinearity.value is None
        for one in (*found.conicity, found.at_reference):
            assert one.value is None
            assert code_of(one.reason) is ReasonCode.CONICITY_OPEN
            assert "the scale of y - d is not known" in str(one.reason)


def test_the_curve_ends_at_the_edges_of_its_last_bins() -> None:
    """Seventeen bins of 0.25 mm; where 3 % is taken back of the displacement, 2 mm lie between centre and edge."""
    item = curve(cubic(), error=DisplacementError(0.0, 0.03, 0.0), **usable(-8, 8))
    first, last = BINS // 2 - 8, BINS // 2 + 8
    _, rows = nodes(item)
    row, (r_low, slope_low, bend_low), (r_high, slope_high, bend_high) = rows[0], cubic()[first], cubic()[last]
    row[2 * first] = r_low - 0.5 * slope_low + 0.25 * bend_low
    row[2 * last + 2] = r_high + 0.5 * slope_high + 0.25 * bend_high
    kept = slice(2 * first, 2 * last + 3)
    low, high = EDGES[first : last + 1], EDGES[first + 1 : last + 2]
    sharp = sharpen(low, high, row[kept], np.zeros(35), 0.0)
    expected = equivalent_conicity(0.97 * sharp.displacement, sharp.curve(row[kept]), (2e-3,))
    found = estimates(item)
    assert found.reported_amplitude == pytest.approx(2e-3)
    assert value(found.at_reference) == pytest.approx(expected[0], rel=1e-9)


def usable(low: int, high: int) -> dict[str, object]:
    """Return that bins from ``low`` to ``high`` beside the middle can be used."""
    at = np.arange(BINS) - BINS // 2
    return {"usable": (at >= low) & (at <= high)}


@pytest.mark.parametrize(
    ("low", "high", "code"),
    [(-2, 2, None), (-2, 1, ReasonCode.TOO_FEW_BINS), (-1, 3, ReasonCode.AMPLITUDE_NOT_COVERED)],
)
def test_a_curve_needs_five_bins_around_zero(low: int, high: int, code: ReasonCode | None) -> None:
    found = estimates(curve(**usable(low, high)))
    assert code_of(found.at_reference.reason) is code
    if code is None:
        assert value(found.at_reference) == pytest.approx(CONE, rel=1e-4)
        assert found.reported_amplitude == pytest.approx(0.5e-3)
    else:
        assert found.reported_amplitude == 3e-3


@pytest.mark.parametrize(("groups", "code"), [(4, None), (3, ReasonCode.TOO_FEW_BLOCKS)])
def test_an_interval_needs_four_groups(groups: int, code: ReasonCode | None) -> None:
    found = estimates(curve(line(2 * CONE), *(line(2 * CONE),) * groups))
    for estimate in (found.at_reference, found.nonlinearity, *found.conicity):
        assert code_of(estimate.reason) is code
        assert estimate.count == 8.0
    assert code_of(too_few_blocks(3)) is ReasonCode.TOO_FEW_BLOCKS
    assert "3 blocks of data, 4" in str(too_few_blocks(3))


def test_the_run_of_bins_ends_at_the_first_that_cannot_be_used_on_each_side() -> None:
    every = np.ones(BINS, dtype=bool)
    middle = BINS // 2
    holed = every.copy()
    holed[[middle - 9, middle + 14]] = False  # up to 2.125 mm to the left and 3.375 mm to the right
    found = estimates(curve(usable=holed))
    covered = [a for a, estimate in zip(found.amplitude, found.conicity, strict=True) if estimate.value is not None]
    assert max(covered) == pytest.approx(2e-3)
    assert found.reported_amplitude == pytest.approx(2e-3)
    assert code_of(found.conicity[-1].reason) is ReasonCode.AMPLITUDE_NOT_COVERED
    assert code_of(found.nonlinearity.reason) is ReasonCode.AMPLITUDE_NOT_COVERED
    assert "amplitude 4 mm" in str(found.nonlinearity.reason)
    holed = every.copy()
    holed[middle] = False
    assert code_of(estimates(curve(usable=holed)).at_reference.reason) is ReasonCode.TOO_FEW_BINS


def test_a_bin_of_which_a_replicate_is_not_finite_cannot_be_used() -> None:
    broken = line(2 * CONE)
    broken[BINS // 2 + 9, 2] = np.nan
    found = estimates(curve(line(2 * CONE), *(line(2 * CONE),) * 5, broken))
    assert found.reported_amplitude == pytest.approx(2e-3)


def test_the_reference_is_three_millimetres_or_the_largest_covered_below() -> None:
    unknown = Estimate.unknown(not_covered(1e-3), 8.0)
    assert "amplitude 1 mm" in str(unknown.reason)
    amplitude = np.array([2e-3, 3e-3 + 1e-12, 4e-3])
    some = estimates(curve()).conicity[:3]
    assert at_reference_amplitude(amplitude, some, PARAMETERS) == (some[1], 3e-3 + 1e-12)
    found = at_reference_amplitude(amplitude, (some[0], unknown, some[2]), PARAMETERS)
    assert found == (some[0], 2e-3)
    for beyond, reported in ((0.9e-9, 3e-3 + 0.9e-9), (1.1e-9, 2e-3)):  # rounding is less than a nanometre
        assert at_reference_amplitude(np.array([2e-3, 3e-3 + beyond, 4e-3]), some, PARAMETERS)[1] == reported
    either = (unknown, Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, "open"), 8.0), unknown)
    assert at_reference_amplitude(amplitude, either, PARAMETERS) == (either[1], 3e-3)
    none, at = at_reference_amplitude(amplitude, (unknown, unknown, some[2]), PARAMETERS)
    assert (code_of(none.reason), at, none.count) == (ReasonCode.AMPLITUDE_NOT_COVERED, 3e-3, 8.0)


def test_the_zero_crossing_moves_with_the_scale_and_is_not_in_band_limited_signals() -> None:
    shape = line(2 * CONE, 0.5e-3)
    found = estimates(curve(shape, band_limited=False, error=DisplacementError(0.0, 0.0, 0.02))).zero_crossing
    assert value(found) == pytest.approx(0.5e-3)
    assert std(found) == pytest.approx(0.02 * 0.5e-3, rel=1e-6)
    assert code_of(estimates(curve(shape)).zero_crossing.reason) is ReasonCode.OFFSET_NOT_OBSERVABLE
    never = estimates(curve(line(2 * CONE, 20e-3), band_limited=False)).zero_crossing
    assert code_of(never.reason) is ReasonCode.NO_ZERO_CROSSING
