"""Which journeys are outliers, how much a wheelset counts, how wide the std of an alignment is, when rounds end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.track.gridded_pass import place
from estimation.track.iteration import IterationParameters, IterationResult, _largest_move, _ratio_change
from estimation.track.panel.basis import Panel, PanelParameters, init
from estimation.track.panel.instrumental_slope import Ratio
from estimation.track.panel.solution import PriorAlignment, result
from estimation.track.passes import Pass, ProfileLife
from estimation.track.results import LongWaveAlignment, _gauge_std, _scale_std, _std, unestimated_report
from estimation.track.section import Residuals, _find_outliers, residuals
from estimation.track.settings import AlignmentSettings, SectionParameters
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction

P = SectionParameters()


def outliers(values: list[float], offsets: dict[int, float] | None = None) -> dict[int, ReasonCode]:
    """Return by index the journeys that are outliers."""
    journeys = {("V", k): value for k, value in enumerate(values)}
    corrections = {journey: Correction((offsets or {}).get(journey[1], 0.0)) for journey in journeys}
    return {journey[1]: reason.code for journey, reason in _find_outliers(journeys, corrections, P).items()}


DISAGREES = ReasonCode.JOURNEY_DISAGREES


def test_a_journey_may_be_off_by_twice_the_median_of_the_others() -> None:
    others = [0.3e-3, 0.4e-3, 0.5e-3]
    assert outliers([0.79e-3, *others]) == {}
    assert outliers([0.81e-3, *others]) == {0: DISAGREES}


def test_a_journey_may_be_off_by_four_tenths_of_a_millimetre() -> None:
    assert outliers([0.39e-3, 1e-5, 1e-5]) == {}
    assert outliers([0.41e-3, 1e-5, 1e-5]) == {0: DISAGREES}


def test_one_journey_alone_agrees_with_itself() -> None:
    assert outliers([9e-3]) == {}
    assert outliers([9e-3, float("nan")]) == {1: ReasonCode.JOURNEY_INDETERMINATE}


def test_a_journey_may_be_off_by_45_metres() -> None:
    for metres, code in ((44.9, None), (45.1, ReasonCode.OFFSET_TOO_LARGE), (-45.1, ReasonCode.OFFSET_TOO_LARGE)):
        assert outliers([1e-4, 1e-4], {0: metres}).get(0) is code


def life(number: int) -> ProfileLife:
    return ProfileLife(f"W{number}")


def weights(*values: float) -> dict[int, float]:
    found = Residuals({}, {life(k): value for k, value in enumerate(values)}).weights()
    return {int(one.wheelset[1:]): weight for one, weight in found.items()}


def test_a_wheelset_counts_less_by_the_fourth_power_beyond_one_and_a_half_times_the_median() -> None:
    median, usual = 0.2e-3, 0.3e-3
    # below a quarter of a pass: beyond usual times the fourth root of four
    assert weights(0.1e-3, median, 1.41 * usual) == {}
    found = weights(0.1e-3, median, 1.42 * usual)
    assert found == {2: pytest.approx(1.42**-4)}
    more = weights(0.1e-3, 0.1e-3, median, 1.01 * usual, 2.0 * usual)
    assert more == {3: pytest.approx(1.01**-4), 4: pytest.approx(2.0**-4)}
    assert set(weights(0.1e-3, 0.1e-3, median, 0.99 * usual, 2.0 * usual)) == {4}


def test_what_sensors_leave_open_is_usual() -> None:
    assert weights(0.01e-3, 0.01e-3, 1.41 * 0.12e-3) == {}
    assert weights(0.01e-3, 0.01e-3, 1.42 * 0.12e-3) == {2: pytest.approx(1.42**-4)}
    assert weights(float("nan"), float("nan")) == {}
    assert weights(float("nan"), 0.01e-3, 0.01e-3, 1.0e-3) == {3: pytest.approx((0.12 / 1.0) ** 4)}


def test_residuals_are_those_of_passes_with_a_curve_where_the_alignment_is_known() -> None:
    panel = Panel.of(PanelParameters(length=600.0))
    n, rng, R = panel.grid.points, np.random.default_rng(5), np.zeros(600)
    d = np.where(np.arange(n) % 7, 1e-3 * rng.standard_normal(n), np.nan)
    first, second = ("V", 0), ("V", 1)

    def made(number: int, length: int = 600, side: int = 1) -> Pass:
        y = 1e-3 * rng.standard_normal(length)
        return Pass(life(number), "V", 0, np.arange(float(length)), y, R[:length], side)

    # a wheelset without a curve, one too short for the filter, two passes of one that is known
    grouped = {first: [made(1), made(0)], second: [made(2, 40), made(0, side=-1)]}
    placed = place(grouped, {first: Correction(), second: Correction()}, {}, panel.grid)
    solution = replace(
        result(init(panel), std=False, parameters=PanelParameters()),
        lives=(life(0), life(2)), curves=np.zeros((1, 2, panel.unknowns)), alignment=d,
    )  # fmt: skip
    found = residuals(IterationResult(panel, init(panel), solution, placed, {}, 1, 0.0, 0.0, 0.0))
    kernel = panel.grid.kernel
    rest = {}
    for journey, one in placed.items():
        item = one.passes[1]
        smooth = np.convolve(item.displacement, kernel, "same")
        off = [item.displacement[k] - smooth[k] - d[p] for k, p in enumerate(item.points) if item.inside[k]]
        rest[journey] = [value for value in off if np.isfinite(value)]
        assert len(rest[journey]) > 200
    assert found.of_journeys == {one: pytest.approx(np.sqrt(np.mean(np.square(rest[one])))) for one in rest}
    assert set(found.of_lives) == {life(0), life(1), life(2)}
    assert found.of_lives[life(0)] == pytest.approx(np.sqrt(np.mean(np.square(rest[first] + rest[second]))))
    assert np.isnan(found.of_lives[life(1)])
    assert np.isnan(found.of_lives[life(2)])


def test_the_std_of_an_alignment_is_that_of_curves_passes_and_what_blocks_cannot_show() -> None:
    passes, of_curves = np.array([4.0, 4.0, 1.0, 0.0]), np.array([0.1e-3, np.nan, 0.2e-3, 0.1e-3])
    found = LongWaveAlignment(np.zeros(4), 0.3e-3, passes, np.zeros(4))
    prior = np.array([0.0, 0.0, 3.0, 2.0])  # in passes
    systematic = 0.02e-3**2 + 0.05e-3**2 + 0.07e-3**2
    std = _std(found, passes + prior, of_curves, np.full(4, systematic))
    assert std == pytest.approx(
        [
            np.sqrt(0.1e-3**2 + 0.3e-3**2 / 4.0 + systematic),
            np.sqrt(0.3e-3**2 / 4.0 + systematic),
            np.sqrt((0.25 * 0.2e-3) ** 2 + 0.3e-3**2 / 4.0 + 0.25 * systematic),
            np.sqrt(0.3e-3**2 / 2.0),
        ]
    )


def test_the_scale_is_known_less_where_the_gauge_had_to_be_found() -> None:
    assert _scale_std(None, P) == pytest.approx(0.009)
    assert _scale_std(np.zeros(3), P) == pytest.approx(np.sqrt(0.009**2 + 0.035**2))


def test_the_shipped_figures_of_an_alignment() -> None:
    assert (P.systematic, P.systematic_per_gauge, P.cutoff_wavelength) == (0.02e-3, (0.025, 0.055), 120.0)
    iteration = IterationParameters()
    assert (iteration.rounds, iteration.position_tolerance, iteration.ratio_tolerance) == (24, 0.1, 0.01)
    assert (iteration.gauge_tolerance, iteration.pass_std, iteration.most_weight) == (0.3e-3, 0.15e-3, 1000.0)
    assert (iteration.gauge_trial, iteration.gauge_searches, iteration.wheel_rounds) == (2, 2, 2)
    assert iteration.most_wheel_rounds == 8
    assert iteration.gauge_explains == 0.1
    settings = AlignmentSettings()
    assert (settings.most_windows, settings.most_wheelsets, settings.pass_step) == (480, 48, 0.2)
    assert settings.measured_km == 1000.0


def test_the_largest_change_of_a_ratio_counts_and_a_new_one_was_one() -> None:
    before = {"A": Ratio(1.1, 0.0), "B": Ratio(0.9, 0.0)}
    assert _ratio_change(before, {"A": Ratio(1.12, 0.0), "B": Ratio(0.85, 0.0)}) == pytest.approx(0.05)
    assert _ratio_change(before, {"C": Ratio(1.2, 0.0)}) == pytest.approx(0.2)
    assert _ratio_change(before, {}) == 0.0


def test_the_largest_move_is_at_the_ends_of_a_journey() -> None:
    at = np.array([100.0, 600.0])
    item = Pass(life(1), "V", 0, at, np.zeros(2), np.zeros(2))
    early = replace(item, at=at - 50.0)
    journey = ("V", 0)
    grouped = {journey: [item, early]}
    for after, expected in (
        (Correction(1.5), 1.5),
        (Correction(-1.5), 1.5),
        (Correction(0.0, 0.01, 50.0), 5.5),
        (Correction(0.0, 0.01, 600.0), 5.5),
    ):
        assert _largest_move(grouped, {journey: Correction()}, {journey: after}) == pytest.approx(expected)


def test_a_report_of_nothing_claims_nothing() -> None:
    report = unestimated_report(Reason(ReasonCode.NO_PASS, "no pass"), ("survey version 1",))
    assert report.status is Status.UNESTIMATED
    assert not report.converged
    assert (report.rounds, report.passes, report.wheelsets, report.covered) == (0, 0, 0, 0.0)
    stored = report.as_json()
    assert (stored["reason"], stored["reason_code"]) == ("no pass", "no_pass")
    assert stored["alignment_std_m"] is None
    assert stored["evidence"] == ["survey version 1"]


def uncertain_gauge(noise: float, ratio: float, *, found: float | None = None, known: bool = False) -> float:
    """Return the std of the gauge of passes that disagree by ``noise`` and whose R differs by ``ratio``."""
    panel = Panel.of(PanelParameters(length=100.0, basis_count=5, groups=2, block=50.0))
    n = panel.grid.points
    sums = np.full((2, n), 2.0)  # of two passes whose squares are 1 each
    sums[0] *= np.sqrt(1.0 - 0.5 * ratio**2)
    state = replace(init(panel), passes=np.full(n, 2.0), difference=sums)
    iterated = IterationResult(
        panel, state, result(state, std=False, parameters=PanelParameters()), {}, {}, 1, 0.0, 0.0, noise
    )
    zero = np.zeros(n)
    prior = PriorAlignment(zero, zero + np.inf, zero, zero, zero + 0.4e-3, gauge_known=known)
    gauge = None if found is None else np.where(np.arange(n) % 2, found, -found)
    return float(_gauge_std(iterated, prior, gauge, SectionParameters())[0])


def test_what_passes_disagree_by_beyond_their_sensors_is_the_gauge_s() -> None:
    assert uncertain_gauge(0.069e-3, 1.0) == 0.0
    assert uncertain_gauge(0.2e-3, 1.0) == pytest.approx(np.sqrt(0.2**2 - 0.07**2) * 1e-3 / 0.1)
    assert uncertain_gauge(0.2e-3, 0.6) == uncertain_gauge(0.2e-3, 1.0)
    assert uncertain_gauge(0.2e-3, 0.25) == pytest.approx(2.0 * uncertain_gauge(0.2e-3, 1.0), rel=0.01)
    assert uncertain_gauge(0.069e-3, 1.0, found=1e-3) == pytest.approx(1e-3, rel=0.01)
    assert uncertain_gauge(0.2e-3, 1.0, known=True) == 0.4e-3
