"""Results of the solution of a section: alignment with its std, findings, places of journeys, report."""

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
    open_gauge_std,
)


def findings(iterated: IterationResult, *, gauge_estimated: bool) -> tuple[TrackFindings, FloatArray | None]:
    """Return the findings, and the gauge deviation (n,) in m if the passes determined it."""
    ratios = {vehicle: ratio.value for vehicle, ratio in iterated.ratios.items()}
    std = max((ratio.std for ratio in iterated.ratios.values()), default=0.0)
    gauge = iterated.panel.gauge
    if gauge is None:
        return TrackFindings(ratios, std, {}), None
    panel = iterated.panel
    shifts = total_gauge_shifts(iterated.solution, panel)
    sign = gauge_sign(contact_samples(iterated.passes, iterated.solution, panel), shifts) if gauge_estimated else 1
    if sign < 0:
        shifts = {life: replace(item, shift=item.shift[:, ::-1]) for life, item in shifts.items()}  # a symmetric grid
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
    """How an alignment was found, in figures; ``evidence`` names what was used besides the passes."""

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
        """Return the report as JSON; NaN and infinity become null."""
        return cast("dict[str, JsonValue]", _json(asdict(self)))


def _json(value: Any) -> JsonValue:  # noqa: ANN401 - of any field
    if isinstance(value, dict):
        as_json = {name: _json(item) for name, item in value.items()}
        if "reason" in value:  # as the database has it: the sentence, and the code beside it
            reason = value["reason"] or {"text": "", "code": None}
            as_json |= {"reason": reason["text"], "reason_code": reason["code"] and str(reason["code"])}
        return as_json
    if isinstance(value, tuple):
        return [_json(item) for item in value]
    if isinstance(value, StrEnum):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def unestimated_report(reason: Reason, evidence: tuple[str, ...] = ()) -> AlignmentReport:
    """Return the report of passes from which no alignment was estimated, for this reason."""
    return AlignmentReport(Status.UNESTIMATED, reason, evidence=evidence)


@dataclass(frozen=True, slots=True)
class LongWaveAlignment:
    """Alignment with wavelengths up to a long cut-off only: mean of y - h(R) over the passes."""

    alignment: FloatArray  # (n,) m, zero where no pass
    pass_std: float  # m, of one pass, from the spread of the passes
    weight: FloatArray  # (n,) sum of the weights of the passes
    curves: FloatArray  # (n,) m, mean of h(R) over the passes, zero where no pass


def long_wave_alignment(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, cutoff_wavelength: float
) -> LongWaveAlignment:
    """Return the alignment, up to a cut-off wavelength, m, from ``passes`` with the curves of ``solution``."""
    weights = local_cubic_kernel(cutoff_wavelength, panel.grid.step)
    total, square, weight_sum, curves = np.zeros((4, panel.grid.points))
    for item, curve in solution.used(passes):
        unfiltered = unfiltered_residual(item, curve, panel)
        pass_residual, y = high_pass(np.stack([unfiltered, item.displacement]), weights)
        inside = valid_support(item.certain, weights) & panel.grid.contains(item.points)
        points = item.points[inside]
        weight = panel.weight_of(item.life)
        total[points] += weight * pass_residual[inside]
        square[points] += weight * pass_residual[inside] ** 2
        curves[points] += weight * (y - pass_residual)[inside]
        weight_sum[points] += weight
    nonzero_weight = np.where(weight_sum > 0.0, weight_sum, 1.0)
    mean = total / nonzero_weight
    several = weight_sum > 1
    spread = (square - weight_sum * mean**2)[several].sum() / max(float((weight_sum - 1)[several].sum()), 1.0)
    return LongWaveAlignment(mean, float(np.sqrt(max(spread, 0.0))), weight_sum, curves / nonzero_weight)


def merged_alignment(
    section: str, iterated: IterationResult, prior: TrackAlignment | None, p: SectionParameters
) -> TrackAlignment:
    """Return the solution as an alignment, NaN where it is not known; places without a pass stay as they were."""
    grid = iterated.panel.grid
    long_wave = long_wave_alignment(iterated.passes, iterated.solution, iterated.panel, p.cutoff_wavelength)
    zero = np.zeros(grid.points)
    prior_on_panel = PriorAlignment(zero, np.full_like(zero, np.inf), zero, zero, zero, gauge_known=False)
    if prior is not None:
        prior_on_panel = prior_on_grid(prior, grid, p.cutoff_wavelength)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (long_wave.pass_std / prior_on_panel.std) ** 2
    weight = np.where(np.isfinite(prior_on_panel.std), np.fmin(ratio, p.iteration.most_weight), 0.0)
    total_weight = np.maximum(long_wave.weight + weight, 1e-12)
    d = (long_wave.weight * long_wave.alignment + weight * prior_on_panel.alignment) / total_weight
    certain = (long_wave.weight >= p.panel.least_passes) | np.isfinite(prior_on_panel.std)
    track_findings, found_gauge = findings(iterated, gauge_estimated=not prior_on_panel.gauge_known)
    gauge = prior_on_panel.gauge if found_gauge is None else found_gauge
    gauge_std = _gauge_std(iterated, prior_on_panel, found_gauge, p)
    profile_std, profile_scale_std = _profile_uncertainty(iterated)
    slope_std = 0.0 if iterated.slope is None else min(iterated.slope.std, p.open_slope_std)
    gauge_model_std = p.systematic_per_gauge[found_gauge is not None] * float(np.std(gauge))
    prior_scale_std = 0.0 if prior is None else prior.scale_std * float(np.median(weight / total_weight))
    scale_std = float(np.linalg.norm([_scale_std(found_gauge, p), profile_scale_std, slope_std, prior_scale_std]))
    hidden = 0.0 if prior_on_panel.gauge_known else open_gauge_std(scale_std, float(np.median(gauge_std)))
    gauge_model_std = math.hypot(gauge_model_std, p.systematic_per_open_gauge * hidden)
    systematic = p.systematic**2 + gauge_model_std**2 + profile_std**2 + (slope_std * long_wave.curves) ** 2
    std = _std(long_wave, total_weight, iterated.solution.common_std, systematic)
    return TrackAlignment(
        section=section,
        version=0,
        s=grid.s,
        alignment=np.where(certain, d, np.nan),
        alignment_std=np.where(certain, std, np.nan),
        gauge_deviation=gauge,
        gauge_deviation_std=gauge_std,
        passes=np.rint(long_wave.weight + prior_on_panel.passes).astype(np.int64),
        status=Status.ESTIMATED,
        source=AlignmentSource.FLEET,
        cutoff_wavelength=p.cutoff_wavelength,
        scale_std=scale_std,
        gauge_known=prior_on_panel.gauge_known and found_gauge is None,
        findings=track_findings,
    )


def _std(long_wave: LongWaveAlignment, total: FloatArray, curves_std: FloatArray, systematic: FloatArray) -> FloatArray:
    """Return the std (n,) in m: curves, passes, and the systematic variance, weighted by the share of the passes."""
    common = np.where(np.isfinite(curves_std), curves_std, 0.0)
    std = np.hypot(common * long_wave.weight / total, long_wave.pass_std / np.sqrt(total))
    return np.asarray(np.sqrt(std**2 + long_wave.weight / total * systematic))


def _gauge_std(
    iterated: IterationResult, prior: PriorAlignment, gauge: FloatArray | None, parameters: SectionParameters
) -> FloatArray:
    """Return the std (n,), m, of the gauge deviation: as surveyed; else from how far passes disagree beyond noise.

    A gauge that is not modelled makes passes disagree; similar wheelsets are moved alike, and show less of it.
    """
    if prior.gauge_known:
        return prior.gauge_std
    unexplained = float(np.sqrt(max(iterated.noise_without_gauge**2 - parameters.sensor_residual_rms**2, 0.0)))
    diversity = min(between_pass_std_ratio(iterated.state) / parameters.wide_std_ratio, 1.0)
    inferred = unexplained / (parameters.gauge_effect * diversity) if diversity > 0.0 else 0.0
    gauge_spread = 0.0 if gauge is None else float(np.std(gauge))
    return np.full_like(prior.gauge_std, max(inferred, gauge_spread))


def _scale_std(found_gauge: FloatArray | None, p: SectionParameters) -> float:
    return p.scale_error if found_gauge is None else float(np.hypot(p.scale_error, p.gauge_scale_error))


def _profile_uncertainty(iterated: IterationResult) -> tuple[float, float]:
    if not iterated.solution.curves_fixed:
        return 0.0, 0.0
    squares = np.array([(curve.std, curve.std / curve.spread) for curve in iterated.measured_curves]) ** 2
    std, scale = np.sqrt(squares.mean(axis=0))
    used = [item for item in iterated.passes if not item.empty]
    stiffness = sum(float(values @ values) for values in (item.stiffness_term[item.inside] for item in used))
    total_power = sum(float(values @ values) for values in (item.difference[item.inside] for item in used))
    stiffness_scale_std = TRACK.ratio_prior_std * np.sqrt(stiffness / total_power) if total_power > 0.0 else 0.0
    return float(std), float(np.hypot(scale, stiffness_scale_std))


def position_std(iterated: IterationResult) -> dict[Journey, float]:
    """Return the std of each journey's offset, m, by alignment slope and residuals; inf where no pass is usable."""
    panel, solution = iterated.panel, iterated.solution
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.grid.step)
    weight = panel.grid.step / TRACK.correlated_length / max(iterated.noise, 1e-9) ** 2
    information = {
        journey: weight * sum(float(np.sum(slope[item.used_points] ** 2)) for item in one.passes if not item.empty)
        for journey, one in iterated.placed.items()
    }
    return {journey: one**-0.5 if one > 0.0 else float("inf") for journey, one in information.items()}


def shrunk(iterated: IterationResult) -> Mapping[Journey, Correction]:
    """Return the corrections of journeys, each shrunk by how well it is known beside the reported position."""
    corrections = {}
    for journey, std in position_std(iterated).items():
        share = TRACK.reported_position_std**2 / (TRACK.reported_position_std**2 + std**2)
        correction = iterated.corrections[journey]
        corrections[journey] = replace(correction, offset=share * correction.offset, scale=share * correction.scale)
    return corrections


def place_alone(
    section: TrackSectionRecord,
    grouped: Grouped,
    alignment: TrackAlignment,
    parameters: SectionParameters,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> dict[Journey, Correction]:
    """Return where each journey was on an alignment, regardless of others; journeys without a place are left out.

    Returns nothing where the gauge is known to vary: that needs the wheel functions of all wheelsets.
    """
    panel = Panel.of(replace(parameters.panel, length=section.length_m), measured)
    prior = prior_on_grid(alignment, panel.grid, parameters.panel.cutoff_wavelength)
    if not prior.has_alignment or (prior.gauge_known and prior.gauge.any()):
        return {}
    places = {}
    for journey, members in grouped.items():
        this_journey: Grouped = {journey: members}
        setting = Setting(this_journey, prior, anchored=True, parameters=parameters.iteration)
        start = correlate_positions(this_journey, panel.grid, parameters.positions, prior.alignment)
        iterated = first_rounds(setting, panel, start, std=False)
        if iterated.moved < parameters.iteration.position_tolerance:
            places[journey] = shrunk(iterated)[journey] if prior.surveyed else iterated.corrections[journey]
    return places
