"""Which passes make an alignment of a section, which journeys are left out of it, and what its report says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from test_agreement_limits import smooth

from estimation.track.gridded_pass import PlacedJourney, grid_pass
from estimation.track.iteration import IterationResult
from estimation.track.panel.basis import MeasuredCurve, Panel, PanelParameters, init
from estimation.track.panel.instrumental_slope import Ratio, SlopeCorrection
from estimation.track.panel.solution import prior_on_grid, result
from estimation.track.passes import Journey, Pass, ProfileLife, journeys
from estimation.track.results import merged_alignment
from estimation.track.section import (
    SectionEstimate,
    _Accepted,
    _low_weight_reason,
    _not_converged_reason,
    _state_of,
    _too_few_passes,
    estimate_section,
)
from estimation.track.settings import SectionParameters
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import AlignmentSource, Convergence, Correction, Iterated, TrackAlignment

LENGTH = 600
P = SectionParameters(panel=PanelParameters(length=float(LENGTH), groups=4, block=75.0))
PANEL = Panel.of(P.panel)
D = 0.4e-3 * smooth(1, LENGTH + 400, width=6)  # m, from 200 m before the section to 200 m behind it
ELSEWHERE = 0.8e-3 * smooth(2, LENGTH + 400, width=6)
KNOWN = MeasuredCurve("W9", np.array([-5e-3, 5e-3]), np.array([-5e-3, 5e-3]), 0.1e-3)
WHY = Reason(ReasonCode.JOURNEY_DISAGREES, "agrees with no other")


def a_pass(number: int, place: FloatArray = D, start_ns: int = 0, noise: float = 0.01e-3, slope: float = 0.2) -> Pass:
    n = len(place)
    R = 0.3e-3 * smooth(100 + number, n, width=8)
    y = place + slope * R + noise * smooth(200 + number, n)
    return Pass(ProfileLife(f"W{number}"), f"V{number}", start_ns, np.arange(-200.0, n - 200.0), y, R)


def estimated(*passes: Pass, prior: TrackAlignment | None = None) -> SectionEstimate:
    return estimate_section("S", passes, prior, P)


@pytest.fixture(scope="module")
def three() -> SectionEstimate:
    return estimated(*(a_pass(k, start_ns=5) for k in range(3)))


def test_three_journeys_that_agree_make_an_alignment_with_its_report(three: SectionEstimate) -> None:
    report, alignment = three.report, three.alignment
    assert alignment is not None
    assert (report.status, report.reason, report.converged) == (Status.ESTIMATED, None, True)
    assert (report.passes, report.wheelsets, report.mean_passes, report.evidence) == (3, 3, 3.0, ())
    assert [(one.vehicle, one.from_ns, one.to_ns, one.passes, one.used, one.reason) for one in report.journeys] == [
        (f"V{k}", 5, 5, 1, True, None) for k in range(3)
    ]
    certain = np.isfinite(alignment.alignment)
    assert report.covered == pytest.approx(certain.sum() / len(certain))
    assert report.covered > 0.8
    assert report.alignment_std_m == pytest.approx(float(np.median(alignment.alignment_std[certain])))
    assert set(three.corrections) == {(f"V{k}", 5) for k in range(3)}
    assert (report.rounds, report.moved_m < 0.1) == (report.convergence[0].rounds, True)


def test_a_journey_of_another_place_is_left_out_of_it(three: SectionEstimate) -> None:
    found = estimated(*(a_pass(k) for k in range(3)), a_pass(3, ELSEWHERE))
    assert found.alignment is not None
    assert [one.used for one in found.report.journeys] == [True, True, True, False]
    assert code_of(found.report.journeys[3].reason) is ReasonCode.JOURNEY_DISAGREES
    assert found.report.journeys[3].residual_rms_m > 0.4e-3
    assert (found.report.passes, found.report.wheelsets) == (3, 3)
    assert set(found.corrections) == {(f"V{k}", 0) for k in range(3)}
    assert three.alignment is not None
    np.testing.assert_allclose(found.alignment.alignment, three.alignment.alignment, atol=1e-6)


def test_a_wheelset_that_fits_badly_counts_less() -> None:
    found = estimated(*(a_pass(k, slope=0.8) for k in range(4)), a_pass(4, noise=0.3e-3, slope=0.8))
    assert code_of(found.report.reason) is ReasonCode.LOW_WEIGHT
    assert "W4 (0." in str(found.report.reason)
    assert all(one.used for one in found.report.journeys)


def test_passes_that_are_alike_make_a_report_and_no_alignment() -> None:
    one = a_pass(0)
    same = [replace(one, life=ProfileLife(f"W{k}"), vehicle=f"V{k}") for k in range(3)]
    found = estimated(*same)
    assert (found.alignment, found.corrections) == (None, {})
    assert (found.report.status, code_of(found.report.reason)) == (Status.UNESTIMATED, ReasonCode.PASSES_ALIKE)
    assert found.report.diversity < 0.01
    assert np.isfinite(found.report.alignment_std_m)
    assert found.solution is not None


def test_without_passes_there_is_no_alignment() -> None:
    found = estimated()
    assert (found.alignment, code_of(found.report.reason), found.report.evidence) == (None, ReasonCode.NO_PASS, ())


def prior() -> TrackAlignment:
    n = LENGTH + 1
    zero = np.zeros(n)
    return TrackAlignment(
        "S", 7, np.arange(float(n)), D[200 : 200 + n], zero + 0.05e-3, zero, zero, np.ones(n, dtype=np.int64),
        Status.ESTIMATED, source=AlignmentSource.RECORDED,
    )  # fmt: skip


def test_what_was_known_makes_one_pass_enough_and_is_named() -> None:
    alone = estimated(a_pass(0))
    assert (alone.alignment, code_of(alone.report.reason)) == (None, ReasonCode.SINGLE_WHEELSET)
    found = estimated(a_pass(0), prior=prior())
    assert found.alignment is not None
    assert (found.report.status, found.report.evidence) == (Status.ESTIMATED, ("recorded version 7",))
    nowhere = replace(prior(), alignment=np.full(LENGTH + 1, np.nan), alignment_std=np.full(LENGTH + 1, np.nan))
    assert code_of(estimated(a_pass(0), prior=nowhere).report.reason) is ReasonCode.SINGLE_WHEELSET
    assert estimated(prior=prior()).report.evidence == ("recorded version 7",)


def reason_against(*spans: tuple[float, float], wheelsets: int = 2, panel: Panel = PANEL) -> ReasonCode | None:
    passes = []
    for number, (first, last) in enumerate(spans):
        at = np.array([first, last])
        passes.append(Pass(ProfileLife(f"W{number % wheelsets}"), f"V{number}", 0, at, 0.0 * at, 0.0 * at))
    return code_of(_too_few_passes(journeys(passes, P.positions), panel))


def test_three_passes_of_two_wheelsets_must_meet_on_the_section() -> None:
    assert reason_against((0.0, 300.0), (250.0, 500.0), (298.0, 600.0)) is None
    assert reason_against((0.0, 300.0), (250.0, 500.0), (300.0, 600.0)) is ReasonCode.TOO_FEW_PASSES
    assert reason_against((-900.0, 2.0), (-900.0, 2.0), (-900.0, 2.0)) is None
    assert reason_against((-900.0, -2.0), (-900.0, -2.0), (-900.0, -2.0)) is ReasonCode.TOO_FEW_PASSES
    assert reason_against((700.0, 900.0), (700.0, 900.0), (700.0, 900.0)) is ReasonCode.TOO_FEW_PASSES
    assert reason_against((0.0, 600.0), (0.0, 600.0)) is ReasonCode.TOO_FEW_PASSES
    fine = Panel.of(PanelParameters(length=float(LENGTH), step=0.5))
    assert reason_against((0.0, 300.0), (250.0, 500.0), (299.5, 600.0), panel=fine) is None
    assert reason_against((500.0, 600.0), (500.0, 600.0), (500.0, 600.0), panel=fine) is None
    assert reason_against((700.0, 900.0), (700.0, 900.0), (700.0, 900.0), panel=fine) is ReasonCode.TOO_FEW_PASSES


def test_one_wheelset_is_enough_where_its_profile_was_measured() -> None:
    whole = ((0.0, 600.0),) * 3
    assert reason_against(*whole, wheelsets=1) is ReasonCode.SINGLE_WHEELSET
    for serial, code in (("W0", None), ("W9", ReasonCode.SINGLE_WHEELSET)):
        known = replace(PANEL, measured={ProfileLife(serial): KNOWN})
        assert reason_against(*whole, wheelsets=1, panel=known) is code


def iterated(*, panel: Panel = PANEL, moved: float = 0.0, changed: float = 0.0, **solution: object) -> IterationResult:
    empty = replace(result(init(panel), std=False, parameters=PanelParameters()), **solution)  # type: ignore[arg-type]
    return IterationResult(panel, init(panel), empty, {}, {}, 8, moved, changed, 0.0)


def state(
    of_panel: Reason | None, outliers: Mapping[Journey, Reason], alignment: TrackAlignment | None = None
) -> tuple[Status, ReasonCode | None]:
    known = None if alignment is None else prior_on_grid(alignment, PANEL.grid, P.panel.cutoff_wavelength)
    grouped: dict[Journey, Sequence[Pass]] = {("V", 0): [a_pass(0)], ("V", 1): [a_pass(1)]}
    status, reason = _state_of(
        _Accepted(iterated(reason=of_panel, curves_fixed=False), outliers, {}), grouped, known, P
    )
    return status, code_of(reason)


def test_a_section_is_estimated_where_its_panel_or_what_was_known_is_and_a_journey_agrees() -> None:
    good, bad = None, Reason(ReasonCode.PASSES_ALIKE, "alike")
    one: dict[Journey, Reason] = {("V", 0): WHY}
    both: dict[Journey, Reason] = {**one, ("V", 1): WHY}
    nowhere = replace(prior(), alignment=np.full(LENGTH + 1, np.nan), alignment_std=np.full(LENGTH + 1, np.nan))
    yes, refused = (Status.ESTIMATED, None), (Status.UNESTIMATED, ReasonCode.PASSES_ALIKE)
    none = (Status.UNESTIMATED, ReasonCode.NO_JOURNEY_AGREES)
    assert [state(good, {}), state(good, one), state(good, both)] == [yes, yes, none]
    assert [state(bad, {}), state(bad, both), state(bad, {}, nowhere)] == [refused] * 3
    assert [state(bad, {}, prior()), state(bad, one, prior()), state(bad, both, prior())] == [yes, yes, none]


@pytest.mark.parametrize(("std", "reason"), [(0.39, None), (0.41, ReasonCode.PASSES_ALIKE)])
def test_curves_whose_slope_is_open_by_two_fifths_make_no_alignment(std: float, reason: ReasonCode | None) -> None:
    accepted = _Accepted(replace(iterated(reason=None, curves_fixed=False), slope=SlopeCorrection(1.5, std)), {}, {})
    grouped: dict[Journey, Sequence[Pass]] = {("V", 0): [a_pass(0)]}
    status, found = _state_of(accepted, grouped, None, P)
    assert (status, code_of(found)) == (Status.UNESTIMATED if reason else Status.ESTIMATED, reason)
    known = prior_on_grid(prior(), PANEL.grid, P.panel.cutoff_wavelength)
    assert _state_of(accepted, grouped, known, P) == (Status.ESTIMATED, None)


@pytest.mark.parametrize(("std", "refused"), [(0.099, False), (0.101, True)])
def test_a_stiffness_term_that_is_most_of_the_difference_and_not_known_makes_no_alignment(
    std: float,
    refused: bool,  # noqa: FBT001 - parametrised
) -> None:
    """The stiffness term is 0.8 of R here, and 0.08 of R may be unknown."""
    item = a_pass(0)
    item = replace(item, stiffness_term=0.8 * item.difference)
    placed = {("V", 0): PlacedJourney(Correction(), (grid_pass(item, PANEL.grid),))}
    found = replace(iterated(reason=None, curves_fixed=False), placed=placed, ratios={item.vehicle: Ratio(1.0, std)})
    grouped: dict[Journey, Sequence[Pass]] = {("V", 0): [item]}
    reason = _state_of(_Accepted(found, {}, {}), grouped, None, P)[1]
    assert (code_of(reason) is ReasonCode.STIFFNESS_OPEN) == refused
    fixed = replace(found, solution=replace(found.solution, curves_fixed=True))
    assert code_of(_state_of(_Accepted(fixed, {}, {}), grouped, None, P)[1]) is not ReasonCode.STIFFNESS_OPEN


def test_a_prior_without_error_beside_one_pass_without_spread_weighs_all_that_it_may(three: SectionEstimate) -> None:
    assert three.iterated is not None
    exact = prior()
    exact = replace(exact, alignment_std=np.where(np.isfinite(exact.alignment_std), 0.0, np.nan), scale_std=0.01)
    found = merged_alignment(
        "S", replace(three.iterated, placed=dict(list(three.iterated.placed.items())[:1])), exact, P
    )
    known = np.isfinite(exact.alignment_std)
    assert np.isfinite(found.alignment[known]).mean() > 0.5  # its edges go with the filter
    assert 0.0 < found.scale_std < 1.0


def test_a_slope_of_which_nothing_is_known_stays_a_finite_number(three: SectionEstimate) -> None:
    """On a known alignment passes that explain nothing still make an alignment; what is stored of it is finite."""
    assert three.iterated is not None
    lost = replace(three.iterated, slope=SlopeCorrection(1.0, float("inf"), 0.0))
    found = merged_alignment("S", lost, prior(), P)
    assert found.scale_std == pytest.approx(10.0, rel=1e-3)
    assert np.isfinite(found.alignment_std[np.isfinite(found.alignment)]).all()


def test_wheelsets_of_low_weight_are_named() -> None:
    lives = (ProfileLife("W1"), ProfileLife("W2"))
    assert _low_weight_reason(iterated(lives=lives)) is None
    for weights, text in (
        ({lives[1]: 0.125, lives[0]: 0.5}, "W1 (0.50 of a pass), W2 (0.12 of a pass)"),
        ({lives[1]: 0.25, ProfileLife("W3"): 0.1}, "W2 (0.25 of a pass)"),
    ):
        panel = replace(PANEL, weights=weights)
        reason = _low_weight_reason(iterated(panel=panel, lives=lives))
        assert code_of(reason) is ReasonCode.LOW_WEIGHT
        assert str(reason).endswith(f": {text}")
    elsewhere = replace(PANEL, weights={ProfileLife("W3"): 0.1})
    assert _low_weight_reason(iterated(panel=elsewhere, lives=lives)) is None


@pytest.mark.parametrize(
    ("moved", "changed", "gauge", "said"),
    [
        (0.099, 0.0099, None, None),
        (0.101, 0.0, None, "positions still moved by 0.10 m, the tolerance is 0.1 m"),
        (0.0, 0.0101, None, "stiffness ratios still changed by 0.010, the tolerance is 0.01"),
        (0.0, 0.0, 4e-4, "gauge still changed by 0.00040 m, the tolerance is 0.3 mm"),
    ],
)
def test_what_has_not_converged_is_said_with_its_tolerance(
    moved: float, changed: float, gauge: float | None, said: str | None
) -> None:
    of_gauge = () if gauge is None else (Convergence(Iterated.GAUGE, converged=False, rounds=2, change=gauge),)
    reason = _not_converged_reason(replace(iterated(moved=moved, changed=changed), gauge_convergence=of_gauge), P)
    assert code_of(reason) is (None if said is None else ReasonCode.NOT_CONVERGED)
    assert said is None or str(reason) == f"not converged after 8 rounds: {said}"
