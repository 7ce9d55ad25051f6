"""The alignment of a section from the passes of an epoch and what was known before.

What was known, the last version or a recorded alignment, enters as one more pass of a wheelset with R = 0, weighted
by its variance against that of a pass. Journeys are put where it lies; without it they are put where they agree. A
journey that then agrees with nothing is refused and the others are solved again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.track.iteration import Grouped, IterationParameters, IterationResult, iterate
from estimation.track.journeys import Journey, PositionParameters, journeys
from estimation.track.panel.basis import OnGrid, PanelParameters, on_grid
from estimation.track.panel.long_waves import long_wave_alignment
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.panel.prior_alignment import PriorAlignment, prior_on_grid
from estimation.track.panel.solution import LEAST_WHEELSETS, PanelSolution, diversity
from estimation.track.panel.stiffness_ratio import PRIOR_STD
from estimation.track.passes import Pass
from estimation.track.residuals import residuals
from estimation.track.results import LIFE, AlignmentReport, JourneyReport, SectionResults, findings, nothing
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.track import FLEET, Correction, TrackAlignment


@dataclass(frozen=True, slots=True)
class SectionParameters:
    """How an epoch of passes becomes an alignment."""

    panel: PanelParameters = field(default_factory=PanelParameters)
    positions: PositionParameters = field(default_factory=PositionParameters)
    iteration: IterationParameters = field(default_factory=IterationParameters)
    scale_error: float = 0.009  # relative std of y - d as a whole that passes leave open, blocks of data cannot show it
    gauge_scale_error: float = 0.035  # the same where the gauge had to be found too
    systematic: float = 0.02e-3  # m, std of the alignment that blocks of data cannot show
    systematic_per_gauge: tuple[float, float] = (0.025, 0.055)  # the same per gauge deviation: recorded, found
    reaches: float = 120.0  # m, longest wavelength that the alignment holds
    outlier_factor: float = 2.0  # times the median residual of the other journeys
    least_outlier_m: float = 0.4e-3  # m
    gauge_std: float = 1e-3  # m, expected of a gauge that nobody knows and that does not show


@dataclass(frozen=True, slots=True)
class SectionEstimate:
    """What the passes of an epoch and the evidence say; ``alignment`` is None where that is nothing."""

    alignment: TrackAlignment | None
    report: AlignmentReport
    corrections: Mapping[Journey, Correction]  # of the journeys that were used
    solution: PanelSolution | None


def estimate_section(
    section: str, passes: Sequence[Pass], evidence: TrackAlignment | None, parameters: SectionParameters
) -> SectionEstimate:
    """Return the alignment of a section from ``passes`` and ``evidence``.

    Parameters
    ----------
    section
        Its code.
    passes
        Of this epoch; wheelsets are told apart by ``Pass.wheelset``, so passes of other wear need another name. What
        ``parameters.panel.measured`` says of them is evidence too.
    evidence
        The last version, or a recorded alignment; None where nothing is known.
    parameters
        Grid, filter, rounds.
    """
    named = () if evidence is None else (f"{evidence.source} version {evidence.version}",)
    grouped: Grouped = journeys(passes, parameters.positions)
    if not grouped:
        return SectionEstimate(None, nothing("no pass", named), {}, None)
    known = None if evidence is None else prior_on_grid(evidence, parameters.panel, parameters.panel.cutoff_wavelength)
    reason = _nothing_to_tell(grouped, parameters) if known is None or not known.has_alignment else ""
    if reason:
        return SectionEstimate(None, nothing(reason, named), {}, None)
    iterated, outliers, residuals = _reject_outliers(grouped, known, parameters)
    report = _report(iterated, grouped, outliers, residuals, known, parameters)
    report = replace(report, evidence=named + tuple(f"measured profiles of {one.name}" for one in _measured(iterated)))
    if report.status is not Status.ESTIMATED:
        return SectionEstimate(None, report, {}, iterated.solution)
    alignment = _alignment(section, iterated, evidence, parameters)
    certain = np.isfinite(alignment.alignment)
    report = replace(
        report,
        covered=float(certain.mean()),
        alignment_std_m=float(np.median(alignment.alignment_std[certain])) if certain.any() else float("nan"),
    )
    return SectionEstimate(alignment, report, iterated.corrections, iterated.solution)


def _nothing_to_tell(grouped: Grouped, p: SectionParameters) -> str:
    """Return why the passes alone cannot tell anything, before anything is solved; empty where they may."""
    passed = np.zeros(p.panel.points, dtype=np.int64)
    lives = set()
    for item in (item for members in grouped.values() for item in members):
        first, last = (int(np.clip(at / p.panel.step, 0, p.panel.points)) for at in (item.at[0], item.at[-1]))
        passed[first:last] += 1
        lives.add(item.wheelset)
    if len(lives) < LEAST_WHEELSETS and not lives & (p.panel.measured or {}).keys():
        return "one wheelset alone cannot tell the track from its own geometry"
    return "" if (passed >= p.panel.least_passes).any() else f"no place with {p.panel.least_passes} passes"


def _reject_outliers(
    grouped: Grouped, known: PriorAlignment | None, p: SectionParameters
) -> tuple[IterationResult, dict[Journey, str], dict[Journey, float]]:
    """Settle, leave out what agrees with nothing, and settle again until all that is left agrees.

    Wheelsets that are further off than others are heard less from then on.
    """
    kept, panel = dict(grouped), p.panel
    outliers: dict[Journey, str] = {}
    rms: dict[Journey, float] = {}
    while True:
        iterated = iterate(kept, known, panel, p.positions, p.iteration)
        left = residuals(iterated, p.positions)
        rms |= left.of_journeys
        found = _find_outliers({journey: rms[journey] for journey in kept}, iterated.corrections, p)
        outliers |= found
        if len(found) == len(kept):
            return iterated, outliers, rms
        if found:
            kept = {journey: members for journey, members in kept.items() if journey not in found}
            continue
        weights = left.weights()
        if panel.weights is not None or not weights:
            return iterated, outliers, rms
        panel = replace(panel, weights=weights)


def _find_outliers(
    residuals: Mapping[Journey, float], corrections: Mapping[Journey, Correction], p: SectionParameters
) -> dict[Journey, str]:
    """Return the journeys that are not where they say, or not on this section, with the reason."""
    found = {}
    for journey, value in residuals.items():
        others = [rest for other, rest in residuals.items() if other != journey and np.isfinite(rest)]
        limit = max(p.outlier_factor * float(np.median(others)), p.least_outlier_m) if others else np.inf
        offset = abs(corrections[journey].offset)
        if not np.isfinite(value):
            found[journey] = "too short, or where too few have passed"
        elif value > limit:
            found[journey] = f"agrees with no other: {1e3 * value:.2f} mm apart, {1e3 * limit:.2f} mm are expected"
        elif offset > p.positions.largest_offset:
            found[journey] = f"{offset:.0f} m off, {p.positions.largest_offset:.0f} m are searched"
    return found


def _report(
    iterated: IterationResult,
    grouped: Grouped,
    outliers: Mapping[Journey, str],
    rms: Mapping[Journey, float],
    known: PriorAlignment | None,
    p: SectionParameters,
) -> AlignmentReport:
    solution, state = iterated.solution, iterated.state
    passed = state.passes > 0
    of_panel = solution.report
    status, reason = of_panel.status, of_panel.reason
    if known is not None and known.has_alignment:
        status, reason = Status.ESTIMATED, ""
    if status is Status.ESTIMATED and len(outliers) == len(grouped):
        status, reason = Status.UNESTIMATED, "no journey agrees with another: " + next(iter(outliers.values()))
    restless = _not_converged_reason(iterated, p.iteration)
    told = [
        _journey(journey, members, iterated.corrections.get(journey, Correction()), rms[journey], outliers)
        for journey, members in grouped.items()
    ]
    certain = np.isfinite(solution.alignment_std)
    return AlignmentReport(
        status=status,
        reason=reason or "; ".join(filter(None, (restless, _low_weight_reason(iterated)))),
        converged=not restless,
        rounds=iterated.rounds,
        residual_rms_m=iterated.noise,
        moved_m=iterated.moved,
        passes=sum(item.passes for item in told if item.used),
        wheelsets=len(solution.wheelsets),
        mean_passes=float(state.passes[passed].mean()) if passed.any() else 0.0,
        diversity=diversity(state),
        covered=float(np.isfinite(solution.alignment).mean()),
        alignment_std_m=float(np.median(solution.alignment_std[certain])) if certain.any() else float("nan"),
        journeys=tuple(told),
    )


def _low_weight_reason(iterated: IterationResult) -> str:
    """Return which wheelsets count for little, being further off than the others; empty where none is."""
    weights = iterated.panel.weights or {}
    used = sorted(weights.keys() & set(iterated.solution.wheelsets))
    told = [f"{name.split(LIFE)[0]} ({weights[name]:.2f} of a pass)" for name in used]
    return f"heard little, for no single curve fits them: {', '.join(told)}" if told else ""


def _not_converged_reason(iterated: IterationResult, p: IterationParameters) -> str:
    """Return why the rounds have not settled; empty where they have."""
    moving = []
    if not iterated.moved < p.position_tolerance:
        moving.append(f"positions still moved by {iterated.moved:.2f} m, {p.position_tolerance:g} m is settled")
    if not iterated.changed < p.ratio_tolerance:
        moving.append(f"stiffness ratios still changed by {iterated.changed:.3f}, {p.ratio_tolerance:g} is settled")
    return f"not settled after {iterated.rounds} rounds: {' and '.join(moving)}" if moving else ""


def _journey(
    journey: Journey, members: Sequence[Pass], correction: Correction, residual: float, outliers: Mapping[Journey, str]
) -> JourneyReport:
    return JourneyReport(
        vehicle=journey[0],
        from_ns=journey[1],
        to_ns=max(item.start_ns for item in members),
        passes=len(members),
        offset_m=correction.offset,
        scale_1=correction.scale,
        middle_m=correction.middle,
        residual_rms_m=residual,
        used=journey not in outliers,
        reason=outliers.get(journey, ""),
    )


def _alignment(
    section: str, iterated: IterationResult, evidence: TrackAlignment | None, p: SectionParameters
) -> TrackAlignment:
    """Return the solution as an alignment, NaN where it is not known; places that nobody passed stay as they were."""
    found = long_wave_alignment(iterated.passes, iterated.solution, iterated.panel, p.reaches)
    known = _nothing_known(p) if evidence is None else prior_on_grid(evidence, p.panel, p.reaches)
    with np.errstate(divide="ignore"):
        weight = np.minimum((found.pass_std / known.std) ** 2, p.iteration.most_weight)
    total = found.passes + weight
    shared = np.maximum(total, 1e-12)
    d = (found.passes * found.alignment + weight * known.alignment) / shared
    common = np.where(np.isfinite(iterated.solution.common_std), iterated.solution.common_std, 0.0)
    std = np.hypot(common * found.passes / shared, found.pass_std / np.sqrt(shared))
    certain = (found.passes >= p.panel.least_passes) | np.isfinite(known.std)
    told = findings(iterated, gauge_estimated=not known.gauge_known)
    gauge = known.gauge if told.gauge is None else told.gauge
    gauge_std = known.gauge_std if told.gauge_std is None else told.gauge_std
    of_gauge = p.systematic_per_gauge[told.gauge is not None] * float(np.std(gauge))
    profile = _profile_std(iterated)
    std = np.sqrt(std**2 + found.passes / shared * (p.systematic**2 + of_gauge**2 + profile[0] ** 2))
    return TrackAlignment(
        section=section,
        version=0,
        s=np.asarray(np.arange(p.panel.points) * p.panel.step, dtype=np.float64),
        alignment=np.where(certain, d, np.nan),
        alignment_std=np.where(certain, std, np.nan),
        gauge_deviation=gauge,
        gauge_deviation_std=gauge_std,
        passes=np.rint(found.passes + known.passes).astype(np.int64),
        status=Status.ESTIMATED,
        source=FLEET,
        cutoff_wavelength=p.reaches,
        scale_std=float(np.hypot(_stretch(told, p), profile[1])),
        gauge_known=known.gauge_known and told.gauge is None,
        findings=told.findings,
    )


def _stretch(told: SectionResults, p: SectionParameters) -> float:
    """Return the relative std of a common stretch of y - d."""
    return p.scale_error if told.gauge is None else float(np.hypot(p.scale_error, p.gauge_scale_error))


def _measured(iterated: IterationResult) -> list[MeasuredCurve]:
    """Return the measured curves of the wheelsets that have passed."""
    known = iterated.panel.measured or {}
    return [known[name] for name in iterated.solution.wheelsets if name in known]


def _profile_std(iterated: IterationResult) -> tuple[float, float]:
    """Return std, m, and relative stretch of y - d where only measured profiles could tell the curves; else nought.

    The stretch is that of the profiles, and that of R by a stiffness that is as assumed.
    """
    if not iterated.solution.report.held:
        return 0.0, 0.0
    squares = np.array([(one.std, one.std / one.spread) for one in _measured(iterated)]) ** 2
    std, scale_error = np.sqrt(squares.mean(axis=0))
    seen = [felt for item in iterated.passes if (felt := on_grid(item, iterated.panel)) is not None]
    stiffness_term, whole = (sum(float(part @ part) for part in parts) for parts in _parts(seen))
    return float(std), float(np.hypot(scale_error, PRIOR_STD * np.sqrt(stiffness_term / whole) if whole > 0.0 else 0.0))


def _parts(seen: Sequence[OnGrid]) -> tuple[list[FloatArray], list[FloatArray]]:
    return [felt.stiffness_term[felt.inside] for felt in seen], [felt.difference[felt.inside] for felt in seen]


def _nothing_known(p: SectionParameters) -> PriorAlignment:
    zero = np.zeros(p.panel.points)
    return PriorAlignment(
        zero, np.full_like(zero, np.inf), zero, zero, np.full_like(zero, p.gauge_std), gauge_known=False
    )
