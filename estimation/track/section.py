"""The alignment of a section from the passes of an epoch and what was known before.

The last version, or a survey, enters as one more pass of a wheelset with R = 0, weighted by its variance. Journeys are
placed by it; without it they are placed where they agree. A journey that then agrees with nothing is refused and the
others are solved again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.iteration import Grouped, IterationResult, iterate, with_slope
from estimation.track.panel.basis import MeasuredCurve, Panel, pass_residual
from estimation.track.panel.instrumental_slope import error_of_difference
from estimation.track.panel.solution import (
    SINGLE_WHEELSET,
    PanelSolution,
    PriorAlignment,
    between_pass_std_ratio,
    prior_on_grid,
    too_few_passes,
)
from estimation.track.parameters import TRACK
from estimation.track.passes import Journey, Pass, ProfileLife, journeys
from estimation.track.results import AlignmentReport, JourneyReport, merged_alignment, unestimated_report
from estimation.track.settings import SectionParameters
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.track import Correction, Iterated, TrackAlignment, evidence_of_measurement, evidence_of_version


@dataclass(frozen=True, slots=True)
class Residuals:
    """Root mean squares of y - d - h(R), m; NaN where nothing that is known was covered."""

    of_journeys: Mapping[Journey, float]
    of_lives: Mapping[ProfileLife, float]
    of_usual_wheelsets: Mapping[Journey, float] = field(default_factory=dict)  # lower median of those of a journey

    def weights(self) -> dict[ProfileLife, float]:
        """Return by profile life how much a pass counts where it is far off; empty where that would not matter."""
        finite = [value for value in self.of_lives.values() if np.isfinite(value)]
        usual = max(TRACK.usual_std_factor * float(np.median(finite)), TRACK.least_usual_std) if finite else np.inf
        far = {life: usual / value for life, value in self.of_lives.items() if value > usual}
        weights = {life: ratio**TRACK.weight_power for life, ratio in far.items()}
        return weights if any(weight < TRACK.largest_effective_weight for weight in weights.values()) else {}


def residuals(iterated: IterationResult) -> Residuals:
    """Return the residuals of an iterated section, by journey and by wheelset."""
    sums: dict[Journey | ProfileLife | tuple[Journey, ProfileLife], FloatArray] = {}  # of squares, and their count
    d = iterated.solution.alignment
    for journey, one in iterated.placed.items():
        for item in one.passes:
            curve = iterated.solution.curve_of(item.life)
            rest = np.zeros(0)
            if not item.empty and curve is not None:
                values = pass_residual(item, curve, iterated.panel)[item.inside]
                rest = (values - d[item.used_points])[np.isfinite(d[item.used_points])]
            for key in (journey, item.life, (journey, item.life)):
                sums[key] = np.add(sums.get(key, np.zeros(2)), (float(rest @ rest), len(rest)))
    rms = {key: float(np.sqrt(square / count)) if count else float("nan") for key, (square, count) in sums.items()}
    usual = {}
    for journey, one in iterated.placed.items():
        parts = sorted(rms[journey, life] for life in {item.life for item in one.passes} if sums[journey, life][1])
        usual[journey] = parts[(len(parts) - 1) // 2] if parts else float("nan")
    lives = {item.life: rms[item.life] for item in iterated.passes}
    return Residuals({journey: rms[journey] for journey in iterated.placed}, lives, usual)


@dataclass(frozen=True, slots=True)
class SectionEstimate:
    """What follows from the passes of an epoch and the prior alignment; ``alignment`` is None where nothing does."""

    alignment: TrackAlignment | None
    report: AlignmentReport
    grouped: Grouped  # passes by journey
    corrections: Mapping[Journey, Correction]  # of the journeys that were used
    iterated: IterationResult | None = None

    @property
    def solution(self) -> PanelSolution | None:
        """Curves and alignment as the panel found them; None where there was nothing to solve."""
        return None if self.iterated is None else self.iterated.solution


@dataclass(frozen=True, slots=True)
class _Accepted:
    iterated: IterationResult
    outliers: Mapping[Journey, Reason]  # with the reason
    rms: Mapping[Journey, float]  # m, of all journeys


def estimate_section(
    section: str,
    passes: Sequence[Pass],
    prior: TrackAlignment | None,
    parameters: SectionParameters,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> SectionEstimate:
    """Return the alignment of a section from ``passes`` and what was known before."""
    named = () if prior is None else (evidence_of_version(prior.source, prior.version),)
    grouped: Grouped = journeys(passes, parameters.positions)
    panel = Panel.of(parameters.panel, measured)
    if not grouped:
        return SectionEstimate(None, unestimated_report(Reason(ReasonCode.NO_PASS, "no pass"), named), grouped, {})
    known = None if prior is None else prior_on_grid(prior, panel.grid, parameters.panel.cutoff_wavelength)
    reason = _too_few_passes(grouped, panel) if known is None or not known.has_alignment else None
    if reason is not None:
        return SectionEstimate(None, unestimated_report(reason, named), grouped, {})
    accepted = _reject_outliers(grouped, known, panel, parameters)
    iterated = with_slope(accepted.iterated, known, parameters.iteration.most_weight)
    report = _report(replace(accepted, iterated=iterated), grouped, known, parameters)
    used = (evidence_of_measurement(measured_curve.name) for measured_curve in iterated.measured_curves)
    report = replace(report, evidence=(*named, *used))
    if report.status is not Status.ESTIMATED:
        return SectionEstimate(None, report, grouped, {}, iterated)
    alignment = merged_alignment(section, iterated, prior, parameters)
    certain = np.isfinite(alignment.alignment)
    report = replace(
        report,
        covered=float(certain.mean()),
        alignment_std_m=float(np.median(alignment.alignment_std[certain])) if certain.any() else float("nan"),
    )
    return SectionEstimate(alignment, report, grouped, iterated.corrections, iterated)


def _too_few_passes(grouped: Grouped, panel: Panel) -> Reason | None:
    grid, least = panel.grid, panel.parameters.least_passes
    passed = np.zeros(grid.points, dtype=np.int64)
    lives = set()
    for item in (item for members in grouped.values() for item in members):
        first, last = (int(np.clip(at / grid.step, 0, grid.points)) for at in (item.at[0], item.at[-1]))
        passed[first:last] += 1
        lives.add(item.life)
    if len(lives) < panel.parameters.least_wheelsets and not lives & panel.measured.keys():
        return SINGLE_WHEELSET
    most = int(passed.max(initial=0))
    return None if most >= least else too_few_passes(least, most)


def _reject_outliers(grouped: Grouped, known: PriorAlignment | None, panel: Panel, p: SectionParameters) -> _Accepted:
    """Iterate, leave out what agrees with nothing, and iterate again until all that is left agrees."""
    # A journey is judged by its usual wheelset. Wheelsets that are further off than others have less weight from then
    # on.
    kept = dict(grouped)
    outliers: dict[Journey, Reason] = {}
    rms: dict[Journey, float] = {}
    while True:
        iterated = iterate(kept, known, panel, p.positions, p.iteration)
        rest = residuals(iterated)
        rms |= rest.of_journeys
        outlying = _find_outliers(rest.of_usual_wheelsets, iterated.corrections, p)
        outliers |= outlying
        if len(outlying) == len(kept):
            return _Accepted(iterated, outliers, rms)
        if outlying:
            kept = {journey: members for journey, members in kept.items() if journey not in outlying}
            continue
        weights = rest.weights()
        if panel.weights or not weights:
            return _Accepted(iterated, outliers, rms)
        panel = replace(panel, weights=weights)


def _find_outliers(
    residuals: Mapping[Journey, float], corrections: Mapping[Journey, Correction], p: SectionParameters
) -> dict[Journey, Reason]:
    reasons = {}
    for journey, value in residuals.items():
        others = [rest for other, rest in residuals.items() if other != journey and np.isfinite(rest)]
        limit = max(p.outlier_factor * float(np.median(others)), p.least_outlier_m) if others else np.inf
        offset = abs(corrections[journey].offset)
        if not np.isfinite(value):
            reasons[journey] = Reason(ReasonCode.JOURNEY_INDETERMINATE, "too short, or where too few have passed")
        elif value > limit:
            text = f"agrees with no other: {1e3 * value:.2f} mm apart, {1e3 * limit:.2f} mm are expected"
            reasons[journey] = Reason(ReasonCode.JOURNEY_DISAGREES, text)
        elif offset > p.positions.largest_offset:
            text = f"{offset:.0f} m off, {p.positions.largest_offset:.0f} m are searched"
            reasons[journey] = Reason(ReasonCode.OFFSET_TOO_LARGE, text)
    return reasons


def _report(
    accepted: _Accepted, grouped: Grouped, known: PriorAlignment | None, p: SectionParameters
) -> AlignmentReport:
    iterated = accepted.iterated
    solution, state = iterated.solution, iterated.state
    passed = state.passes > 0
    status, reason = _state_of(accepted, grouped, known, p)
    not_converged = _not_converged_reason(iterated, p)
    journeys_reported = tuple(
        JourneyReport(
            vehicle=journey[0],
            from_ns=journey[1],
            to_ns=max(item.start_ns for item in members),
            passes=len(members),
            offset_m=correction.offset,
            scale_1=correction.scale,
            middle_m=correction.middle,
            residual_rms_m=accepted.rms[journey],
            used=journey not in accepted.outliers,
            reason=accepted.outliers.get(journey),
        )
        for journey, members in grouped.items()
        for correction in [iterated.corrections.get(journey, Correction())]
    )
    certain = np.isfinite(solution.alignment_std)
    return AlignmentReport(
        status=status,
        reason=reason or combined([not_converged, _low_weight_reason(iterated)]),
        converged=not_converged is None,
        convergence=iterated.convergence(p.iteration),
        rounds=iterated.rounds,
        residual_rms_m=iterated.noise,
        moved_m=iterated.moved,
        passes=sum(item.passes for item in journeys_reported if item.used),
        wheelsets=len(solution.lives),
        mean_passes=float(state.passes[passed].mean()) if passed.any() else 0.0,
        diversity=between_pass_std_ratio(state),
        covered=float(np.isfinite(solution.alignment).mean()),
        alignment_std_m=float(np.median(solution.alignment_std[certain])) if certain.any() else float("nan"),
        journeys=journeys_reported,
    )


def _state_of(
    accepted: _Accepted, grouped: Grouped, known: PriorAlignment | None, p: SectionParameters
) -> tuple[Status, Reason | None]:
    reason = accepted.iterated.solution.reason
    status = Status.ESTIMATED if reason is None else Status.UNESTIMATED
    if known is not None and known.has_alignment:
        status, reason = Status.ESTIMATED, None
    elif status is Status.ESTIMATED:
        unknown = _left_open(accepted.iterated, p)
        if unknown is not None:
            return Status.UNESTIMATED, unknown
    if status is Status.ESTIMATED and len(accepted.outliers) == len(grouped):
        first = next(iter(accepted.outliers.values()))
        return Status.UNESTIMATED, Reason(ReasonCode.NO_JOURNEY_AGREES, f"no journey agrees with another: {first}")
    return status, reason


def _left_open(iterated: IterationResult, p: SectionParameters) -> Reason | None:
    """Return what is not found well enough: a stiffness ratio that most of R depends on, or the slope of all curves."""
    error = error_of_difference(iterated.ratios, iterated.passes)
    if not (iterated.solution.curves_fixed or error <= p.most_difference_error):
        text = f"the passes leave the stiffness ratio open: {100 * error:.0f} % of rL - rR depend on what is assumed"
        return Reason(ReasonCode.STIFFNESS_OPEN, text)
    moving = _not_converged_reason(iterated, p)
    if moving is not None or iterated.slope is None or iterated.slope.std <= p.most_slope_std:
        return moving
    text = f"the passes are too alike: they leave the slope of all curves open by {100 * iterated.slope.std:.0f} %"
    return Reason(ReasonCode.PASSES_ALIKE, text)


def _low_weight_reason(iterated: IterationResult) -> Reason | None:
    weights = iterated.panel.weights
    used = sorted(weights.keys() & set(iterated.solution.lives))
    listed = [f"{life.wheelset} ({weights[life]:.2f} of a pass)" for life in used]
    if not listed:
        return None
    return Reason(ReasonCode.LOW_WEIGHT, f"low weight: poor fit of a single curve: {', '.join(listed)}")


def _not_converged_reason(iterated: IterationResult, p: SectionParameters) -> Reason | None:
    tolerance = {
        Iterated.POSITIONS: f"{p.iteration.position_tolerance:g} m",
        Iterated.STIFFNESS_RATIOS: f"{p.iteration.ratio_tolerance:g}",
        Iterated.GAUGE: f"{1e3 * p.iteration.gauge_tolerance:g} mm",
    }
    changed = {
        Iterated.POSITIONS: "positions still moved by {:.2f} m",
        Iterated.STIFFNESS_RATIOS: "stiffness ratios still changed by {:.3f}",
        Iterated.GAUGE: "gauge still changed by {:.5f} m",
    }
    moving = [
        f"{changed[one.of].format(one.change)}, the tolerance is {tolerance[one.of]}"
        for one in iterated.convergence(p.iteration)
        if not one.converged and one.of in changed
    ]
    if not moving:
        return None
    return Reason(ReasonCode.NOT_CONVERGED, f"not converged after {iterated.rounds} rounds: {' and '.join(moving)}")
