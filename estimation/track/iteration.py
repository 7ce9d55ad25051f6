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
    """State at the end of the rounds."""

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
        return [item for journey in self.placed.values() for item in journey.passes]

    @property
    def corrections(self) -> dict[Journey, Correction]:
        """Corrections of the positions by journey."""
        return {journey: placed.correction for journey, placed in self.placed.items()}

    @property
    def measured_curves(self) -> list[MeasuredCurve]:
        """Measured curves of the wheelsets that have passed."""
        return [self.panel.measured[life] for life in self.solution.lives if life in self.panel.measured]

    def at_rest(self, parameters: IterationParameters) -> bool:
        """Return whether positions and stiffness ratios have converged."""
        return self.moved < parameters.position_tolerance and self.changed < parameters.ratio_tolerance

    def convergence(self, parameters: IterationParameters) -> tuple[Convergence, ...]:
        """Return how positions, stiffness ratios and gauge ended."""
        moved, changed = self.moved < parameters.position_tolerance, self.changed < parameters.ratio_tolerance
        positions = Convergence(Iterated.POSITIONS, moved, self.rounds, self.moved)
        ratios = Convergence(Iterated.STIFFNESS_RATIOS, changed, self.rounds, self.changed)
        return positions, ratios, *self.gauge_convergence


@dataclass(frozen=True, slots=True)
class Setting:
    """Inputs that stay the same over the rounds."""

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
    # without a gauge that is found for certain its effect is in the intervals
    if prior is None or not prior.gauge_known:
        iterated = _with_searched_gauge(setting, first, parameters.gauge_searches)
        searches = (step for step in iterated.gauge_convergence if step.of is Iterated.GAUGE)
        return iterated if all(step.converged for step in searches) else first
    corrections, ratios = first.corrections, first.ratios
    if not anchored:
        corrections, ratios = _register_by_gauge(setting, first, prior.gauge, positions)
        setting = replace(setting, anchored=True)
    iterated = _rounds(setting, first.panel.with_gauge(prior.gauge, {}), corrections, ratios)
    for number in range(1, parameters.most_wheel_rounds + 1):
        iterated = _solved(setting, _repositioned(setting, iterated), _with_wheels(iterated))
        if number >= parameters.wheel_rounds and iterated.at_rest(parameters):
            break
    return replace(_finished(setting, iterated), first_noise=first.noise)


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
    iterated = _rounds(setting, panel, corrections, {}, std=False)
    varies = prior.gauge_known and bool(prior.gauge.any())
    fixed, grouped = replace(setting, placed_on_survey=True), setting.grouped
    tolerance = setting.parameters.survey_tolerance
    for _ in range(setting.parameters.survey_rounds):
        on_survey = positions_on_survey(iterated.placed, prior, panel.grid)
        noisy = varies and not iterated.placed_on_survey
        if on_survey is None or (noisy and _mean_move(grouped, iterated.corrections, on_survey) < tolerance):
            break
        moved = _largest_move(grouped, iterated.corrections, on_survey)
        iterated = replace(_rounds(fixed, panel, on_survey, iterated.ratios, std=False), placed_on_survey=True)
        if moved < setting.parameters.survey_moved:
            break
    if iterated.placed_on_survey:
        iterated = _moved_as_a_whole(fixed, iterated, prior)
    return _finished(setting, iterated) if std else iterated


def _moved_as_a_whole(fixed: Setting, iterated: IterationResult, survey: PriorAlignment) -> IterationResult:
    """Return the rounds with all journeys moved alike, between where R and where y - h(R) puts them on the survey."""
    # The errors of a survey flatten the regression of R on y - d, and what is left of R moves all journeys alike. Those
    # of R do the same the other way round, and move them the other way: each counts by the share of the other's errors.
    step = fleet_step(iterated.state, iterated.solution, survey)
    state, d = iterated.state, np.nan_to_num(iterated.solution.alignment)
    square = float(state.square.sum() - 2.0 * d @ state.displacement + d**2 @ state.passes)
    error = float(np.median(survey.std[np.isfinite(survey.std)])) ** 2
    flattened = error / (error + max(square, 0.0) / max(float(state.passes.sum()), 1.0))
    left = 1.0 - _explained(fixed, iterated)
    share = flattened / (flattened + fixed.parameters.curves_flatten * left)
    if step is None or abs(share * step) < fixed.parameters.survey_moved:
        return iterated
    moved = {journey: replace(old, offset=old.offset + share * step) for journey, old in iterated.corrections.items()}
    return replace(_rounds(fixed, iterated.panel, moved, iterated.ratios, std=False), placed_on_survey=True)


def with_slope(iterated: IterationResult, prior: PriorAlignment | None, most_weight: float) -> IterationResult:
    """Return ``iterated`` with the curves as steep as they are without the errors of R."""
    if iterated.solution.curves_fixed:
        return iterated
    state = iterated.state if prior is None else add_prior(iterated.state, prior, iterated.noise, most_weight)
    slope = iterated.slope or slope_correction(state, iterated.solution)
    if prior is not None and prior.gauge_known and iterated.panel.gauge is None:  # a gauge is no noise
        slope = with_instrument(slope, iterated.passes, iterated.solution, iterated.panel)
    if not np.isfinite(slope.std):
        return replace(iterated, slope=slope)
    return replace(iterated, solution=corrected(state, iterated.solution, slope.factor), slope=slope)


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
    iterated = IterationResult(panel, empty, nothing, placed, ratios, 0, float("inf"), float("inf"), p.pass_std)
    while not (iterated.at_rest(p) or iterated.rounds >= p.rounds - 1):
        iterated = _repositioned(setting, _solved(setting, iterated, panel))
    iterated = _solved(setting, iterated, panel, std=std)
    return _with_ratio_std(setting, iterated) if std else iterated


def _explained(setting: Setting, iterated: IterationResult) -> float:
    return slope_correction(_state_with_prior(iterated.state, setting, iterated.noise), iterated.solution).explained


def _state_with_prior(state: PanelState, setting: Setting, noise: float) -> PanelState:
    return state if setting.prior is None else add_prior(state, setting.prior, noise, setting.parameters.most_weight)


def _refined_corrections(
    setting: Setting, placed: Placed, ratios: Mapping[str, Ratio], state: PanelState, solution: PanelSolution
) -> dict[Journey, Correction]:
    if setting.placed_on_survey:
        return {journey: at.correction for journey, at in placed.items()}
    adjusted = with_ratios(placed, ratio_values(ratios), state.panel.grid)
    better = refine(adjusted, solution, state.panel, anchored=setting.anchored)
    if not setting.anchored or setting.prior is None:
        return better
    step = fleet_step(state, solution, setting.prior)
    if step is None:
        return better
    mean = float(np.mean([better[journey].offset - placed[journey].correction.offset for journey in better]))
    return {journey: replace(old, offset=old.offset - mean + step) for journey, old in better.items()}


def _with_searched_gauge(setting: Setting, first: IterationResult, searches: int) -> IterationResult:
    """Return the solution with a gauge deviation by place if that explains the residuals; else ``first``."""
    p = setting.parameters
    effect = initial_gauge_effect(first.passes, first.solution, first.panel, p.gauge)
    if effect is None:
        return first
    panel = first.panel.with_gauge(np.zeros(first.panel.grid.points))
    iterated = replace(first, panel=panel, solution=with_gauge_effect(first.solution, effect, panel))
    for number in range(p.gauge_trial):
        iterated = _repositioned(setting, iterated) if number else iterated
        prior = replace(p.gauge, noise=max(min(p.gauge.noise, iterated.noise), 0.3 * p.gauge.noise))
        gauge, converged, steps = gauge_step(iterated.passes, iterated.solution, iterated.panel, prior)
        solve = Convergence(Iterated.GAUGE_STEP, converged, steps, float("nan"))
        iterated = _solved(setting, iterated, iterated.panel.with_gauge(gauge))
        iterated = replace(iterated, gauge_convergence=(*iterated.gauge_convergence, solve))
    if iterated.noise > (1.0 - p.gauge_explains) * first.noise:
        return first
    change = np.inf
    for _ in range(searches):
        before = iterated.panel.gauge
        iterated = _repositioned(setting, iterated)
        shifts = total_gauge_shifts(iterated.solution, iterated.panel)
        gauge = search_gauge(iterated.passes, iterated.solution, iterated.panel, shifts, p.search)
        iterated = _solved(setting, iterated, iterated.panel.with_gauge(gauge))
        iterated = _solved(setting, _repositioned(setting, iterated), _with_wheels(iterated, sized=True))
        after = iterated.panel.gauge
        assert before is not None
        assert after is not None
        change = float(np.sqrt(np.mean((after - before) ** 2)))
    search = Convergence(Iterated.GAUGE, change < p.gauge_tolerance, searches, change)
    iterated = _finished(setting, replace(iterated, gauge_convergence=(*iterated.gauge_convergence, search)))
    # a gauge that is searched fits noise: curves are to be as steep as without it
    slope = slope_correction(_state_with_prior(first.state, setting, first.noise), first.solution)
    share = common_slope(iterated.solution, first.solution)
    slope = replace(slope, factor=slope.factor * share, std=slope.std * share)
    return replace(iterated, slope=slope, first_noise=first.noise)


def _with_wheels(iterated: IterationResult, *, sized: bool = False) -> Panel:
    assert iterated.panel.gauge is not None
    samples = contact_samples(iterated.passes, iterated.solution, iterated.panel)
    factor = gauge_factor(samples) if sized else 1.0
    shifts = {life: gauge_shift_of(fit_wheels(sample.inliers(), factor)) for life, sample in samples.items()}
    return iterated.panel.with_gauge(factor * iterated.panel.gauge, remove_common_shift(shifts))


def _solved(setting: Setting, iterated: IterationResult, panel: Panel, *, std: bool = False) -> IterationResult:
    state = update(init(panel), iterated.passes)
    solution = result(_state_with_prior(state, setting, iterated.noise), std=std, parameters=panel.parameters)
    noise = max(residual_of_passes(state, solution), 0.1 * setting.parameters.pass_std)
    return replace(iterated, panel=panel, state=state, solution=solution, noise=noise, rounds=iterated.rounds + 1)


def _repositioned(setting: Setting, iterated: IterationResult) -> IterationResult:
    panel, explained = iterated.panel, _explained(setting, iterated)
    ratios = refine_ratios(iterated.ratios, iterated.passes, iterated.solution, panel, explained)
    state = replace(iterated.state, panel=panel)
    corrections = _refined_corrections(setting, iterated.placed, ratios, state, iterated.solution)
    return replace(
        iterated,
        placed=place(setting.grouped, corrections, ratio_values(ratios), panel.grid, iterated.placed),
        ratios=ratios,
        moved=_largest_move(setting.grouped, iterated.corrections, corrections),
        changed=_ratio_change(iterated.ratios, ratios),
    )


def _finished(setting: Setting, iterated: IterationResult) -> IterationResult:
    whole = _solved(setting, iterated, iterated.panel, std=True)
    return replace(_with_ratio_std(setting, whole), rounds=iterated.rounds)


def _with_ratio_std(setting: Setting, iterated: IterationResult) -> IterationResult:
    panel, explained = iterated.panel, _explained(setting, iterated)
    ratios = with_ratio_std(iterated.ratios, iterated.passes, iterated.solution, panel, explained)
    return replace(iterated, ratios=ratios)


def _register_by_gauge(
    setting: Setting, first: IterationResult, gauge: FloatArray, positions: PositionParameters
) -> tuple[dict[Journey, Correction], dict[str, Ratio]]:
    trial = _with_searched_gauge(setting, first, 1)
    if trial.panel.gauge is None:
        return trial.corrections, trial.ratios  # the gauge hardly shows: then it hardly matters where it is
    both = [register(sign * trial.panel.gauge, gauge, trial.panel.grid, positions) for sign in (1.0, -1.0)]
    correction = max(both, key=lambda correction_and_fit: correction_and_fit[1])[0]
    return {journey: compose(own, correction) for journey, own in trial.corrections.items()}, trial.ratios


def _ratio_change(before: Mapping[str, Ratio], after: Mapping[str, Ratio]) -> float:
    return max((abs(ratio.value - before.get(vehicle, Ratio()).value) for vehicle, ratio in after.items()), default=0.0)


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
