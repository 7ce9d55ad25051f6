"""The alignment that follows from a survey and the passes of an epoch: the mean of both, by place and band.

In each band of wavelengths the passes give the mean of y - h(R) with a variance from the scatter between journeys
(``docs/decisions/survey-and-passes.md``). What both differ by has two parts. One follows the motion of the wheelsets:
an error of the passes' curves and equations, which is taken off them. The rest is the survey's own error, less the
passes' noise; so its standard deviation is learnt, whatever is on file. Where both differ by more than elsewhere, at
switches or where a stretch has been tamped, neither is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.filters import between_known, high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import Placed, SectionGrid
from estimation.track.iteration import IterationResult
from estimation.track.panel.basis import Panel, unfiltered_residual
from estimation.track.panel.instrumental_slope import error_of_difference
from estimation.track.panel.solution import PanelSolution
from estimation.track.parameters import TRACK
from estimation.track.results import findings, position_std
from estimation.track.settings import SectionParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import TrackAlignment


@dataclass(frozen=True, slots=True)
class Band:
    """Survey and passes in one band; (n,) each on the grid of the section."""

    survey: FloatArray  # m
    passes: FloatArray  # m, zero where none
    survey_variance: FloatArray  # m2, learnt
    passes_variance: FloatArray  # m2, inf where there is none
    coherent: float  # m, rms of what followed the motion, before it was taken off

    @property
    def share(self) -> FloatArray:
        """Share of the passes (n,) in the mean of both, each by its variance."""
        known = np.isfinite(self.passes_variance)
        whole = self.survey_variance + np.where(known, self.passes_variance, 1.0)
        return np.where(known, self.survey_variance / np.maximum(whole, 1e-30), 0.0)

    @property
    def posterior(self) -> FloatArray:
        """Mean of both (n,), m."""
        return np.asarray(self.survey + self.share * (self.passes - self.survey))

    @property
    def variance(self) -> FloatArray:
        """Variance of that mean (n,), m2."""
        return np.asarray((1.0 - self.share) * self.survey_variance)


@dataclass(frozen=True, slots=True)
class SurveyBands:
    """Survey and passes in all bands, and what of the survey is longer."""

    bands: tuple[Band, ...]
    long_waves: FloatArray  # (n,) m, of the survey, longer than the longest band
    known: BoolArray  # (n,) where the survey is known
    compared: BoolArray  # (n,) where both are, in the shortest waves
    passes: FloatArray  # (n,) sum of their weights, in the shortest waves
    curves: float  # m, rms of the displacement y - d by the curves, which a scale error of them multiplies

    @property
    def survey_std(self) -> float:
        """Std that the passes show of the survey, m."""
        return float(np.sqrt(np.median(total_variance([band.survey_variance for band in self.bands]))))

    def coherent_std(self, longest: float) -> float:
        """Return the rms, m, of what followed the motion at wavelengths up to ``longest`` m."""
        return float(np.sqrt(total_variance([np.array([band.coherent**2]) for band in self.up_to(longest)])[0]))

    def posterior_std(self, longest: float) -> FloatArray:
        """Return the std (n,), m, of the mean of survey and passes at wavelengths up to ``longest`` m."""
        return np.sqrt(total_variance([band.variance for band in self.up_to(longest)]))

    def up_to(self, longest: float) -> tuple[Band, ...]:
        """Return the bands of wavelengths up to ``longest`` m."""
        return tuple(band for band, edge in zip(self.bands, TRACK.band_edges, strict=True) if edge <= longest)


def survey_bands(
    iterated: IterationResult, survey: TrackAlignment, systematic: float, parameters: SectionParameters
) -> SurveyBands | None:
    """Return what a survey and the passes on it say by band; None where they do not meet. ``systematic``: std, m."""
    grid = iterated.panel.grid
    on_grid, std, known = survey_on_grid(survey, grid)
    kernels = [local_cubic_kernel(edge, grid.step) for edge in TRACK.band_edges]
    passes = _passes(iterated.placed, iterated.solution, iterated.panel, kernels)
    inside = np.stack([valid_support(known, kernel) for kernel in kernels])
    compared = inside & (passes.journeys > 0)
    if np.count_nonzero(compared[0]) * grid.step < 2.0 * parameters.local_length:
        return None
    filtered = _bands_of(on_grid, kernels)
    filed = float(np.sqrt(np.mean(std[known] ** 2)))
    unexplained = 1.0 if iterated.slope is None else 1.0 - iterated.slope.explained
    size = np.array([np.sqrt(np.mean(h[where] ** 2)) for h, where in zip(passes.curves, compared, strict=True)])
    common = np.hypot(systematic / np.sqrt(len(TRACK.band_edges)), parameters.curve_share_factor * unexplained * size)
    bands = [
        _band(number, d, passes, compared[number], filed, float(common[number]), grid.step, parameters)
        for number, d in enumerate(filtered)
    ]
    whole = passes.curves.sum(axis=0)[compared[0]]
    return SurveyBands(
        bands=tuple(bands),
        long_waves=on_grid - filtered.sum(axis=0),
        known=known,
        compared=compared[-1],
        passes=passes.count[-1],
        curves=float(np.sqrt(np.mean(whole**2))),
    )


def survey_on_grid(survey: TrackAlignment, grid: SectionGrid) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return a survey on the grid of the section, averaged over its step: alignment, std (n,), m, and where known."""
    certain = np.isfinite(survey.alignment) & np.isfinite(survey.alignment_std)
    step = float(survey.s[1] - survey.s[0])
    width = 2 * (round(grid.step / step) // 2) + 1  # odd: nothing is moved
    d = uniform_filter1d(np.where(certain, survey.alignment, 0.0), width, mode="nearest")
    known = between_known(grid.s, survey.s, certain)
    std = np.interp(grid.s, survey.s, np.where(certain, survey.alignment_std, 0.0))
    return np.where(known, np.interp(grid.s, survey.s, d), 0.0), std, known


@dataclass(frozen=True, slots=True)
class _Passes:
    mean: FloatArray  # y - h(R), m
    displacement: FloatArray  # y, m
    curves: FloatArray  # h(R), m
    count: FloatArray  # sum of their weights
    journeys: FloatArray
    variance: FloatArray  # (b,) m2, of one journey


def _bands_of(signals: FloatArray, kernels: Sequence[FloatArray]) -> FloatArray:
    passed = [high_pass(signals, kernel) for kernel in kernels]
    return np.stack([*(longer - shorter for longer, shorter in pairwise(passed)), passed[-1]])


def _passes(placed: Placed, solution: PanelSolution, panel: Panel, kernels: Sequence[FloatArray]) -> _Passes:
    shape = (len(kernels), panel.grid.points)
    total, (count, journeys, squares, crossed, counted) = np.zeros((2, *shape)), np.zeros((5, *shape))
    for where in placed.values():
        summed, passed = np.zeros((2, *shape)), np.zeros(shape)
        for item, curve in solution.used(where.passes):
            signals = np.stack([unfiltered_residual(item, curve, panel), item.displacement])
            weight, on = panel.weight_of(item.life), panel.grid.contains(item.points)
            for number, (band, kernel) in enumerate(zip(_bands_of(signals, kernels), kernels, strict=True)):
                inside = valid_support(item.certain, kernel) & on
                points = item.points[inside]
                summed[:, number, points] += weight * band[:, inside]
                passed[number, points] += weight
        total, count, journeys = total + summed, count + passed, journeys + (passed > 0)
        squares += summed[0] ** 2
        crossed += passed * summed[0]
        counted += passed**2
    mean, displacement = total / np.where(count > 0.0, count, 1.0)
    several = journeys > 1
    scatter = np.where(several, squares - 2.0 * mean * crossed + mean**2 * counted, 0.0)
    of_journey = scatter / np.maximum(count, 1e-9) ** 2 * journeys**2 / np.maximum(journeys - 1.0, 1.0)
    places = several.sum(axis=1)  # one journey shows nothing of its own errors
    variance = np.where(places > 0, of_journey.sum(axis=1) / np.maximum(places, 1), np.inf)
    return _Passes(mean, displacement, displacement - mean, count, journeys, variance)


def _band(
    number: int,
    survey: FloatArray,
    passes: _Passes,
    compared: BoolArray,
    filed: float,
    systematic: float,
    step: float,
    parameters: SectionParameters,
) -> Band:
    shortest = (*TRACK.band_edges, parameters.shortest_wavelength)[number + 1]
    length = 0.5 * np.sqrt(TRACK.band_edges[number] * shortest)  # m, of an independent sample
    independent = max(np.count_nonzero(compared) * step / length, 1.0)
    rest = np.where(compared, survey - passes.mean[number], 0.0)
    fit, coherent, by_chance = _coherent(rest, passes, number, compared, independent)
    rest = np.where(compared, rest - fit, 0.0)
    square = float(np.mean(rest[compared] ** 2))
    noise = np.full(len(survey), np.inf)
    noise[compared] = passes.variance[number] / passes.journeys[number, compared]
    # errors on file are white down to the shortest wavelength
    longest, last = TRACK.band_edges, parameters.shortest_wavelength
    of_file = filed**2 * ((1.0 / shortest - 1.0 / longest[number]) / (1.0 / last - 1.0 / longest[0]))
    if not np.isfinite(passes.variance[number]):
        noise[compared] = square + of_file
    noise += systematic**2
    learnt = _learnt(square, float(np.mean(noise[compared])), systematic, of_file, independent, parameters)
    excess = _local_excess(rest, compared, square, length, step, parameters)
    return Band(
        survey=survey,
        passes=np.where(compared, passes.mean[number] + fit, 0.0),
        survey_variance=learnt + excess,
        passes_variance=noise + by_chance + excess,
        coherent=coherent,
    )


def _learnt(
    square: float,
    of_passes: float,
    systematic: float,
    of_file: float,
    independent: float,
    parameters: SectionParameters,
) -> float:
    """Return the variance, m2, of a survey in a band: what passes leave of their difference, and what is on file."""
    # where errors that all passes may have in common explain the difference, the passes say nothing but that it is all
    of_survey = square - of_passes
    trust = (of_survey / (of_survey + systematic**2)) ** 2 if of_survey > 0.0 else 0.0
    samples = trust * independent
    filed = min(of_file, square)
    return (samples * max(of_survey, 0.0) + parameters.filed_samples * filed) / (samples + parameters.filed_samples)


def _coherent(
    rest: FloatArray, passes: _Passes, number: int, compared: BoolArray, independent: float
) -> tuple[FloatArray, float, float]:
    """Return what of a difference (n,), m, follows the motion, its rms, m, and the variance, m2, that is left of it."""
    # it is regressed on displacement and curves and on what both are a quarter of a wave later; as far as that explains
    # more than chance, it is the passes' error
    signals = [passes.displacement[number], passes.curves[number]]
    design = np.stack([part for signal in signals for part in (signal, np.gradient(signal))])
    inside = design[:, compared]
    size = np.maximum(np.sqrt(np.mean(inside**2, axis=1)), 1e-30)
    normal = (inside / size[:, None]) @ (inside / size[:, None]).T
    normal += 1e-6 * np.trace(normal) / len(normal) * np.eye(len(normal))
    fit = (np.linalg.solve(normal, (inside / size[:, None]) @ rest[compared]) / size) @ design
    explained = float(np.mean(fit[compared] ** 2))
    by_chance = len(design) * float(np.mean((rest - fit)[compared] ** 2)) / independent
    share = max(explained - by_chance, 0.0) / explained if explained > 0.0 else 0.0
    return np.where(compared, share * fit, 0.0), float(np.sqrt(share * explained)), share * by_chance


def _local_excess(
    rest: FloatArray, compared: BoolArray, square: float, length: float, step: float, parameters: SectionParameters
) -> FloatArray:
    """Return by how much (n,), m2, both differ more than elsewhere, where that is more than chance."""
    width = max(round(parameters.local_length / step), 1)
    weight = uniform_filter1d(compared.astype(np.float64), width, mode="constant")
    local = uniform_filter1d(rest**2, width, mode="constant") / np.maximum(weight, 1e-9)
    chance = parameters.local_stds * np.sqrt(2.0 * length / parameters.local_length)
    return np.where(compared & (local > (1.0 + chance) * square), local - square, 0.0)


def total_variance(variances: Sequence[FloatArray]) -> FloatArray:
    """Return the variance (n,) of the sum of neighbouring bands, whose filters overlap, from those of each (n,)."""
    stds = np.sqrt(np.stack(variances))
    count = len(stds)
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    of_distance = np.zeros(max(count, 3))
    of_distance[:3] = 1.0, TRACK.neighbour_correlation, TRACK.second_neighbour_correlation
    correlation = of_distance[apart]
    return np.asarray(np.einsum("in,ij,jn->n", stds, correlation, stds))


STATED = TRACK.band_edges[1]  # m, longest wavelength of the published std: longer ones are not in the motion


@dataclass(frozen=True, slots=True)
class SurveyPosterior:
    """The alignment, the survey as it was on the same grid, and what both rest on."""

    alignment: TrackAlignment
    before: TrackAlignment
    bands: SurveyBands

    @property
    def in_motion(self) -> FloatArray:
        """The survey (n,), m, with what differs in the waves that the published std is of."""
        changed = np.sum([band.posterior - band.survey for band in self.bands.up_to(STATED)], axis=0)
        return np.asarray(self.before.alignment + changed)

    @property
    def std_factor(self) -> float:
        """Std of the survey that the passes show, over that on file."""
        filed = float(np.median(self.before.alignment_std[self.bands.known]))
        return self.bands.survey_std / max(filed, 1e-9)


def survey_posterior(
    iterated: IterationResult, survey: TrackAlignment, parameters: SectionParameters
) -> SurveyPosterior | None:
    """Return what a survey, with the std on file, and the passes on it give together; None where they do not meet."""
    grid, p = iterated.panel.grid, parameters
    of_gauge = p.systematic_per_gauge[0] * float(np.std(survey.gauge_deviation))
    bands = survey_bands(iterated, survey, float(np.hypot(p.systematic, of_gauge)), parameters)
    if bands is None:
        return None
    on_grid, filed, known = survey_on_grid(survey, grid)
    nothing = np.where(known, 0.0, np.nan)
    gauge = np.interp(grid.s, survey.s, survey.gauge_deviation)
    gauge_std = np.interp(grid.s, survey.s, survey.gauge_deviation_std)
    passes = np.interp(grid.s, survey.s, survey.passes.astype(np.float64))
    before = replace(
        survey,
        s=grid.s,
        alignment=on_grid + nothing,
        alignment_std=filed + nothing,
        gauge_deviation=gauge,
        gauge_deviation_std=gauge_std,
        passes=np.rint(passes).astype(np.int64),
    )
    d = bands.long_waves + np.sum([band.posterior for band in bands.bands], axis=0)
    positions = [place_std for place_std in position_std(iterated).values() if np.isfinite(place_std)]
    of_positions = np.abs(np.gradient(d, grid.step)) * (float(np.median(positions)) if positions else 0.0)
    std = np.hypot(bands.posterior_std(STATED), of_positions)
    ratios_known = error_of_difference(iterated.ratios, iterated.passes) <= parameters.most_difference_error
    after = replace(
        before,
        version=0,
        alignment=d + nothing,
        alignment_std=std + nothing,
        passes=before.passes + np.rint(bands.passes).astype(np.int64),
        scale_std=_scale_std(bands, iterated, survey, p),
        findings=findings(iterated, gauge_estimated=False)[0] if ratios_known else survey.findings,
    )
    return SurveyPosterior(after, before, bands)


def _scale_std(bands: SurveyBands, iterated: IterationResult, survey: TrackAlignment, p: SectionParameters) -> float:
    """Return the relative std of a common scale of y - d: of the curves, as far as the alignment is the passes'."""
    # the survey, an alignment without their errors, fixes that scale as well as its own errors average out
    slope_std = 0.0 if iterated.slope is None else iterated.slope.std
    of_passes = float(np.hypot(p.scale_error, slope_std))
    independent = max(np.count_nonzero(bands.compared) * iterated.panel.grid.step / p.survey_error_length, 1.0)
    of_survey = bands.survey_std / max(bands.curves, 1e-9) / np.sqrt(independent)
    both = of_passes * of_survey / float(np.hypot(of_passes, of_survey))
    weights = np.array([np.mean(band.passes[bands.compared] ** 2) for band in bands.bands])
    share = np.array([np.mean(band.share[bands.compared]) for band in bands.bands])
    of_all = float(weights @ share / weights.sum()) if weights.sum() > 0.0 else 0.0
    return float(np.hypot(of_all * both, (1.0 - of_all) * survey.scale_std))
