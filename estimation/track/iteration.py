"""Alignment, curves, positions, stiffness ratios and gauge of a section, each from the others until none moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.gauge.initial_shape import initial_gauge_effect
from estimation.track.gauge.least_squares_step import FEWEST_PASSES, GaugePrior, gauge_step, with_gauge_effect
from estimation.track.gauge.search import SearchParameters, search_gauge
from estimation.track.gauge.wheel_functions import (
    contact_samples,
    fit,
    gauge_factor,
    gauge_shift_of,
    remove_common_shift,
    total_gauge_shifts,
)
from estimation.track.journeys import Journey, PositionParameters, apply_correction
from estimation.track.panel.basis import PanelParameters
from estimation.track.panel.normal_equations import PanelState, init, update
from estimation.track.panel.prior_alignment import PriorAlignment, add_prior, fleet_step
from estimation.track.panel.solution import PanelSolution, residual_of_passes, result
from estimation.track.panel.stiffness_ratio import Ratio, apply_ratios, certain, refine_ratios
from estimation.track.passes import Pass
from estimation.track.positions import compared, compose, correlate_positions, refine
from estimation.values.arrays import FloatArray
from estimation.values.track import Correction

Grouped = Mapping[Journey, Sequence[Pass]]


@dataclass(frozen=True, slots=True)
class IterationParameters:
    """When the rounds end."""

    rounds: int = 8  # of positions and panel at most
    position_tolerance: float = 0.1  # m: positions that move less have converged
    ratio_tolerance: float = 0.01
    pass_std: float = 0.15e-3  # m of y - d - h(R) of a pass, before it is known
    most_weight: float = 1000.0  # of evidence, in passes
    gauge: GaugePrior = field(default_factory=GaugePrior)
    search: SearchParameters = field(default_factory=SearchParameters)
    gauge_trial: int = 2  # rounds after which the gauge must have explained something
    gauge_searches: int = 2  # rounds of wheels and search after that
    wheel_rounds: int = 2  # of wheels where the gauge is known
    gauge_explains: float = 0.1  # of the residual's rms, for the gauge to be taken as varying


@dataclass(frozen=True, slots=True)
class IterationResult:
    """Where the rounds ended."""

    panel: PanelParameters  # with the gauge, where it varies
    state: PanelState  # without the evidence
    solution: PanelSolution
    corrections: dict[Journey, Correction]
    ratios: dict[str, Ratio]  # by vehicle
    passes: tuple[Pass, ...]  # corrected and adjusted
    rounds: int
    moved: float
    changed: float  # by which the last round changed a stiffness ratio at most
    noise: float  # m, rms of y - d - h(R) over the passes


@dataclass(frozen=True, slots=True)
class _Course:
    """What stays the same over the rounds."""

    grouped: Grouped
    known: PriorAlignment | None
    anchored: bool
    parameters: IterationParameters


def iterate(
    grouped: Grouped,
    known: PriorAlignment | None,
    panel: PanelParameters,
    positions: PositionParameters,
    parameters: IterationParameters,
) -> IterationResult:
    """Return where alignment, curves, positions and ratios agree; with the gauge where it is known or shows."""
    has_alignment = known is not None and known.has_alignment
    course = _Course(grouped, known, has_alignment, parameters)
    corrections = correlate_positions(
        grouped, panel, positions, known.alignment if known is not None and has_alignment else None
    )
    iterated = _rounds(course, panel, corrections, {}, parameters.rounds)
    if known is not None and known.gauge_known and not known.gauge.any():
        return iterated
    if not (iterated.state.met >= FEWEST_PASSES).any():
        return iterated
    if known is None or not known.gauge_known:
        return _with_unknown_gauge(course, iterated, parameters.gauge_searches)
    if not has_alignment:
        iterated = _moved_to_gauge(course, iterated, known.gauge, positions)
        course = replace(course, anchored=True)
    measured = replace(iterated.panel, gauge=known.gauge, shifts=None)
    found = _rounds(course, measured, iterated.corrections, iterated.ratios, parameters.rounds)
    for _ in range(parameters.wheel_rounds):
        found = _solved(course, _repositioned(course, found), _with_wheels(found))
    return _finished(course, found)


def _rounds(
    course: _Course,
    panel: PanelParameters,
    corrections: dict[Journey, Correction],
    ratios: dict[str, Ratio],
    rounds: int,
) -> IterationResult:
    p, noise = course.parameters, course.parameters.pass_std
    moved, changed, done = np.inf, np.inf, 0
    while True:
        done += 1
        at = _placed(course.grouped, corrections, ratios)
        state = update(init(panel), at)
        last = (moved < p.position_tolerance and changed < p.ratio_tolerance) or done >= rounds
        solution = result(_told(state, course, noise), std=last)
        noise = max(residual_of_passes(state, solution), 0.1 * p.pass_std)
        if last:
            known = certain(ratios, at, solution, panel)
            last_step = float(moved), float(changed)
            return IterationResult(panel, state, solution, corrections, known, tuple(at), done, *last_step, noise)
        better = refine_ratios(ratios, at, solution, panel)
        changed = _changed(ratios, better)
        ratios = better
        placed = _refined_positions(course, corrections, ratios, state, solution, panel)
        moved = max(_apart(corrections[j], placed[j], members) for j, members in course.grouped.items())
        corrections = placed


def _told(state: PanelState, course: _Course, noise: float) -> PanelState:
    return state if course.known is None else add_prior(state, course.known, noise, course.parameters.most_weight)


def _placed(grouped: Grouped, corrections: Mapping[Journey, Correction], ratios: Mapping[str, Ratio]) -> list[Pass]:
    return apply_ratios(
        [item for j, members in grouped.items() for item in apply_correction(members, corrections[j])], ratios
    )


def _refined_positions(
    course: _Course,
    corrections: dict[Journey, Correction],
    ratios: Mapping[str, Ratio],
    state: PanelState,
    solution: PanelSolution,
    panel: PanelParameters,
) -> dict[Journey, Correction]:
    stiff = {journey: apply_ratios(members, ratios) for journey, members in course.grouped.items()}
    better = refine(stiff, corrections, solution, panel, anchored=course.anchored)
    if not course.anchored or course.known is None:
        return better
    step = fleet_step(state, solution, course.known)
    if step is None:
        return better
    mean = float(np.mean([better[journey].offset - corrections[journey].offset for journey in better]))
    return {journey: replace(one, offset=one.offset - mean + step) for journey, one in better.items()}


def _with_unknown_gauge(course: _Course, iterated: IterationResult, searches: int) -> IterationResult:
    """Return the solution with a gauge deviation of the place, where that explains the residuals; else as it was."""
    p = course.parameters
    effect = initial_gauge_effect(iterated.passes, iterated.solution, iterated.panel, p.gauge)
    if effect is None:
        return iterated
    panel = replace(iterated.panel, gauge=np.zeros(iterated.panel.points))
    found = replace(iterated, panel=panel, solution=with_gauge_effect(iterated.solution, effect, panel))
    for number in range(p.gauge_trial):
        found = _repositioned(course, found) if number else found
        prior = replace(p.gauge, noise=max(min(p.gauge.noise, found.noise), 0.3 * p.gauge.noise))
        gauge = gauge_step(found.passes, found.solution, found.panel, prior)
        found = _solved(course, found, replace(found.panel, gauge=gauge))
    if found.noise > (1.0 - p.gauge_explains) * iterated.noise:
        return iterated
    for _ in range(searches):
        found = _repositioned(course, found)
        shifts = total_gauge_shifts(found.solution, found.panel)
        gauge = search_gauge(found.passes, found.solution, found.panel, shifts, p.search)
        found = _solved(course, found, replace(found.panel, gauge=gauge))
        found = _solved(course, _repositioned(course, found), _with_wheels(found, sized=True))
    return _finished(course, found)


def _with_wheels(found: IterationResult, *, sized: bool = False) -> PanelParameters:
    """Return the panel with what the gauge does by the wheels that fit best, and a gauge ``sized`` by them."""
    assert found.panel.gauge is not None
    seen = contact_samples(found.passes, found.solution, found.panel)
    factor = gauge_factor(seen) if sized else 1.0
    shifts = {name: gauge_shift_of(fit(one.inliers(), factor)) for name, one in seen.items()}
    return replace(found.panel, gauge=factor * found.panel.gauge, shifts=remove_common_shift(shifts))


def _solved(course: _Course, found: IterationResult, panel: PanelParameters, *, std: bool = False) -> IterationResult:
    """Return ``found`` with curves and alignment for ``panel``."""
    state = update(init(panel), list(found.passes))
    solution = result(_told(state, course, found.noise), std=std)
    noise = max(residual_of_passes(state, solution), 0.1 * course.parameters.pass_std)
    return replace(found, panel=panel, state=state, solution=solution, noise=noise, rounds=found.rounds + 1)


def _repositioned(course: _Course, found: IterationResult) -> IterationResult:
    """Return ``found`` with better positions and stiffness ratios, and the passes moved by them."""
    ratios = refine_ratios(found.ratios, found.passes, found.solution, found.panel)
    corrections = _refined_positions(course, found.corrections, ratios, found.state, found.solution, found.panel)
    moved = max(_apart(found.corrections[j], corrections[j], members) for j, members in course.grouped.items())
    at = tuple(_placed(course.grouped, corrections, ratios))
    changed = _changed(found.ratios, ratios)
    return replace(found, corrections=corrections, ratios=ratios, passes=at, moved=float(moved), changed=changed)


def _finished(course: _Course, found: IterationResult) -> IterationResult:
    """Return ``found`` with standard deviations."""
    whole = _solved(course, found, found.panel, std=True)
    return replace(whole, ratios=certain(whole.ratios, whole.passes, whole.solution, whole.panel), rounds=found.rounds)


def _moved_to_gauge(
    course: _Course, iterated: IterationResult, gauge: FloatArray, positions: PositionParameters
) -> IterationResult:
    """Return the fleet moved to where a recorded gauge lies: the gauge that the passes tell is compared with it."""
    trial = _with_unknown_gauge(course, iterated, 1)
    if trial.panel.gauge is None:
        return iterated  # the gauge hardly shows: then it hardly matters where it lies
    both = [compared(sign * trial.panel.gauge, gauge, trial.panel, positions) for sign in (1.0, -1.0)]
    correction = max(both, key=lambda found: found[1])[0]
    return replace(trial, corrections={j: compose(one, correction) for j, one in trial.corrections.items()})


def _changed(before: Mapping[str, Ratio], after: Mapping[str, Ratio]) -> float:
    """Return by how much a stiffness ratio has changed at most; a vehicle that is new was as assumed."""
    return max((abs(one.value - before.get(vehicle, Ratio()).value) for vehicle, one in after.items()), default=0.0)


def _apart(first: Correction, second: Correction, members: Sequence[Pass]) -> float:
    """Return by how much two corrections differ at the ends of a journey, m."""
    ends = np.array([min(item.at[0] for item in members), max(item.at[-1] for item in members)])
    return float(np.abs(first.at(ends) - second.at(ends)).max())
