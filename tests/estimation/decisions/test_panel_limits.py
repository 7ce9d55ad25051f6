"""When the passes of a section can separate its alignment from the wheelsets, and where it is published."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.track.panel.basis import MeasuredCurve, Panel, PanelParameters, PanelState, init
from estimation.track.panel.solution import PanelSolution, between_pass_std_ratio, result
from estimation.track.passes import ProfileLife
from estimation.values.arrays import FloatArray
from estimation.values.reasons import ReasonCode, code_of

PANEL = Panel.of(PanelParameters(length=100.0, basis_count=5, groups=2, block=50.0))
N = PANEL.grid.points
LIVES = (ProfileLife("W1"), ProfileLife("W2"), ProfileLife("W3"))
KNOWN = MeasuredCurve("W1", np.array([-5e-3, 5e-3]), np.array([-5e-3, 5e-3]), 0.1e-3)


def spread(ratio: float) -> FloatArray:
    """Return R (3, n), m, of three passes whose std at a place is a share of the std of all R."""
    common = 1e-3 * np.where(np.arange(N) % 2, 1.0, -1.0)
    apart = 1e-3 * ratio / np.sqrt(1.0 - 2.0 * ratio**2 / 3.0)
    return common + apart * np.array([[-1.0], [0.0], [1.0]])


def state(R: FloatArray, wheelsets: int = 2, passes: float = 3.0, **changes: object) -> PanelState:
    """Return the sums of a panel in which every basis function is known alike and nothing moves."""
    k, g = PANEL.unknowns, PANEL.parameters.groups
    empty = replace(
        init(PANEL),
        lives=LIVES[:wheelsets],
        gram=np.tile(np.eye(k), (g, wheelsets, 1, 1)),
        cross=np.zeros((g, wheelsets, k)),
        basis_sums=np.zeros((wheelsets, k, N), dtype=np.float32),
        passes=np.full(N, passes),
        difference=np.stack([R.sum(axis=0), (R**2).sum(axis=0)]),
        count=np.full(N, 3, dtype=np.int64),
    )
    return replace(empty, **changes)


def report(made: PanelState) -> tuple[ReasonCode | None, bool]:
    found = result(made, std=False, parameters=PanelParameters())
    return code_of(found.reason), found.curves_fixed


PUBLISHED = (None, False)


def refused(code: ReasonCode) -> tuple[ReasonCode, bool]:
    return (code, False)


@pytest.mark.parametrize("ratio", [0.05, 0.15, 0.6])
def test_the_diversity_is_the_std_between_the_passes_of_a_place_over_that_of_all(ratio: float) -> None:
    R = spread(ratio)
    slow = np.sqrt(np.var(R, axis=0, ddof=1).mean() / (R**2).mean())
    assert slow == pytest.approx(ratio)
    assert between_pass_std_ratio(state(R)) == pytest.approx(ratio)


def test_places_with_one_pass_have_no_part_in_the_diversity() -> None:
    one = np.arange(N) < 40
    R = spread(0.3)
    difference = np.stack([R.sum(axis=0), (R**2).sum(axis=0)])
    difference[:, one] = [[1.0], [1.0]]
    made = state(R, passes=3.0, difference=difference)
    assert between_pass_std_ratio(replace(made, passes=np.where(one, 1.0, 3.0))) == pytest.approx(0.3)
    assert between_pass_std_ratio(replace(made, passes=np.ones(N))) == 0.0
    assert between_pass_std_ratio(state(np.zeros((3, N)))) == 0.0
    alike = np.tile(spread(0.3)[0], (3, 1)) * (1.0 + 1e-9)
    assert between_pass_std_ratio(state(alike)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("ratio", "outcome"), [(0.0505, PUBLISHED), (0.0495, refused(ReasonCode.PASSES_ALIKE))])
def test_a_panel_is_published_from_a_diversity_of_a_twentieth_on(
    ratio: float, outcome: tuple[ReasonCode | None, bool]
) -> None:
    assert report(state(spread(ratio))) == outcome


@pytest.mark.parametrize(("wheelsets", "outcome"), [(2, PUBLISHED), (1, refused(ReasonCode.SINGLE_WHEELSET))])
def test_a_panel_needs_two_wheelsets(wheelsets: int, outcome: tuple[ReasonCode | None, bool]) -> None:
    assert report(state(spread(0.5), wheelsets)) == outcome


@pytest.mark.parametrize(("most", "outcome"), [(3.0, PUBLISHED), (2.9, refused(ReasonCode.TOO_FEW_PASSES))])
def test_a_place_needs_three_passes(most: float, outcome: tuple[ReasonCode | None, bool]) -> None:
    passes = np.where(np.arange(N) == 7, most, 2.5)
    made = replace(state(spread(0.95)), passes=passes)  # sums of three, so that the rest is diverse enough
    assert report(made) == outcome
    solution: PanelSolution = result(made, parameters=PanelParameters())
    published = (np.arange(N) == 7) & (most >= 3.0)
    np.testing.assert_array_equal(np.isfinite(solution.alignment), published)
    np.testing.assert_array_equal(np.isfinite(solution.alignment_std), published)


def test_measured_profiles_separate_what_the_passes_cannot() -> None:
    measured = replace(PANEL, measured={LIVES[0]: KNOWN})
    alone, alike = state(spread(0.5), 1, panel=measured), state(spread(0.03), panel=measured)
    assert report(alone) == report(alike) == (None, True)
    assert report(state(spread(0.5), panel=measured)) == PUBLISHED
    assert report(replace(alike, has_alignment=True)) == refused(ReasonCode.PASSES_ALIKE)
    assert report(replace(alike, passes=np.full(N, 2.0))) == refused(ReasonCode.TOO_FEW_PASSES)
    of_another = replace(PANEL, measured={ProfileLife("W9"): KNOWN})
    assert report(replace(alike, panel=of_another)) == refused(ReasonCode.PASSES_ALIKE)
