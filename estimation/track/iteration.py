"""Alignment, curves, positions, stiffness ratios and gauge of a section, each from the others until none moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.gauge.initial_shape import effect_from_residuals
from estimation.track.gauge.least_squares_step import FEWEST_PASSES, GaugePrior, gauge_step, with_effect
from estimation.track.gauge.search import SearchParameters, searched
from estimation.track.gauge.wheel_functions import fit, gauge_factor, places, shift_of, whole_shifts, without_common
from estimation.track.journeys import Journey, PositionParameters, corrected
from estimation.track.panel.basis import PanelParameters
from estimation.track.panel.normal_equations import PanelState, init, update
from estimation.track.panel.prior_alignment import Evidence, fleet_step, with_evidence
from estimation.track.panel.solution import PanelSolution, residual_of_passes, result
from estimation.track.panel.stiffness_ratio import Ratio, adjusted, certain, refined
from estimation.track.passes import Pass
from estimation.track.positions import compared, correlate, moved_along, refine
from estimation.values.arrays import FloatArray
from estimation.values.track import Correction

Grouped = Mapping[Journey, Sequence[Pass]]


@dataclass(frozen=True, slots=True)
class SettlingParameters:
    """When the rounds end."""

    rounds: int = 8  # of positions and panel at most
    settled: float = 0.1  # m: positions that move less have converged
    settled_ratio: float = 0.01
    pass_std: float = 0.15e-3  # m of y - d - h(R) of a pass, before it is known
    most_weight: float = 1000.0  # of evidence, in passes
    gauge: GaugePrior = field(default_factory=GaugePrior)
    search: SearchParameters = field(default_factory=SearchParameters)
    gauge_trial: int = 2  # rounds after which the gauge must have explained something
    gauge_searches: int = 2  # rounds of wheels and search after that
    wheel_rounds: int = 2  # of wheels where the gauge is known
    gauge_explains: float = 0.1  # of the residual's rms, for the gauge to be taken as varying


@dataclass(frozen=True, slots=True)
class Settled:
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
    known: Evidence | None
    anchored: bool
    parameters: SettlingParameters


def settle(
    grouped: Grouped,
    known: Evidence | None,
    panel: PanelParameters,
    positions: PositionParameters,
    parameters: SettlingParameters,
) -> Settled:
    """Return where alignment, curves, positions and ratios agree; with the gauge where it is known or shows."""
    lies = known is not None and known.lies
    course = _Course(grouped, known, lies, parameters)
    corrections = correlate(grouped, panel, positions, known.alignment if known is not None and lies else None)
    settled = _rounds(course, panel, corrections, {}, parameters.rounds)
    if known is not None and known.gauge_known and not known.gauge.any():
        return settled
    if not (settled.state.met >= FEWEST_PASSES).any():
        return settled
    if known is None or not known.gauge_known:
        return _with_unknown_gauge(course, settled, parameters.gauge_searches)
    if not lies:
        settled = _moved_to_gauge(course, settled, known.gauge, positions)
        course = replace(course, anchored=True)
    measured = replace(settled.panel, gauge=known.gauge, shifts=None)
    found = _rounds(course, measured, settled.corrections, settled.ratios, parameters.rounds)
    for _ in range(parameters.wheel_rounds):
        found = _solved(course, _repositioned(course, found), _with_wheels(found))
    return _finished(course, found)


def _rounds(
    course: _Course,
    panel: PanelParameters,
    corrections: dict[Journey, Correction],
    ratios: dict[str, Ratio],
    rounds: int,
) -> Settled:
    p, noise = course.parameters, course.parameters.pass_std
    moved, changed, done = np.inf, np.inf, 0
    while True:
        done += 1
        at = _placed(course.grouped, corrections, ratios)
        state = update(init(panel), at)
        last = (moved < p.settled and changed < p.settled_ratio) or done >= rounds
        solution = result(_told(state, course, noise), std=last)
        noise = max(residual_of_passes(state, solution), 0.1 * p.pass_std)
        if last:
            known = certain(ratios, at, solution, panel)
            last_step = float(moved), float(changed)
            return Settled(panel, state, solution, corrections, known, tuple(at), done, *last_step, noise)
        better = refined(ratios, at, solution, panel)
        changed = _changed(ratios, better)
        ratios = better
        placed = _refined_positions(course, corrections, ratios, state, solution, panel)
        moved = max(_apart(corrections[j], placed[j], members) for j, members in course.grouped.items())
        corrections = placed


def _told(state: PanelState, course: _Course, noise: float) -> PanelState:
    return state if course.known is None else with_evidence(state, course.known, noise, course.parameters.most_weight)


def _placed(grouped: Grouped, corrections: Mapping[Journey, Correction], ratios: Mapping[str, Ratio]) -> list[Pass]:
    return adjusted([item for j, members in grouped.items() for item in corrected(members, corrections[j])], ratios)


def _refined_positions(
    course: _Course,
    corrections: dict[Journey, Correction],
    ratios: Mapping[str, Ratio],
    state: PanelState,
    solution: PanelSolution,
    panel: PanelParameters,
) -> dict[Journey, Correction]:
    stiff = {journey: adjusted(members, ratios) for journey, members in course.grouped.items()}
    better = refine(stiff, corrections, solution, panel, anchored=course.anchored)
    if not course.anchored or course.known is None:
        return better
    step = fleet_step(state, solution, course.known)
    if step is None:
        return better
    mean = float(np.mean([better[journey].offset - corrections[journey].offset for journey in better]))
    return {journey: replace(one, offset=one.offset - mean + step) for journey, one in better.items()}


def _with_unknown_gauge(course: _Course, settled: Settled, searches: int) -> Settled:
    """Return the solution with a gauge deviation of the place, where that explains the residuals; else as it was."""
    p = course.parameters
    effect = effect_from_residuals(settled.passes, settled.solution, settled.panel, p.gauge)
    if effect is None:
        return settled
    panel = replace(settled.panel, gauge=np.zeros(settled.panel.points))
    found = replace(settled, panel=panel, solution=with_effect(settled.solution, effect, panel))
    for number in range(p.gauge_trial):
        found = _repositioned(course, found) if number else found
        prior = replace(p.gauge, noise=max(min(p.gauge.noise, found.noise), 0.3 * p.gauge.noise))
        gauge = gauge_step(found.passes, found.solution, found.panel, prior)
        found = _solved(course, found, replace(found.panel, gauge=gauge))
    if found.noise > (1.0 - p.gauge_explains) * settled.noise:
        return settled
    for _ in range(searches):
        found = _repositioned(course, found)
        shifts = whole_shifts(found.solution, found.panel)
        gauge = searched(found.passes, found.solution, found.panel, shifts, p.search)
        found = _solved(course, found, replace(found.panel, gauge=gauge))
        found = _solved(course, _repositioned(course, found), _with_wheels(found, sized=True))
    return _finished(course, found)


def _with_wheels(found: Settled, *, sized: bool = False) -> PanelParameters:
    """Return the panel with what the gauge does by the wheels that fit best, and a gauge ``sized`` by them."""
    assert found.panel.gauge is not None
    seen = places(found.passes, found.solution, found.panel)
    factor = gauge_factor(seen) if sized else 1.0
    shifts = {name: shift_of(fit(one.calm(), factor)) for name, one in seen.items()}
    return replace(found.panel, gauge=factor * found.panel.gauge, shifts=without_common(shifts))


def _solved(course: _Course, found: Settled, panel: PanelParameters, *, std: bool = False) -> Settled:
    """Return ``found`` with curves and alignment for ``panel``."""
    state = update(init(panel), list(found.passes))
    solution = result(_told(state, course, found.noise), std=std)
    noise = max(residual_of_passes(state, solution), 0.1 * course.parameters.pass_std)
    return replace(found, panel=panel, state=state, solution=solution, noise=noise, rounds=found.rounds + 1)


def _repositioned(course: _Course, found: Settled) -> Settled:
    """Return ``found`` with better positions and stiffness ratios, and the passes moved by them."""
    ratios = refined(found.ratios, found.passes, found.solution, found.panel)
    corrections = _refined_positions(course, found.corrections, ratios, found.state, found.solution, found.panel)
    moved = max(_apart(found.corrections[j], corrections[j], members) for j, members in course.grouped.items())
    at = tuple(_placed(course.grouped, corrections, ratios))
    changed = _changed(found.ratios, ratios)
    return replace(found, corrections=corrections, ratios=ratios, passes=at, moved=float(moved), changed=changed)


def _finished(course: _Course, found: Settled) -> Settled:
    """Return ``found`` with standard deviations."""
    whole = _solved(course, found, found.panel, std=True)
    return replace(whole, ratios=certain(whole.ratios, whole.passes, whole.solution, whole.panel), rounds=found.rounds)


def _moved_to_gauge(course: _Course, settled: Settled, gauge: FloatArray, positions: PositionParameters) -> Settled:
    """Return the fleet moved to where a recorded gauge lies: the gauge that the passes tell is compared with it."""
    trial = _with_unknown_gauge(course, settled, 1)
    if trial.panel.gauge is None:
        return settled  # the gauge hardly shows: then it hardly matters where it lies
    both = [compared(sign * trial.panel.gauge, gauge, trial.panel, positions) for sign in (1.0, -1.0)]
    correction = max(both, key=lambda found: found[1])[0]
    return replace(trial, corrections={j: moved_along(one, correction) for j, one in trial.corrections.items()})


def _changed(before: Mapping[str, Ratio], after: Mapping[str, Ratio]) -> float:
    """Return by how much a stiffness ratio has changed at most; a vehicle that is new was as assumed."""
    return max((abs(one.value - before.get(vehicle, Ratio()).value) for vehicle, one in after.items()), default=0.0)


def _apart(first: Correction, second: Correction, members: Sequence[Pass]) -> float:
    """Return by how much two corrections differ at the ends of a journey, m."""
    ends = np.array([min(item.at[0] for item in members), max(item.at[-1] for item in members)])
    return float(np.abs(first.at(ends) - second.at(ends)).max())
