"""At which amplitudes a conicity is published, at which one first, and why not at others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_curves import (
    AT_3,
    BINS,
    CONE,
    EDGES,
    PARAMETERS,
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

from estimation.contact.conicity import equivalent_conicity
from estimation.geometry.conicity import (
    at_reference_amplitude,
    not_covered,
    too_few_blocks,
)
from estimation.geometry.sharpening import sharpen
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode, code_of


def test_the_amplitudes_of_en_15302_and_their_neighbours_are_published() -> None:
    np.testing.assert_allclose(PARAMETERS.amplitudes, np.linspace(0.5e-3, 6e-3, 23), atol=1e-12)
    assert PARAMETERS.reference_amplitude == 3e-3
    assert (PARAMETERS.nonlinearity_low, PARAMETERS.nonlinearity_high) == (2e-3, 4e-3)


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


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_large_conicity_is_published_although_it_is_open_by_half_of_itself(share: float) -> None:
    cone = 6 * CONE
    found = estimates(curve(line(2 * cone), sensitivity=line(2 * 0.25 * cone * share)[:, None]))
    assert value(estimates(curve(line(2 * cone))).at_reference) == pytest.approx(cone, rel=1e-4)
    assert {code_of(one.reason) for one in found.conicity} == {None if share < 1.0 else ReasonCode.CONICITY_OPEN}


def test_reported_is_the_largest_amplitude_that_is_not_open() -> None:
    """A cubic t x^3 has the conicity 3/8 t a^2: with t = 4.5e4 1/m^2 it is 0.085 at 2.25 mm and 0.105 at 2.5 mm."""
    found = estimates(curve(sensitivity=cubic(0.0, 4.5e4)[:, None]))
    published = [a for a, one in zip(found.amplitude, found.conicity, strict=True) if one.value is not None]
    assert max(published) == found.reported_amplitude == pytest.approx(2.25e-3)
    assert value(found.at_reference) == pytest.approx(CONE, rel=1e-4)
    assert code_of(found.conicity[AT_3].reason) is ReasonCode.CONICITY_OPEN
    assert value(found.nonlinearity) == pytest.approx(0.0, abs=1e-7)


def test_a_scale_whose_interval_holds_zero_leaves_the_conicity_open() -> None:
    """Of a cone of 0.02, so that its width alone would not leave it open: stretched to nothing it has any conicity."""
    cone = 0.2 * CONE
    for scale in (0.4, 0.52, 1.5):
        found = estimates(curve(line(2 * cone), error=DisplacementError(0.0, 0.0, scale)))
        if scale < 0.5:
            wanted = np.sqrt(np.mean((cone / (1.0 + scale * deviates()) - cone) ** 2))
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
    sharp = sharpen(low, high, row[kept], np.zeros(35), 0.1e-3)  # of what the high-pass takes away
    expected = equivalent_conicity(0.97 * sharp.displacement, sharp.curve(row[kept]), (2e-3,))
    found = estimates(item)
    assert found.reported_amplitude == pytest.approx(2e-3)
    assert value(found.at_reference) == pytest.approx(expected[0], rel=1e-9)


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
