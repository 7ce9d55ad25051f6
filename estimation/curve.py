"""Equivalent conicity, nonlinearity and zero crossing of an estimated rolling radius difference, with intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import BoolArray, FloatArray
from estimation.contact.conicity import equivalent_conicity
from estimation.jackknife import jackknife_std, with_interval
from estimation.types import Estimate

FEWEST_NODES = 5
FEWEST_GROUPS = 4


@dataclass(frozen=True, slots=True)
class CurveParameters:
    """At which amplitudes the conicity is published; EN 15302 quotes 3 mm, and 2 and 4 mm for NP."""

    amplitudes: tuple[float, ...] = tuple(float(a) for a in np.arange(2, 25) * 0.25e-3)  # m
    headline: float = 3.0e-3  # m
    nonlinearity_low: float = 2.0e-3  # m
    nonlinearity_high: float = 4.0e-3  # m


@dataclass(frozen=True, slots=True)
class CurveReplicates:
    """An estimated curve rL - rR over bin centres, with what its uncertainty needs."""

    displacement: FloatArray  # (b,) m, bin centres
    difference: FloatArray  # (1 + g, b) m: from all data, then with each group left out
    sensitivity: FloatArray  # (b, k) m per standard deviation of an uncertain parameter
    usable: BoolArray  # (b,)
    count: float  # windows
    band_limited: bool


@dataclass(frozen=True, slots=True)
class CurveEstimates:
    """What is published of the curve."""

    amplitude: FloatArray  # (a,) m
    conicity: tuple[Estimate, ...]  # (a,)
    headline_amplitude: float
    headline: Estimate
    nonlinearity: Estimate
    zero_crossing: Estimate


def curve_estimates(curve: CurveReplicates, parameters: CurveParameters) -> CurveEstimates:
    """Return conicity by amplitude, NP (1/mm) and the zero crossing, each with its interval or its reason."""
    amplitude = np.array(parameters.amplitudes)
    run = _run_around_zero(curve)
    groups = len(curve.difference) - 1
    if run is None or groups < FEWEST_GROUPS:
        reason = f"{groups} blocks of data" if groups < FEWEST_GROUPS else "too few bins around the centre"
        unknown = Estimate.unknown(reason, curve.count)
        return CurveEstimates(amplitude, (unknown,) * len(amplitude), parameters.headline, unknown, unknown, unknown)
    x = curve.displacement[run]
    replicates = curve.difference[:, run]
    shifted = replicates[0] + curve.sensitivity[run].T
    values = _conicities(x, np.vstack([replicates, shifted]), amplitude)
    conicity = tuple(
        _estimate(values[:, k], groups, curve.count, f"amplitude {1e3 * a:g} mm is not covered")
        for k, a in enumerate(amplitude)
    )
    headline, headline_amplitude = _headline(amplitude, conicity, parameters)
    low, high = (
        values[:, int(np.argmin(np.abs(amplitude - a)))]
        for a in (parameters.nonlinearity_low, parameters.nonlinearity_high)
    )
    per_mm = 1e3 * (parameters.nonlinearity_high - parameters.nonlinearity_low)
    nonlinearity = _estimate(
        (high - low) / per_mm,
        groups,
        curve.count,
        f"amplitude {1e3 * parameters.nonlinearity_high:g} mm is not covered",
    )
    return CurveEstimates(
        amplitude, conicity, headline_amplitude, headline, nonlinearity, _zero_crossing(x, curve, run, groups)
    )


def _run_around_zero(curve: CurveReplicates) -> BoolArray | None:
    """Return the unbroken run of usable bins that holds the bin nearest to zero displacement."""
    usable = curve.usable & np.isfinite(curve.difference).all(axis=0)
    centre = int(np.argmin(np.abs(curve.displacement)))
    if not usable[centre]:
        return None
    left = centre - int(np.argmin(np.append(usable[centre::-1], False)))
    right = centre + int(np.argmin(np.append(usable[centre:], False)))
    run = np.zeros(len(usable), dtype=np.bool_)
    run[left + 1 : right] = True
    return run if run.sum() >= FEWEST_NODES else None


def _conicities(x: FloatArray, differences: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Equivalent conicity (rows, a) of every replicate; NaN where an amplitude is not covered."""
    return np.stack([equivalent_conicity(x, row, amplitude) for row in differences])


def _estimate(values: FloatArray, groups: int, count: float, reason: str) -> Estimate:
    """One number from its replicates: row 0, then the groups, then one row a shifted parameter."""
    if not np.isfinite(values).all():
        return Estimate.unknown(reason, count)
    jackknife = float(jackknife_std(values[: groups + 1]))
    systematic = float(np.sqrt(((values[groups + 1 :] - values[0]) ** 2).sum()))
    return with_interval(float(values[0]), jackknife, systematic, groups, count)


def _headline(
    amplitude: FloatArray, conicity: tuple[Estimate, ...], parameters: CurveParameters
) -> tuple[Estimate, float]:
    """Return the conicity at the headline amplitude, or at the largest covered below it."""
    for a, value in sorted(zip(amplitude, conicity, strict=True), key=lambda pair: -pair[0]):
        if a <= parameters.headline + 1e-9 and value.value is not None:
            return value, float(a)
    return Estimate.unknown("no amplitude is covered", conicity[0].count), parameters.headline


def _zero_crossing(x: FloatArray, curve: CurveReplicates, run: BoolArray, groups: int) -> Estimate:
    if curve.band_limited:
        return Estimate.unknown("band-limited signals carry no offset", curve.count)
    replicates = curve.difference[:, run]
    shifted = replicates[0] + curve.sensitivity[run].T
    values = np.array([_crossing(x, row) for row in np.vstack([replicates, shifted])])
    return _estimate(values, groups, curve.count, "rL - rR has no zero in the bins covered")


def _crossing(x: FloatArray, difference: FloatArray) -> float:
    """Displacement nearest to zero where the piecewise linear ``difference`` rises through zero; NaN without one."""
    rising = np.flatnonzero((difference[:-1] <= 0) & (difference[1:] > 0))
    if len(rising) == 0:
        return float("nan")
    share = -difference[rising] / (difference[rising + 1] - difference[rising])
    crossings = x[rising] + share * (x[rising + 1] - x[rising])
    return float(crossings[np.argmin(np.abs(crossings))])
