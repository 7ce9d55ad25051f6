"""Alignment, curves, positions, stiffness ratios and gauge of a section, each from the others until none moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.arrays import FloatArray
from estimation.track.evidence import Evidence, with_evidence
from estimation.track.gauge import FEWEST_PASSES, GaugePrior, first_guess, gauge_step
from estimation.track.panel import PanelParameters, PanelState, init, update
from estimation.track.passes import Pass
from estimation.track.positions import (
    Correction,
    Journey,
    PositionParameters,
    compared,
    corrected,
    correlate,
    moved_along,
    refine,
)
from estimation.track.solution import PanelSolution, result
from estimation.track.stiffness import Ratio, adjusted, certain, refined

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
    gauge_rounds: int = 8
    gauge_trial: int = 2  # rounds after which the gauge must have explained something
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
    if not (settled.state.passes >= FEWEST_PASSES).any():
        return settled
    if known is None or not known.gauge_known:
        return _with_unknown_gauge(course, settled, parameters.gauge_rounds)
    if not lies:
        settled = _moved_to_gauge(course, settled, known.gauge, positions)
        course = replace(course, anchored=True)
    measured = replace(panel, gauge=known.gauge)
    return _rounds(course, measured, settled.corrections, settled.ratios, parameters.rounds)


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
            return Settled(panel, state, solution, corrections, known, tuple(at), done, float(moved), noise)
        better = refined(ratios, at, solution, panel)
        changed = max((abs(one.value - ratios.get(v, Ratio()).value) for v, one in better.items()), default=0.0)
        ratios = better
        placed = _refined_positions(course, corrections, ratios, solution, panel)
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
    solution: PanelSolution,
    panel: PanelParameters,
) -> dict[Journey, Correction]:
    stiff = {journey: adjusted(members, ratios) for journey, members in course.grouped.items()}
    return refine(stiff, corrections, solution, panel, anchored=course.anchored)


def _with_unknown_gauge(course: _Course, settled: Settled, rounds: int) -> Settled:
    """Return the solution with a gauge deviation of the place, where that explains the residuals; else as it was."""
    p = course.parameters
    panel = replace(settled.panel, gauge=np.zeros(settled.panel.points))
    found = replace(settled, panel=panel, solution=first_guess(settled.solution, panel))
    for number in range(1, rounds + 1):
        prior = replace(p.gauge, noise=max(min(p.gauge.noise, found.noise), 0.3 * p.gauge.noise))
        panel = replace(panel, gauge=gauge_step(found.passes, found.solution, panel, prior))
        last = number == rounds
        state = update(init(panel), list(found.passes))
        solution = result(_told(state, course, found.noise), std=last)
        noise = max(residual_of_passes(state, solution), 0.1 * p.pass_std)
        found = replace(found, panel=panel, state=state, solution=solution, noise=noise, rounds=settled.rounds + number)
        if number == p.gauge_trial and noise > (1.0 - p.gauge_explains) * settled.noise:
            return settled
        if not last and number >= p.gauge_trial:
            ratios = refined(found.ratios, found.passes, solution, panel)
            corrections = _refined_positions(course, found.corrections, ratios, solution, panel)
            at = _placed(course.grouped, corrections, ratios)
            found = replace(found, corrections=corrections, ratios=ratios, passes=tuple(at))
    return replace(found, ratios=certain(found.ratios, found.passes, found.solution, found.panel))


def _moved_to_gauge(course: _Course, settled: Settled, gauge: FloatArray, positions: PositionParameters) -> Settled:
    """Return the fleet moved to where a recorded gauge lies: the gauge that the passes tell is compared with it."""
    trial = _with_unknown_gauge(course, settled, course.parameters.gauge_trial + 2)
    if trial.panel.gauge is None:
        return settled  # the gauge hardly shows: then it hardly matters where it lies
    both = [compared(sign * trial.panel.gauge, gauge, trial.panel, positions) for sign in (1.0, -1.0)]
    correction = max(both, key=lambda found: found[1])[0]
    return replace(trial, corrections={j: moved_along(one, correction) for j, one in trial.corrections.items()})


def residual_of_passes(state: PanelState, solution: PanelSolution) -> float:
    """Return the rms of y - d - h(R) over the passes alone, m, what they have shaped d and h by taken off."""
    c = solution.curves[0].reshape(len(state.wheelsets), -1)
    d = np.nan_to_num(solution.alignment)
    count = np.where(np.isfinite(solution.alignment), state.passes, 0)
    rest = state.displacement - np.einsum("wk,wkn->n", c, state.functions)
    squares = (
        state.square.sum()
        - 2.0 * np.einsum("wk,gwk->", c, state.cross)
        + np.einsum("wj,gwjk,wk->", c, state.gram, c)
        - 2.0 * float(d @ rest)
        + float(count @ (d * d))
    )
    own = state.passes[count > 0] / np.maximum(solution.passes[count > 0], 1.0)  # share of d that the passes made
    freedom = max(float(count.sum()) - float(own.sum()) - c.size, 1.0)
    return float(np.sqrt(max(float(squares), 0.0) / freedom))


def _apart(first: Correction, second: Correction, members: Sequence[Pass]) -> float:
    """Return by how much two corrections differ at the ends of a journey, m."""
    ends = np.array([min(item.at[0] for item in members), max(item.at[-1] for item in members)])
    return float(np.abs(first.at(ends) - second.at(ends)).max())
