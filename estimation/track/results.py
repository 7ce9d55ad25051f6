"""What follows from the solution of a section: alignment with its std, findings, places of journeys, report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, cast

import numpy as np

from estimation.filters import high_pass, local_cubic_kernel, valid_support
from estimation.track.gauge.wheel_functions import contact_samples, gauge_sign, total_gauge_shifts
from estimation.track.gridded_pass import GriddedPass
from estimation.track.iteration import Grouped, IterationResult, Setting, first_rounds
from estimation.track.panel.basis import MeasuredCurve, Panel, unfiltered_residual
from estimation.track.panel.instrumental_slope import PRIOR_STD
from estimation.track.panel.solution import PanelSolution, PriorAlignment, between_pass_std_ratio, prior_on_grid
from estimation.track.parameters import TRACK
from estimation.track.passes import Journey, ProfileLife
from estimation.track.positions import correlate_positions
from estimation.track.settings import SectionParameters
from estimation.values.arrays import FloatArray
from estimation.values.fields import JsonValue
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.track import (
    AlignmentSource,
    Convergence,
    Correction,
    TrackAlignment,
    TrackFindings,
    TrackSectionRecord,
)


def findings(iterated: IterationResult, *, gauge_estimated: bool) -> tuple[TrackFindings, FloatArray | None]:
    """Return what the passes show, and the gauge deviation (n,), m, where that of the panel came from them."""
    ratios = {vehicle: one.value for vehicle, one in iterated.ratios.items()}
    std = max((one.std for one in iterated.ratios.values()), default=0.0)
    gauge = iterated.panel.gauge
    if gauge is None:
        return TrackFindings(ratios, std, {}), None
    panel = iterated.panel
    shifts = total_gauge_shifts(iterated.solution, panel)
    sign = gauge_sign(contact_samples(iterated.passes, iterated.solution, panel), shifts) if gauge_estimated else 1
    if sign < 0:
        shifts = {name: replace(one, shift=one.shift[:, ::-1]) for name, one in shifts.items()}  # a symmetric grid
    latest = {life.wheelset: shifts[life] for life in sorted(shifts)}  # of several lives the latest
    return TrackFindings(ratios, std, latest), sign * gauge if gauge_estimated else None


@dataclass(frozen=True, slots=True)
class JourneyReport:
    """Windows of one vehicle on one run over the section: where they were, or why they were not used."""

    vehicle: str
    from_ns: int
    to_ns: int  # start of its last window
    passes: int
    offset_m: float
    scale_1: float
    middle_m: float
    residual_rms_m: float
    used: bool
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class AlignmentReport:
    """How an alignment was found, in figures; ``evidence`` names what was known besides the passes."""

    status: Status
    reason: Reason | None
    converged: bool = False  # positions and stiffness ratios; where not, ``reason`` says so, also of an estimate
    convergence: tuple[Convergence, ...] = ()  # of each quantity that is iterated
    rounds: int = 0
    residual_rms_m: float = 0.0  # of y - d - h(R) over all passes
    moved_m: float = 0.0  # by which the last round moved a position at most
    passes: int = 0
    wheelsets: int = 0
    mean_passes: float = 0.0  # per place that has any
    diversity: float = 0.0  # std of R between the passes of a place over the std of R
    covered: float = 0.0  # share of the section whose alignment is known
    alignment_std_m: float = math.nan  # median along the section
    evidence: tuple[str, ...] = ()
    journeys: tuple[JourneyReport, ...] = ()

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it as JSON; a number that is none is null."""
        return cast("dict[str, JsonValue]", _json(asdict(self)))


def _json(value: Any) -> JsonValue:  # noqa: ANN401 - of any field
    if isinstance(value, dict):
        whole = {name: _json(item) for name, item in value.items()}
        if "reason" in value:  # as the database has it: the sentence, and the code beside it
            reason = value["reason"] or {"text": "", "code": None}
            whole |= {"reason": reason["text"], "reason_code": reason["code"] and str(reason["code"])}
        return whole
    if isinstance(value, tuple):
        return [_json(item) for item in value]
    if isinstance(value, StrEnum):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def nothing(reason: Reason, evidence: tuple[str, ...] = ()) -> AlignmentReport:
    """Return the report of passes from which nothing follows, for this reason."""
    return AlignmentReport(Status.UNESTIMATED, reason, evidence=evidence)


@dataclass(frozen=True, slots=True)
class LongWaveAlignment:
    """Mean of y - h(R) over the passes, high-passed at one cut-off wavelength only."""

    alignment: FloatArray  # (n,) m, zero where no pass
    pass_std: float  # m, of one pass, from the spread of the passes
    passes: FloatArray  # (n,) sum of their weights
    curves: FloatArray  # (n,) m, mean of h(R) over the passes, zero where no pass


def long_wave_alignment(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, cutoff_wavelength: float
) -> LongWaveAlignment:
    """Return the alignment, up to a cut-off wavelength, m, from ``passes`` with the curves of ``solution``."""
    weights = local_cubic_kernel(cutoff_wavelength, panel.grid.step)
    total, square, count, curves = np.zeros((4, panel.grid.points))
    for item, curve in solution.used(passes):
        rest = unfiltered_residual(item, curve, panel)
        pass_residual, y = high_pass(np.stack([rest, item.displacement]), weights)
        inside = valid_support(item.certain, weights) & panel.grid.contains(item.points)
        at = item.points[inside]
        weight = panel.weight_of(item.life)
        total[at] += weight * pass_residual[inside]
        square[at] += weight * pass_residual[inside] ** 2
        curves[at] += weight * (y - pass_residual)[inside]
        count[at] += weight
    shared = np.where(count > 0.0, count, 1.0)
    mean = total / shared
    several = count > 1
    spread = (square - count * mean**2)[several].sum() / max(float((count - 1)[several].sum()), 1.0)
    return LongWaveAlignment(mean, float(np.sqrt(max(spread, 0.0))), count, curves / shared)


def merged_alignment(
    section: str, iterated: IterationResult, prior: TrackAlignment | None, p: SectionParameters
) -> TrackAlignment:
    """Return the solution as an alignment, NaN where it is not known; places without a pass stay as they were."""
    grid = iterated.panel.grid
    found = long_wave_alignment(iterated.passes, iterated.solution, iterated.panel, p.cutoff_wavelength)
    zero = np.zeros(grid.points)
    known = PriorAlignment(zero, np.full_like(zero, np.inf), zero, zero, zero, gauge_known=False)
    if prior is not None:
        known = prior_on_grid(prior, grid, p.cutoff_wavelength)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (found.pass_std / known.std) ** 2
    weight = np.where(np.isfinite(known.std), np.fmin(ratio, p.iteration.most_weight), 0.0)
    shared = np.maximum(found.passes + weight, 1e-12)
    d = (found.passes * found.alignment + weight * known.alignment) / shared
    certain = (found.passes >= p.panel.least_passes) | np.isfinite(known.std)
    shown, shown_gauge = findings(iterated, gauge_estimated=not known.gauge_known)
    gauge = known.gauge if shown_gauge is None else shown_gauge
    gauge_std = _gauge_std(iterated, known, shown_gauge, p)
    profile_std, profile_scale_std = _profile_uncertainty(iterated)
    slope_std = 0.0 if iterated.slope is None else min(iterated.slope.std, p.open_slope_std)
    of_gauge = p.systematic_per_gauge[shown_gauge is not None] * float(np.std(gauge))
    systematic = p.systematic**2 + of_gauge**2 + profile_std**2 + (slope_std * found.curves) ** 2
    std = _std(found, shared, iterated.solution.common_std, systematic)
    of_prior = 0.0 if prior is None else prior.scale_std * float(np.median(weight / shared))
    return TrackAlignment(
        section=section,
        version=0,
        s=grid.s,
        alignment=np.where(certain, d, np.nan),
        alignment_std=np.where(certain, std, np.nan),
        gauge_deviation=gauge,
        gauge_deviation_std=gauge_std,
        passes=np.rint(found.passes + known.passes).astype(np.int64),
        status=Status.ESTIMATED,
        source=AlignmentSource.FLEET,
        cutoff_wavelength=p.cutoff_wavelength,
        scale_std=float(np.linalg.norm([_scale_std(shown_gauge, p), profile_scale_std, slope_std, of_prior])),
        gauge_known=known.gauge_known and shown_gauge is None,
        findings=shown,
    )


def _std(found: LongWaveAlignment, shared: FloatArray, of_curves: FloatArray, systematic: FloatArray) -> FloatArray:
    """Return the std (n,), m: of curves and passes, and a systematic variance (n,), m2, by the passes' share."""
    common = np.where(np.isfinite(of_curves), of_curves, 0.0)
    std = np.hypot(common * found.passes / shared, found.pass_std / np.sqrt(shared))
    return np.asarray(np.sqrt(std**2 + found.passes / shared * systematic))


def _gauge_std(
    iterated: IterationResult, known: PriorAlignment, shown: FloatArray | None, parameters: SectionParameters
) -> FloatArray:
    """Return the std (n,), m, of the gauge deviation: as surveyed, or by what it does to passes that know none of it.

    Passes disagree by more than sensors make them where a gauge that is not modelled moves their wheelsets apart;
    wheelsets that are alike are moved alike.
    """
    if known.gauge_known:
        return known.gauge_std
    unexplained = float(np.sqrt(max(iterated.noise_without_gauge**2 - parameters.sensor_residual_rms**2, 0.0)))
    differing = min(between_pass_std_ratio(iterated.state) / parameters.wide_std_ratio, 1.0)
    inferred = unexplained / (parameters.gauge_effect * differing) if differing > 0.0 else 0.0
    found = 0.0 if shown is None else float(np.std(shown))
    return np.full_like(known.gauge_std, max(inferred, found))


def _scale_std(shown: FloatArray | None, p: SectionParameters) -> float:
    return p.scale_error if shown is None else float(np.hypot(p.scale_error, p.gauge_scale_error))


def _profile_uncertainty(iterated: IterationResult) -> tuple[float, float]:
    if not iterated.solution.curves_fixed:
        return 0.0, 0.0
    squares = np.array([(one.std, one.std / one.spread) for one in iterated.measured_curves]) ** 2
    std, scale = np.sqrt(squares.mean(axis=0))
    used = [item for item in iterated.passes if not item.empty]
    stiffness = sum(float(part @ part) for part in (item.stiffness_term[item.inside] for item in used))
    whole = sum(float(part @ part) for part in (item.difference[item.inside] for item in used))
    of_stiffness = PRIOR_STD * np.sqrt(stiffness / whole) if whole > 0.0 else 0.0
    return float(std), float(np.hypot(scale, of_stiffness))


def position_std(iterated: IterationResult) -> dict[Journey, float]:
    """Return the std of each journey's offset, m, by the slope of the alignment and the residuals; inf for none."""
    panel, solution = iterated.panel, iterated.solution
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.grid.step)
    weight = panel.grid.step / TRACK.correlated_length / max(iterated.noise, 1e-9) ** 2
    information = {
        journey: weight * sum(float(np.sum(slope[item.used_points] ** 2)) for item in one.passes if not item.empty)
        for journey, one in iterated.placed.items()
    }
    return {journey: one**-0.5 if one > 0.0 else float("inf") for journey, one in information.items()}


def shrunk(iterated: IterationResult) -> Mapping[Journey, Correction]:
    """Return the corrections of journeys, each as far as it is better known than the reported position."""
    found = {}
    for journey, std in position_std(iterated).items():
        share = TRACK.reported_position_std**2 / (TRACK.reported_position_std**2 + std**2)
        one = iterated.corrections[journey]
        found[journey] = replace(one, offset=share * one.offset, scale=share * one.scale)
    return found


def place_alone(
    section: TrackSectionRecord,
    grouped: Grouped,
    alignment: TrackAlignment,
    parameters: SectionParameters,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> dict[Journey, Correction]:
    """Return where each journey was on an alignment, whatever others show; those whose place is not found are left out.

    Nothing is placed on an alignment whose gauge is known to vary: that takes the wheels of all.
    """
    panel = Panel.of(replace(parameters.panel, length=section.length_m), measured)
    prior = prior_on_grid(alignment, panel.grid, parameters.panel.cutoff_wavelength)
    if not prior.has_alignment or (prior.gauge_known and prior.gauge.any()):
        return {}
    places = {}
    for journey, members in grouped.items():
        alone: Grouped = {journey: members}
        setting = Setting(alone, prior, anchored=True, parameters=parameters.iteration)
        start = correlate_positions(alone, panel.grid, parameters.positions, prior.alignment)
        found = first_rounds(setting, panel, start, std=False)
        if found.moved < parameters.iteration.position_tolerance:
            places[journey] = shrunk(found)[journey] if prior.surveyed else found.corrections[journey]
    return places
