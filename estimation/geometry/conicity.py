"""Equivalent conicity, nonlinearity and zero crossing of an estimated rolling radius difference, with intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from estimation.contact.conicity import equivalent_conicity, middle_of_travel, zero_crossing
from estimation.geometry.parameters import PRIORS
from estimation.geometry.sharpening import (
    FREE,
    ContactRoll,
    Sharpening,
    edges_and_centres,
    held_difference_std,
    jumps_displaced,
    moved_off,
    nodes_of,
    rms_change,
    sharpen,
    standard_curve,
)
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.error_parts import ErrorSource, error_effects
from estimation.values.geometry import Centre, CentreOrigin
from estimation.values.quantities import Estimate, jackknife_std, normal_equivalent, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import NORMAL_95

NO_AMPLITUDE = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "no amplitude is covered")
NO_OFFSET = Reason(ReasonCode.OFFSET_NOT_OBSERVABLE, "band-limited signals carry no offset")
NO_ZERO = Reason(ReasonCode.NO_ZERO_CROSSING, "rL - rR has no zero in the range covered")


@dataclass(frozen=True, slots=True)
class CurveParameters:
    """At which amplitudes the conicity is published; EN 15302 quotes 3 mm, and 2 and 4 mm for NP."""

    amplitudes: tuple[float, ...] = tuple(float(a) for a in np.arange(2, 25) * 0.25e-3)  # m
    reference_amplitude: float = 3.0e-3  # m
    nonlinearity_low: float = 2.0e-3  # m
    nonlinearity_high: float = 4.0e-3  # m
    fewest_nodes: int = 5
    largest_share: float = 0.25  # or relative to the conicity: one of 0.57 within 0.28 may be far over its limit
    blur_share: float = 0.3  # share of the change by sharpening that stays uncertain
    slow_std: float = 0.1e-3  # m, of what the high-pass takes from y - d: the slow motion of the wheelset itself
    even_share: float = 0.15  # share of the even part of R that the high-pass takes
    even_reach: float = 3e-3  # m of y - d: wheelsets hardly run further
    even_points: int = 61
    independent_share: float = 0.8  # correlation left out: share of a systematic error at 2 mm that is not at 4 mm


_Row = tuple[FloatArray, FloatArray]  # displacement (k,), rolling radius difference (k,)


@dataclass(frozen=True, slots=True)
class CurveReplicates:
    """An estimated curve rL - rR over bin centres, and the inputs of its uncertainty."""

    edges: FloatArray  # (b + 1,) m
    difference: FloatArray  # (1 + g, b, 3) m: value, slope, curvature over u; from all data, then each group left out
    sensitivity: FloatArray  # (b, k, 3) m: the same per standard deviation of each uncertain parameter
    usable: BoolArray  # (b,)
    error: DisplacementError
    count: float  # windows
    band_limited: bool
    held_shares: tuple[float, ...] = FREE  # for the std of the mean of R by unequal diameters
    contact_roll: ContactRoll | None = None  # in the displacement; None where that needs nothing more
    sources: tuple[ErrorSource, ...] = ()  # (k,) of the sensitivities; where none are named, that of the scale

    def row(self, x: FloatArray, difference: FloatArray) -> _Row:
        """Return displacement and R (n,), m, as EN 15302 means them."""
        return (x, difference) if self.contact_roll is None else standard_curve(x, difference, self.contact_roll)


@dataclass(frozen=True, slots=True)
class CurveEstimates:
    """Published estimates of the curve."""

    amplitude: FloatArray  # (a,) m
    conicity: tuple[Estimate, ...]  # (a,)
    reported_amplitude: float
    at_reference: Estimate
    nonlinearity: Estimate
    zero_crossing: Estimate
    centre: Centre | None = None
    # of the error of the conicity: (p,) sources, and (p, a) changes per std
    parts: tuple[tuple[ErrorSource, ...], FloatArray] = ((), np.zeros((0, 0)))


_OF_DISPLACEMENT = (ErrorSource.ALIGNMENT, ErrorSource.BLUR, ErrorSource.STRETCH, ErrorSource.JUMP_PLACE)
_OF_OFFSETS = (ErrorSource.EVEN_PART, ErrorSource.DIAMETERS)


def curve_estimates(curve: CurveReplicates, parameters: CurveParameters) -> CurveEstimates:
    """Return conicity by amplitude, NP (1/mm) and the zero crossing, each with its interval or its reason."""
    amplitude = np.array(parameters.amplitudes)
    run = _run_around_zero(curve, parameters)
    groups = len(curve.difference) - 1
    if run is None or groups < PRIORS.fewest_groups:
        few_bins = Reason(ReasonCode.TOO_FEW_BINS, "too few bins around the centre have samples")
        unknown = Estimate.unknown(too_few_blocks(groups) if groups < PRIORS.fewest_groups else few_bins, curve.count)
        return CurveEstimates(
            amplitude, (unknown,) * len(amplitude), parameters.reference_amplitude, unknown, unknown, unknown
        )
    rows, values = _rows(curve, run, amplitude, parameters)
    conicity = tuple(_conicity(values[:, k], groups, curve.count, a, parameters) for k, a in enumerate(amplitude))
    at_reference, reported_amplitude = at_reference_amplitude(amplitude, conicity, parameters)
    nonlinearity = _nonlinearity(amplitude, values, groups, curve.count, parameters)
    crossing = Estimate.unknown(NO_OFFSET, curve.count)
    if not curve.band_limited:
        crossing = estimate_of(np.array([zero_crossing(*row) for row in rows]), groups, curve.count, NO_ZERO)
    centre = None if at_reference.value is None else _centre(rows[0], curve, reported_amplitude, at_reference.value)
    parts = _parts(curve, values, groups)
    return CurveEstimates(amplitude, conicity, reported_amplitude, at_reference, nonlinearity, crossing, centre, parts)


def _parts(curve: CurveReplicates, values: FloatArray, groups: int) -> tuple[tuple[ErrorSource, ...], FloatArray]:
    """Return what the error of the conicity is made of, from its rows (1 + g + p, a)."""
    sampling = normal_equivalent(jackknife_std(values[: groups + 1]), groups)
    of_parameters = curve.sources or (ErrorSource.SCALE,) * curve.sensitivity.shape[1]
    sources = (ErrorSource.SAMPLING, *of_parameters, *_OF_DISPLACEMENT, *_OF_OFFSETS)
    return error_effects(sources, np.vstack([sampling, values[groups + 1 :] - values[0]]))


def _centre(row: _Row, curve: CurveReplicates, amplitude: float, conicity: float) -> Centre:
    middle = middle_of_travel(*row, amplitude)
    if not curve.band_limited:
        return Centre(middle, 0.0, CentreOrigin.TRACK_CENTRE)
    held = held_difference_std(curve.held_shares, conicity)
    return Centre(middle, held / (2.0 * conicity) if conicity > 0.0 else 0.0, CentreOrigin.MEAN_RUNNING_POSITION)


def not_covered(amplitude: float) -> Reason:
    """Return the reason that the bins do not reach an amplitude."""
    return Reason(ReasonCode.AMPLITUDE_NOT_COVERED, f"amplitude {1e3 * amplitude:g} mm is not covered")


def too_few_blocks(groups: int) -> Reason:
    """Return the reason that there are too few blocks of running time for an interval."""
    return Reason(ReasonCode.TOO_FEW_BLOCKS, f"{groups} blocks of data, {PRIORS.fewest_groups} are needed")


def _nonlinearity(
    amplitude: FloatArray, values: FloatArray, groups: int, count: float, parameters: CurveParameters
) -> Estimate:
    """Return NP, 1/mm, from the conicity rows (r, a) at its two amplitudes."""
    # systematic errors at the two amplitudes are taken as mostly independent
    ends = (parameters.nonlinearity_low, parameters.nonlinearity_high)
    low, high = (values[:, int(np.argmin(np.abs(amplitude - a)))] for a in ends)
    per_mm = 1.0 / (1e3 * (ends[1] - ends[0]))
    systematic_rows, share = slice(groups + 1, None), parameters.independent_share
    errors = share * np.concatenate([high[systematic_rows] - high[0], low[systematic_rows] - low[0]])
    differences = np.concatenate([high[: groups + 1] - low[: groups + 1], high[0] - low[0] + errors])
    return estimate_of(per_mm * differences, groups, count, not_covered(ends[1]))


def _run_around_zero(curve: CurveReplicates, parameters: CurveParameters) -> BoolArray | None:
    usable = curve.usable & np.isfinite(curve.difference).all(axis=(0, 2))
    centre = int(np.argmin(np.abs(curve.edges[:-1] + curve.edges[1:])))
    if not usable[centre]:
        return None
    run = np.zeros(len(usable), dtype=np.bool_)
    run[run_around(usable, centre)] = True
    return run if run.sum() >= parameters.fewest_nodes else None


def run_around(enough: BoolArray, centre: int) -> slice:
    """Return the unbroken run of (n,) on both sides of the begin of ``centre``; it ends there on a side with none."""
    behind = centre + int(np.argmin(np.append(enough[centre:], False)))
    return slice(centre - int(np.argmin(np.append(enough[:centre][::-1], False))), behind)


def _rows(
    curve: CurveReplicates, run: BoolArray, amplitude: FloatArray, parameters: CurveParameters
) -> tuple[list[_Row], FloatArray]:
    """Return the curves (1 + g + k + 2) and the conicities (1 + g + k + 6, a).

    Both are from all data, with each of g groups left out, and with each of k parameters changed. Of curves follow the
    one with its excess put back and the stretched one; of conicities, four displacement errors and two unseen offsets.
    The error of the displacement (std e) flattens the curve: a large measured displacement is too large on average,
    by the factor 1/(1 - e^2/var). That is taken back, as is the blur of contact jumps.
    """
    low, high = curve.edges[:-1][run], curve.edges[1:][run]
    nodes = np.stack([nodes_of(shape[run]) for shape in curve.difference])
    slow = parameters.slow_std if curve.band_limited else 0.0
    sharp = sharpen(low, high, nodes[0], jackknife_std(nodes), float(np.hypot(curve.error.blur, slow)))
    displacement = (1 - curve.error.excess) * sharp.displacement
    shifted = nodes[0] + nodes_of(np.moveaxis(curve.sensitivity[run], 1, -1)).T  # (k, m)
    rows = [curve.row(displacement, sharp.curve(node_values)) for node_values in (*nodes, *shifted)]
    conicity = np.stack([equivalent_conicity(*row, amplitude) for row in rows])
    known_blur = float(np.hypot(curve.error.std, slow))
    if curve.error.gauge_known:  # then all of the blur is there, also what the nodes did not allow to take away
        known_blur = float(np.hypot(known_blur, curve.error.jump_position_std))
        sharp = replace(sharp, left=max(sharp.left, math.sqrt(max(known_blur**2 - sharp.blur**2, 0.0))))
    unsharpened = (1 - curve.error.excess) * edges_and_centres(low, high)
    left_in = replace(curve.error, std=sharp.left).rounded(displacement, sharp.curve(nodes[0]))
    blurred = curve.row(unsharpened, nodes[0]), curve.row(displacement, left_in)
    displacement_changes = _systematic(curve.error, sharp, rows[0], blurred, amplitude, parameters, known_blur)
    offset_changes = np.zeros((2, len(amplitude)))
    if curve.band_limited:
        finite_conicities = conicity[0][np.isfinite(conicity[0])]
        std = held_difference_std(curve.held_shares, float(finite_conicities[-1])) if len(finite_conicities) else 0.0
        offset_changes[0] = _lost_to_filters(*rows[0], amplitude, parameters=parameters)
        if std > 0.0:  # an unknown difference of diameters
            offset_changes[1] = moved_off(*rows[0], amplitude, std)
    standard_displacement, difference = rows[0]
    stretched = ((1 + curve.error.scale) * standard_displacement, difference)
    conicities = np.concatenate([conicity, conicity[0] + displacement_changes, conicity[0] + offset_changes])
    return [*rows, (standard_displacement / (1 - curve.error.excess), difference), stretched], conicities


def _lost_to_filters(
    x: FloatArray, curve: FloatArray, amplitude: FloatArray, parameters: CurveParameters
) -> FloatArray:
    """Return by how much the high-pass changes the conicity (a,) where left and right wheel differ."""
    # the even part of R varies with the amplitude of the motion; the high-pass takes the slow part of that, which makes
    # an error of R of some share of it
    distance = np.linspace(0.0, min(-x[0], x[-1], parameters.even_reach), parameters.even_points)  # from the centre
    even_part = 0.5 * (np.interp(distance, x, curve) + np.interp(-distance, x, curve)) - np.interp(0.0, x, curve)
    return np.asarray(parameters.even_share * np.mean(np.abs(even_part)) / (2.0 * amplitude))


def _systematic(
    error: DisplacementError,
    sharp: Sharpening,
    row: _Row,
    blurred: tuple[_Row, _Row],
    amplitude: FloatArray,
    parameters: CurveParameters,
    known_blur: float,
) -> FloatArray:
    """Return by how much each systematic error of the displacement changes the conicity: (4, a)."""
    # The whole correction of the error stands for its uncertainty; ``blur_share`` of what sharpening changed stands for
    # the blur, the whole change where ``sharp.left`` > 0. How far jumps may be off goes by the blur beyond what the
    # error of y - d and the high-pass make (``known_blur``, m): that much the gauge varies. The stated gauge is no
    # measure of it, for whatever makes passes disagree is in it.
    x, curve = row
    here = equivalent_conicity(x, curve, amplitude)
    middle = zero_crossing(x, curve)
    jump = error.jump_place_std(math.sqrt(max(sharp.blur**2 - known_blur**2, 0.0)), sharp.left)

    covered = float(np.max(amplitude[np.isfinite(here)], initial=0.0))  # beyond, the conicity is as at its end

    def stretched(share: float) -> FloatArray:
        factor = 1.0 + share * error.scale
        if error.scale * NORMAL_95 >= 1.0:
            return np.full(len(here), np.inf)  # perhaps stretched to nothing: any conicity is possible
        if covered <= 0.0:
            return np.full(len(here), np.nan)
        return equivalent_conicity(x, curve, np.minimum(amplitude / factor, covered)) / factor

    def displaced(share: float) -> FloatArray:
        return equivalent_conicity(x, jumps_displaced(x, curve, middle, share * jump), amplitude)

    return np.stack(
        [
            equivalent_conicity(x / (1 - error.excess), curve, amplitude) - here,
            np.hypot(
                parameters.blur_share * (equivalent_conicity(*blurred[0], amplitude) - here),
                equivalent_conicity(*blurred[1], amplitude) - here,
            ),
            rms_change(stretched, here),
            rms_change(displaced, here) if np.isfinite(middle) else np.zeros(len(here)),
        ]
    )


def estimate_of(values: FloatArray, groups: int, count: float, reason: Reason) -> Estimate:
    """Return one number with its interval from replicates (1 + groups + p,): all, less groups, parameters shifted."""
    if not np.isfinite(values).all():
        return Estimate.unknown(reason, count)
    jackknife = float(jackknife_std(values[: groups + 1])) if groups else 0.0
    systematic = float(np.sqrt(((values[groups + 1 :] - values[0]) ** 2).sum()))
    return with_interval(float(values[0]), jackknife, systematic, max(groups, 2), count)


def _conicity(values: FloatArray, groups: int, count: float, amplitude: float, parameters: CurveParameters) -> Estimate:
    """Return the conicity at an amplitude (m) from its rows; unknown where its interval says nothing of a wheelset."""
    if np.isfinite(values[: groups + 1]).all() and np.isinf(values).any():
        text = f"the data leave the conicity at {1e3 * amplitude:g} mm open: the scale of y - d is not known"
        return Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, text), count)
    estimate = estimate_of(values, groups, count, not_covered(amplitude))
    if estimate.value is None or estimate.high is None or estimate.std is None:
        return estimate
    if estimate.std <= max(PRIORS.largest_conicity_std, parameters.largest_share * estimate.value):
        return estimate
    either_way = estimate.high - estimate.value
    text = f"the data leave the conicity at {1e3 * amplitude:g} mm open by {either_way:.2f} either way"
    return Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, text), count)


def at_reference_amplitude(
    amplitude: FloatArray, conicity: tuple[Estimate, ...], parameters: CurveParameters
) -> tuple[Estimate, float]:
    """Return the conicity at the reference amplitude, or at the largest covered below it."""
    for a, value in sorted(zip(amplitude, conicity, strict=True), key=lambda pair: -pair[0]):
        if a <= parameters.reference_amplitude + 1e-9 and value.value is not None:
            return value, float(a)
    reasons = (estimate.reason for estimate in conicity if estimate.reason is not None)
    reason = next((given for given in reasons if given.code is ReasonCode.CONICITY_OPEN), NO_AMPLITUDE)
    return Estimate.unknown(reason, conicity[0].count), parameters.reference_amplitude
