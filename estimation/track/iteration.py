"""Alignment, curves, positions, stiffness ratios and gauge of a section, each from the others until none moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.gauge.search import GaugePrior, SearchParameters, gauge_step, search_gauge, with_gauge_effect
from estimation.track.gauge.wheel_functions import (
    contact_samples,
    fit_wheels,
    gauge_factor,
    gauge_shift_of,
    initial_gauge_effect,
    remove_common_shift,
    total_gauge_shifts,
)
from estimation.track.gridded_pass import GriddedPass, Placed, place, with_ratios
from estimation.track.panel.basis import MeasuredCurve, Panel, PanelState, init, update
from estimation.track.panel.instrumental_slope import (
    Ratio,
    SlopeCorrection,
    common_slope,
    corrected,
    ratio_values,
    refine_ratios,
    slope_correction,
    with_instrument,
    with_ratio_std,
)
from estimation.track.panel.solution import (
    PanelSolution,
    PriorAlignment,
    add_prior,
    fleet_step,
    residual_of_passes,
    result,
)
from estimation.track.parameters import TRACK
from estimation.track.passes import Journey, Pass, PositionParameters
from estimation.track.positions import compose, correlate_positions, refine, register
from estimation.track.survey_positions import positions_on_survey
from estimation.values.arrays import FloatArray
from estimation.values.track import Convergence, Correction, Iterated

Grouped = Mapping[Journey, Sequence[Pass]]


@dataclass(frozen=True, slots=True)
class IterationParameters:
    """When the rounds end."""

    rounds: int = 24  # of positions and panel at most
    position_tolerance: float = 0.1  # m: positions that move less have converged
    survey_tolerance: float = 0.3  # m, on average, from positions by the regression of R on a survey
    survey_rounds: int = 4  # of positions on a survey and stiffness ratios at most
    survey_moved: float = 0.05  # m: positions on a survey that move less are found
    curves_flatten: float = 6.0  # times as much as an equal share of a survey: what curves leave of y moves journeys
    ratio_tolerance: float = 0.01
    gauge_tolerance: float = 0.3e-3  # m, rms: a gauge that changes less has converged
    pass_std: float = 0.15e-3  # m of y - d - h(R) of a pass, before it is known
    most_weight: float = 1000.0  # of a prior alignment, in passes
    gauge: GaugePrior = field(default_factory=GaugePrior)
    search: SearchParameters = field(default_factory=SearchParameters)
    gauge_trial: int = 2  # rounds after which the gauge must have explained something
    gauge_searches: int = 2  # rounds of wheels and search after that
    wheel_rounds: int = 2  # of wheels where the gauge is known, at least
    most_wheel_rounds: int = 8
    gauge_explains: float = 0.1  # of the residual's rms, for the gauge to be taken as varying


@dataclass(frozen=True, slots=True)
class IterationResult:
    """Where the rounds ended."""

    panel: Panel  # with the gauge, where it varies
    state: PanelState  # without the prior alignment
    solution: PanelSolution
    placed: Placed  # passes by journey, corrected, with the stiffness ratios of their vehicles
    ratios: dict[str, Ratio]  # by vehicle
    rounds: int
    moved: float  # m, by which the last round moved a position at most
    changed: float  # by which the last round changed a stiffness ratio at most
    noise: float  # m, rms of y - d - h(R) over the passes
    gauge_convergence: tuple[Convergence, ...] = ()
    slope: SlopeCorrection | None = None  # of the curves, where the gauge search or ``with_slope`` has found it
    first_noise: float | None = None  # m, ``noise`` of the panel without the gauge
    placed_on_survey: bool = False  # positions are by the regression of R on a survey

    @property
    def noise_without_gauge(self) -> float:
        """Rms of y - d - h(R) over the passes, m, where no gauge is modelled."""
        return self.noise if self.first_noise is None else self.first_noise

    @property
    def passes(self) -> list[GriddedPass]:
        """Passes of all journeys in order."""
        return [item for one in self.placed.values() for item in one.passes]

    @property
    def corrections(self) -> dict[Journey, Correction]:
        """Corrections of the positions by journey."""
        return {journey: one.correction for journey, one in self.placed.items()}

    @property
    def measured_curves(self) -> list[MeasuredCurve]:
        """Measured curves of the wheelsets that have passed."""
        return [self.panel.measured[life] for life in self.solution.lives if life in self.panel.measured]

    def at_rest(self, parameters: IterationParameters) -> bool:
        """Return whether neither positions nor stiffness ratios move any more."""
        return self.moved < parameters.position_tolerance and self.changed < parameters.ratio_tolerance

    def convergence(self, parameters: IterationParameters) -> tuple[Convergence, ...]:
        """Return how positions, stiffness ratios and gauge ended."""
        moved, changed = self.moved < parameters.position_tolerance, self.changed < parameters.ratio_tolerance
        positions = Convergence(Iterated.POSITIONS, moved, self.rounds, self.moved)
        ratios = Convergence(Iterated.STIFFNESS_RATIOS, changed, self.rounds, self.changed)
        return positions, ratios, *self.gauge_convergence


@dataclass(frozen=True, slots=True)
class Setting:
    """What stays the same over the rounds."""

    grouped: Grouped
    prior: PriorAlignment | None
    anchored: bool
    parameters: IterationParameters
    placed_on_survey: bool = False  # positions are known, and stay


def iterate(
    grouped: Grouped,
    prior: PriorAlignment | None,
    panel: Panel,
    positions: PositionParameters,
    parameters: IterationParameters,
) -> IterationResult:
    """Return where alignment, curves, positions and ratios agree; with the gauge where it is known or shows."""
    anchored = prior is not None and prior.has_alignment
    setting = Setting(grouped, prior, anchored, parameters)
    reference = prior.alignment if prior is not None and anchored else None
    corrections = correlate_positions(grouped, panel.grid, positions, reference)
    first = first_rounds(setting, panel, corrections)
    setting = replace(setting, placed_on_survey=first.placed_on_survey)
    constant = prior is not None and prior.gauge_known and not prior.gauge.any()
    if constant or not (first.state.count >= TRACK.fewest_place_passes).any():
        return first
    if (
        prior is None or not prior.gauge_known
    ):  # without a gauge that is found for certain its effect is in the intervals
        found = _with_searched_gauge(setting, first, parameters.gauge_searches)
        return found if all(one.converged for one in found.gauge_convergence if one.of is Iterated.GAUGE) else first
    corrections, ratios = first.corrections, first.ratios
    if not anchored:
        corrections, ratios = _register_by_gauge(setting, first, prior.gauge, positions)
        setting = replace(setting, anchored=True)
    found = _rounds(setting, first.panel.with_gauge(prior.gauge, {}), corrections, ratios)
    for number in range(1, parameters.most_wheel_rounds + 1):
        found = _solved(setting, _repositioned(setting, found), _with_wheels(found))
        if number >= parameters.wheel_rounds and found.at_rest(parameters):
            break
    return replace(_finished(setting, found), first_noise=first.noise)


def first_rounds(
    setting: Setting, panel: Panel, corrections: Mapping[Journey, Correction], *, std: bool = True
) -> IterationResult:
    """Return where the rounds without a gauge end; on a survey at positions by the regression of R."""
    # That search begins where the panel ends, which is within a metre or two; stiffness ratios that go with the panel's
    # positions are another error of R, so both are found in turn. A gauge that varies is noise in that regression, and
    # not in the panel. There the panel's positions are kept, unless the noise of R has moved them all.
    prior = setting.prior
    if prior is None or not setting.anchored or not prior.surveyed:
        return _rounds(setting, panel, corrections, {}, std=std)
    found = _rounds(setting, panel, corrections, {}, std=False)
    varies = prior.gauge_known and bool(prior.gauge.any())
    fixed, grouped = replace(setting, placed_on_survey=True), setting.grouped
    tolerance = setting.parameters.survey_tolerance
    for _ in range(setting.parameters.survey_rounds):
        on_survey = positions_on_survey(found.placed, prior, panel.grid)
        noisy = varies and not found.placed_on_survey
        if on_survey is None or (noisy and _mean_move(grouped, found.corrections, on_survey) < tolerance):
            break
        moved = _largest_move(grouped, found.corrections, on_survey)
        found = replace(_rounds(fixed, panel, on_survey, found.ratios, std=False), placed_on_survey=True)
        if moved < setting.parameters.survey_moved:
            break
    if found.placed_on_survey:
        found = _moved_as_a_whole(fixed, found, prior)
    return _finished(setting, found) if std else found


def _moved_as_a_whole(fixed: Setting, found: IterationResult, survey: PriorAlignment) -> IterationResult:
    """Return the rounds with all journeys moved alike, between where R and where y - h(R) puts them on the survey."""
    # The errors of a survey flatten the regression of R on y - d, and what is left of R moves all journeys alike. Those
    # of R do the same the other way round, and move them the other way: each counts by the share of the other's errors.
    step = fleet_step(found.state, found.solution, survey)
    state, d = found.state, np.nan_to_num(found.solution.alignment)
    square = float(state.square.sum() - 2.0 * d @ state.displacement + d**2 @ state.passes)
    error = float(np.median(survey.std[np.isfinite(survey.std)])) ** 2
    flattened = error / (error + max(square, 0.0) / max(float(state.passes.sum()), 1.0))
    left = 1.0 - _explained(fixed, found)
    share = flattened / (flattened + fixed.parameters.curves_flatten * left)
    if step is None or abs(share * step) < fixed.parameters.survey_moved:
        return found
    moved = {journey: replace(one, offset=one.offset + share * step) for journey, one in found.corrections.items()}
    return replace(_rounds(fixed, found.panel, moved, found.ratios, std=False), placed_on_survey=True)


def with_slope(found: IterationResult, prior: PriorAlignment | None, most_weight: float) -> IterationResult:
    """Return ``found`` with the curves as steep as they are without the errors of R."""
    if found.solution.curves_fixed:
        return found
    state = found.state if prior is None else add_prior(found.state, prior, found.noise, most_weight)
    slope = found.slope or slope_correction(state, found.solution)
    if prior is not None and prior.gauge_known and found.panel.gauge is None:  # a gauge is no noise
        slope = with_instrument(slope, found.passes, found.solution, found.panel)
    if not np.isfinite(slope.std):
        return replace(found, slope=slope)
    return replace(found, solution=corrected(state, found.solution, slope.factor), slope=slope)


def _rounds(
    setting: Setting,
    panel: Panel,
    corrections: Mapping[Journey, Correction],
    ratios: dict[str, Ratio],
    *,
    std: bool = True,
) -> IterationResult:
    p, empty = setting.parameters, init(panel)
    placed = place(setting.grouped, corrections, ratio_values(ratios), panel.grid)
    nothing = result(empty, std=False, parameters=panel.parameters)
    found = IterationResult(panel, empty, nothing, placed, ratios, 0, float("inf"), float("inf"), p.pass_std)
    while not (found.at_rest(p) or found.rounds >= p.rounds - 1):
        found = _repositioned(setting, _solved(setting, found, panel))
    found = _solved(setting, found, panel, std=std)
    return _with_ratio_std(setting, found) if std else found


def _explained(setting: Setting, found: IterationResult) -> float:
    return slope_correction(_state_with_prior(found.state, setting, found.noise), found.solution).explained


def _state_with_prior(state: PanelState, setting: Setting, noise: float) -> PanelState:
    return state if setting.prior is None else add_prior(state, setting.prior, noise, setting.parameters.most_weight)


def _refined_corrections(
    setting: Setting, placed: Placed, ratios: Mapping[str, Ratio], state: PanelState, solution: PanelSolution
) -> dict[Journey, Correction]:
    if setting.placed_on_survey:
        return {journey: one.correction for journey, one in placed.items()}
    adjusted = with_ratios(placed, ratio_values(ratios), state.panel.grid)
    better = refine(adjusted, solution, state.panel, anchored=setting.anchored)
    if not setting.anchored or setting.prior is None:
        return better
    step = fleet_step(state, solution, setting.prior)
    if step is None:
        return better
    mean = float(np.mean([better[journey].offset - placed[journey].correction.offset for journey in better]))
    return {journey: replace(one, offset=one.offset - mean + step) for journey, one in better.items()}


def _with_searched_gauge(setting: Setting, first: IterationResult, searches: int) -> IterationResult:
    """Return the solution with a gauge deviation of the place, where that explains the residuals; else as it was."""
    p = setting.parameters
    effect = initial_gauge_effect(first.passes, first.solution, first.panel, p.gauge)
    if effect is None:
        return first
    panel = first.panel.with_gauge(np.zeros(first.panel.grid.points))
    found = replace(first, panel=panel, solution=with_gauge_effect(first.solution, effect, panel))
    for number in range(p.gauge_trial):
        found = _repositioned(setting, found) if number else found
        prior = replace(p.gauge, noise=max(min(p.gauge.noise, found.noise), 0.3 * p.gauge.noise))
        gauge, converged, steps = gauge_step(found.passes, found.solution, found.panel, prior)
        solve = Convergence(Iterated.GAUGE_STEP, converged, steps, float("nan"))
        found = _solved(setting, found, found.panel.with_gauge(gauge))
        found = replace(found, gauge_convergence=(*found.gauge_convergence, solve))
    if found.noise > (1.0 - p.gauge_explains) * first.noise:
        return first
    change = np.inf
    for _ in range(searches):
        before = found.panel.gauge
        found = _repositioned(setting, found)
        shifts = total_gauge_shifts(found.solution, found.panel)
        gauge = search_gauge(found.passes, found.solution, found.panel, shifts, p.search)
        found = _solved(setting, found, found.panel.with_gauge(gauge))
        found = _solved(setting, _repositioned(setting, found), _with_wheels(found, sized=True))
        after = found.panel.gauge
        assert before is not None
        assert after is not None
        change = float(np.sqrt(np.mean((after - before) ** 2)))
    search = Convergence(Iterated.GAUGE, change < p.gauge_tolerance, searches, change)
    found = _finished(setting, replace(found, gauge_convergence=(*found.gauge_convergence, search)))
    # a gauge that is searched fits noise: curves are to be as steep as without it
    slope = slope_correction(_state_with_prior(first.state, setting, first.noise), first.solution)
    share = common_slope(found.solution, first.solution)
    slope = replace(slope, factor=slope.factor * share, std=slope.std * share)
    return replace(found, slope=slope, first_noise=first.noise)


def _with_wheels(found: IterationResult, *, sized: bool = False) -> Panel:
    assert found.panel.gauge is not None
    samples = contact_samples(found.passes, found.solution, found.panel)
    factor = gauge_factor(samples) if sized else 1.0
    shifts = {name: gauge_shift_of(fit_wheels(one.inliers(), factor)) for name, one in samples.items()}
    return found.panel.with_gauge(factor * found.panel.gauge, remove_common_shift(shifts))


def _solved(setting: Setting, found: IterationResult, panel: Panel, *, std: bool = False) -> IterationResult:
    state = update(init(panel), found.passes)
    solution = result(_state_with_prior(state, setting, found.noise), std=std, parameters=panel.parameters)
    noise = max(residual_of_passes(state, solution), 0.1 * setting.parameters.pass_std)
    return replace(found, panel=panel, state=state, solution=solution, noise=noise, rounds=found.rounds + 1)


def _repositioned(setting: Setting, found: IterationResult) -> IterationResult:
    ratios = refine_ratios(found.ratios, found.passes, found.solution, found.panel, _explained(setting, found))
    state = replace(found.state, panel=found.panel)
    corrections = _refined_corrections(setting, found.placed, ratios, state, found.solution)
    return replace(
        found,
        placed=place(setting.grouped, corrections, ratio_values(ratios), found.panel.grid, found.placed),
        ratios=ratios,
        moved=_largest_move(setting.grouped, found.corrections, corrections),
        changed=_ratio_change(found.ratios, ratios),
    )


def _finished(setting: Setting, found: IterationResult) -> IterationResult:
    whole = _solved(setting, found, found.panel, std=True)
    return replace(_with_ratio_std(setting, whole), rounds=found.rounds)


def _with_ratio_std(setting: Setting, found: IterationResult) -> IterationResult:
    ratios = with_ratio_std(found.ratios, found.passes, found.solution, found.panel, _explained(setting, found))
    return replace(found, ratios=ratios)


def _register_by_gauge(
    setting: Setting, first: IterationResult, gauge: FloatArray, positions: PositionParameters
) -> tuple[dict[Journey, Correction], dict[str, Ratio]]:
    trial = _with_searched_gauge(setting, first, 1)
    if trial.panel.gauge is None:
        return trial.corrections, trial.ratios  # the gauge hardly shows: then it hardly matters where it is
    both = [register(sign * trial.panel.gauge, gauge, trial.panel.grid, positions) for sign in (1.0, -1.0)]
    correction = max(both, key=lambda found: found[1])[0]
    return {journey: compose(one, correction) for journey, one in trial.corrections.items()}, trial.ratios


def _ratio_change(before: Mapping[str, Ratio], after: Mapping[str, Ratio]) -> float:
    return max((abs(one.value - before.get(vehicle, Ratio()).value) for vehicle, one in after.items()), default=0.0)


def _mean_move(grouped: Grouped, before: Mapping[Journey, Correction], after: Mapping[Journey, Correction]) -> float:
    moves = []
    for journey, members in grouped.items():
        middle = np.array([0.5 * (item.at[0] + item.at[-1]) for item in members])
        moves.append(float(np.mean(after[journey].at(middle) - before[journey].at(middle))))
    return abs(float(np.mean(moves)))


def _largest_move(grouped: Grouped, before: Mapping[Journey, Correction], after: Mapping[Journey, Correction]) -> float:
    largest = 0.0
    for journey, members in grouped.items():
        ends = np.array([min(item.at[0] for item in members), max(item.at[-1] for item in members)])
        largest = max(largest, float(np.abs(before[journey].at(ends) - after[journey].at(ends)).max()))
    return largest
