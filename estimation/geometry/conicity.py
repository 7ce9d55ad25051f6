"""Equivalent conicity, nonlinearity and zero crossing of an estimated rolling radius difference, with intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.intervals import jackknife_std, with_interval
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode

FEWEST_NODES = 5
FEWEST_GROUPS = 4
LEAST_AMPLITUDE = 0.25e-3  # m
REACH = 0.25e-3  # m of amplitude
NO_AMPLITUDE = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "no amplitude is covered")
NO_OFFSET = Reason(ReasonCode.OFFSET_NOT_OBSERVABLE, "band-limited signals carry no offset")
NO_ZERO = Reason(ReasonCode.NO_ZERO_CROSSING, "rL - rR has no zero in the range covered")
INDEPENDENT = 0.8  # share of what is systematic at one end of NP that is not at the other


@dataclass(frozen=True, slots=True)
class CurveParameters:
    """At which amplitudes the conicity is published; EN 15302 quotes 3 mm, and 2 and 4 mm for NP."""

    amplitudes: tuple[float, ...] = tuple(float(a) for a in np.arange(2, 25) * 0.25e-3)  # m
    reference_amplitude: float = 3.0e-3  # m
    nonlinearity_low: float = 2.0e-3  # m
    nonlinearity_high: float = 4.0e-3  # m


@dataclass(frozen=True, slots=True)
class CurveReplicates:
    """An estimated curve rL - rR over bin centres, with what its uncertainty needs."""

    edges: FloatArray  # (b + 1,) m
    difference: FloatArray  # (1 + g, b, 3) m: value, slope, curvature over u; from all data, then each group left out
    sensitivity: FloatArray  # (b, k, 3) m: the same per standard deviation of each uncertain parameter
    usable: BoolArray  # (b,)
    error: DisplacementError
    count: float  # windows
    band_limited: bool


@dataclass(frozen=True, slots=True)
class CurveEstimates:
    """What is published of the curve."""

    amplitude: FloatArray  # (a,) m
    conicity: tuple[Estimate, ...]  # (a,)
    reported_amplitude: float
    at_reference: Estimate
    nonlinearity: Estimate
    zero_crossing: Estimate


_Row = tuple[FloatArray, FloatArray]  # displacement (k,), rolling radius difference (k,)


def curve_estimates(curve: CurveReplicates, parameters: CurveParameters) -> CurveEstimates:
    """Return conicity by amplitude, NP (1/mm) and the zero crossing, each with its interval or its reason.

    Parameters
    ----------
    curve
        rL - rR over the bins, with its replicates and systematic errors.
    parameters
        Amplitudes, m, at which the conicity is published.
    """
    amplitude = np.array(parameters.amplitudes)
    run = _run_around_zero(curve)
    groups = len(curve.difference) - 1
    if run is None or groups < FEWEST_GROUPS:
        unknown = Estimate.unknown(_too_little(groups), curve.count)
        return CurveEstimates(
            amplitude, (unknown,) * len(amplitude), parameters.reference_amplitude, unknown, unknown, unknown
        )
    rows = _rows(curve, run)
    values = np.stack([equivalent_conicity(x, difference, amplitude) for x, difference in rows])
    rounded = values[:1] + _rounding(rows[0], amplitude, curve.error.resolution(float(np.diff(curve.edges[:2])[0])))
    values = np.concatenate([values, rounded])
    conicity = tuple(_estimate(values[:, k], groups, curve.count, not_covered(a)) for k, a in enumerate(amplitude))
    at_reference, reported_amplitude = at_reference_amplitude(amplitude, conicity, parameters)
    nonlinearity = _nonlinearity(amplitude, values, groups, curve.count, parameters)
    crossing = _zero_crossing(rows, curve, groups)
    return CurveEstimates(amplitude, conicity, reported_amplitude, at_reference, nonlinearity, crossing)


def not_covered(amplitude: float) -> Reason:
    """Return that the bins do not reach an amplitude.

    Parameters
    ----------
    amplitude
        In m.
    """
    return Reason(ReasonCode.AMPLITUDE_NOT_COVERED, f"amplitude {1e3 * amplitude:g} mm is not covered")


def too_few_blocks(groups: int) -> Reason:
    """Return that there are too few blocks of running time for an interval.

    Parameters
    ----------
    groups
        How many there are.
    """
    return Reason(ReasonCode.TOO_FEW_BLOCKS, f"{groups} blocks of data, {FEWEST_GROUPS} are needed")


def _too_little(groups: int) -> Reason:
    if groups < FEWEST_GROUPS:
        return too_few_blocks(groups)
    return Reason(ReasonCode.TOO_FEW_BINS, "too few bins around the centre have samples")


def _nonlinearity(
    amplitude: FloatArray, values: FloatArray, groups: int, count: float, parameters: CurveParameters
) -> Estimate:
    """Return NP, 1/mm, from the conicity rows (r, a) at its two amplitudes.

    What is systematic at the two amplitudes is taken as mostly independent.
    """
    ends = (parameters.nonlinearity_low, parameters.nonlinearity_high)
    low, high = (values[:, int(np.argmin(np.abs(amplitude - a)))] for a in ends)
    per_mm = 1.0 / (1e3 * (ends[1] - ends[0]))
    far = slice(groups + 1, None)
    systematic = INDEPENDENT * np.concatenate([high[far] - high[0], low[far] - low[0]])
    both = np.concatenate([(high - low)[: groups + 1], high[0] - low[0] + systematic])
    return _estimate(per_mm * both, groups, count, not_covered(ends[1]))


def _rounding(row: _Row, amplitude: FloatArray, resolution: float) -> FloatArray:
    """Return what rounding over ``resolution`` (m) changes of the conicity (a,), from its bend over amplitude.

    Where a contact jump is inside a bin, bins cannot show; the conicity just above it depends on that. A resolution
    beyond ``REACH`` has rounded the bend itself, and moved where it shows: the largest within it counts.
    """
    x, difference = row
    reach = max(resolution, REACH)

    def bend(shift: float) -> FloatArray:
        below, here, above = (
            equivalent_conicity(x, difference, np.maximum(amplitude + shift + at, LEAST_AMPLITUDE))
            for at in (-reach, 0.0, reach)
        )
        return np.nan_to_num(0.5 * (below - 2 * here + above) * (min(resolution, REACH) / REACH) ** 2)

    if resolution <= REACH:
        return bend(0.0)
    return np.asarray(np.max(np.abs([bend(shift) for shift in (-0.5 * reach, 0.0, 0.5 * reach)]), axis=0))


def _run_around_zero(curve: CurveReplicates) -> BoolArray | None:
    """Return the unbroken run of usable bins that holds the bin nearest to zero displacement."""
    usable = curve.usable & np.isfinite(curve.difference).all(axis=(0, 2))
    centre = int(np.argmin(np.abs(curve.edges[:-1] + curve.edges[1:])))
    if not usable[centre]:
        return None
    left = centre - int(np.argmin(np.append(usable[centre::-1], False)))
    right = centre + int(np.argmin(np.append(usable[centre:], False)))
    run = np.zeros(len(usable), dtype=np.bool_)
    run[left + 1 : right] = True
    return run if run.sum() >= FEWEST_NODES else None


def _rows(curve: CurveReplicates, run: BoolArray) -> list[_Row]:
    """Return the curve from all data, with each group left out, then shifted by each systematic uncertainty.

    The error of the displacement (std e) flattens the curve: a large measured displacement is too large on average,
    by the factor 1/(1 - e^2/var). That is taken back; as much as was taken back stands for what remains unknown. So
    do a scale error, the rounding of kinks by e, and the difference between bins that bend and straight lines
    between their centres.
    """
    excess = curve.error.excess
    low, high = curve.edges[:-1][run], curve.edges[1:][run]
    at = _nodes(low, high)
    x = (1 - excess) * at
    values = [_evaluate(shape[run]) for shape in curve.difference]
    shifted = [values[0] + _evaluate(curve.sensitivity[run, k]) for k in range(curve.sensitivity.shape[1])]
    coarse = np.interp(at, 0.5 * (low + high), curve.difference[0, run, 0])
    rounded = curve.error.rounded(x, values[0])
    stretched = ((1 + curve.error.scale) * x, values[0])
    return [*((x, row) for row in (*values, *shifted)), (at, values[0]), stretched, (x, rounded), (x, coarse)]


def _nodes(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return edges and centres of adjoining bins, ascending: (2 b + 1,)."""
    return np.append(np.column_stack([low, 0.5 * (low + high)]).ravel(), high[-1])


def _evaluate(shape: FloatArray) -> FloatArray:
    """Return the locally quadratic curve (b, 3) at the nodes; at an edge between two bins the mean of both."""
    value, slope, curvature = shape.T
    at_low, at_high = value - slope / 2 + curvature / 4, value + slope / 2 + curvature / 4
    edge = at_low.copy()
    edge[1:] = 0.5 * (at_low[1:] + at_high[:-1])
    return np.append(np.column_stack([edge, value]).ravel(), at_high[-1])


def _estimate(values: FloatArray, groups: int, count: float, reason: Reason) -> Estimate:
    """One number from its rows: all data, then each group left out, then one row a systematic uncertainty."""
    if not np.isfinite(values).all():
        return Estimate.unknown(reason, count)
    jackknife = float(jackknife_std(values[: groups + 1]))
    systematic = float(np.sqrt(((values[groups + 1 :] - values[0]) ** 2).sum()))
    return with_interval(float(values[0]), jackknife, systematic, groups, count)


def at_reference_amplitude(
    amplitude: FloatArray, conicity: tuple[Estimate, ...], parameters: CurveParameters
) -> tuple[Estimate, float]:
    """Return the conicity at the reference amplitude, or at the largest covered below it.

    Parameters
    ----------
    amplitude
        (a,) m.
    conicity
        (a,) the estimate at each amplitude.
    parameters
        The reference amplitude.
    """
    for a, value in sorted(zip(amplitude, conicity, strict=True), key=lambda pair: -pair[0]):
        if a <= parameters.reference_amplitude + 1e-9 and value.value is not None:
            return value, float(a)
    return Estimate.unknown(NO_AMPLITUDE, conicity[0].count), parameters.reference_amplitude


def _zero_crossing(rows: list[_Row], curve: CurveReplicates, groups: int) -> Estimate:
    if curve.band_limited:
        return Estimate.unknown(NO_OFFSET, curve.count)
    values = np.array([zero_crossing(x, difference) for x, difference in rows])
    return _estimate(values, groups, curve.count, NO_ZERO)
