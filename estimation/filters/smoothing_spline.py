"""The slow wander of integrated signals, by a fixed-interval smoother in distance.

An integrated acceleration is what the wheelset did plus a wander. The wander is modelled as an integrated random walk
of third order *in distance*: its third derivative by distance is white. The most probable wander w given the whole
segment of u is then the smoothing spline

    minimise  sum_i ds_i (u_i - w(s_i))^2 + mu integral (w''')^2 ds,        mu = (L / 2 pi)^6,

which is what a Kalman filter over the segment and the Rauch-Tung-Striebel smoother back give, computed as one banded
least-squares problem. Of a wave of length l it leaves 1 / (1 + (l/L)^6): half at the cut-off L, 98.5 % at L/2, 1.5 %
at 2 L. At the ends of a segment, where a filter would have to guess, the spline runs on as a parabola.

``remove_wander`` is the high-pass of a segment: it also takes out what offsets and gaps of an acceleration integrate
to. ``docs/decisions/wander-smoother.md`` gives the reasons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimation.filters.spline_kernels import (
    add_band,
    add_roughness,
    factorise,
    multiply,
    place,
    project,
    solve,
    subtract,
)
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array

ORDER = 3  # of the derivative that is white
PIECES = 4  # B-splines of third degree at a place
REGULARISATION = 1e-12  # of the normal equations: what is removed may be nearly a spline itself
LENGTHS = 8  # of segments, whose functions are kept: most windows are whole
KNOTS_PER_CUT_OFF = 12  # twice as many change what is left of a wave by less than a hundredth of it


def subtract_smoothing_spline(
    signals: FloatArray,
    distance: FloatArray,
    known: BoolArray,
    cutoff_wavelength: float,
    removed: FloatArray,
    *,
    in_place: bool = False,
) -> FloatArray:
    """Return ``signals`` (m, n) less their wander.

    Args:
        signals: (m, n).
        distance: (n,) m, not decreasing, from zero.
        known: (n,) samples that count; the others are given the wander of their neighbours.
        cutoff_wavelength: Wavelength of which half is left, m.
        removed: (k, n) functions that are taken out whole beside the wander, such as what an offset integrates to.
        in_place: Whether ``signals`` may be written over, and are what is returned.

    Raises:
        numpy.linalg.LinAlgError: The samples that count do not determine the wander.
    """
    spline = _spline(distance, known, cutoff_wavelength)
    rows = np.ascontiguousarray(signals) if in_place else np.array(signals)
    removed = frozen_array(removed, removed.shape, name="removed")
    wander, of_removed = spline.projected(rows), spline.projected(removed)
    explained = spline.solved(of_removed)
    weighted = removed * spline.weight
    gram = _products(weighted, removed)
    gram[np.diag_indices_from(gram)] *= 1 + REGULARISATION
    gram -= _products(of_removed, explained)
    coefficients = spline.solved(wander)
    shares = _solved_definite(gram, _products(weighted, rows) - _products(of_removed, coefficients))
    coefficients -= shares.T @ explained
    subtract(rows, spline.interval, spline.pieces, coefficients, removed, shares)
    return rows


@dataclass(frozen=True, slots=True)
class _Spline:
    """A smoothing spline on uniform knots, without what it is to smooth."""

    weight: FloatArray  # (n,) m, of each sample
    interval: IntArray  # (n,) between knots
    pieces: FloatArray  # (PIECES, n) B-splines at each sample
    factor: FloatArray  # (k, PIECES) of the normal equations

    def projected(self, rows: FloatArray) -> FloatArray:
        """Return the right sides (m, k) of the normal equations."""
        sums = np.zeros((len(rows), len(self.factor)))
        project(rows, self.weight, self.interval, self.pieces, sums)
        return sums

    def solved(self, right: FloatArray) -> FloatArray:
        """Return the coefficients (m, k) for right sides."""
        found = right.copy()
        solve(self.factor, found)
        return found


def _spline(distance: FloatArray, known: BoolArray, cutoff_wavelength: float) -> _Spline:
    length = float(distance[-1])
    count = max(int(np.ceil(KNOTS_PER_CUT_OFF * length / cutoff_wavelength)), 1)
    step = length / count
    interval, pieces = np.empty(len(distance), np.int64), np.empty((PIECES, len(distance)))
    place(distance, length * (1 - 1e-12), 1 / step, interval, pieces, count - 1)
    weight, band = np.where(known, np.gradient(distance), 0.0), np.zeros((count + PIECES - 1, PIECES))
    add_band(weight, interval, pieces, band)
    add_roughness(band, (cutoff_wavelength / (2 * np.pi)) ** (2 * ORDER) * step ** (1 - 2 * ORDER))
    band[:, 0] *= 1 + REGULARISATION
    if not factorise(band):
        raise np.linalg.LinAlgError("the samples do not determine the wander")
    return _Spline(weight, interval, pieces, band)


def _products(weighted: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the products (k, m) of functions (k, n) with rows (m, n)."""
    products = np.empty((len(weighted), len(rows)))
    multiply(weighted, rows, products)
    return products


def _solved_definite(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution (k, m) of a positive definite system (k, k)."""
    factor = np.linalg.cholesky(gram)
    return np.asarray(np.linalg.solve(factor.T, np.linalg.solve(factor, right)))


def remove_wander(
    signals: FloatArray,
    distance: FloatArray,
    known: BoolArray,
    cutoff_wavelength: float,
    bridged: int = 0,
    *,
    in_place: bool = False,
) -> FloatArray:
    """Return ``signals`` (m, n) without what varies more slowly along the track than ``cutoff_wavelength``.

    Args:
        signals: (m, n), of one segment; values at samples that are not known are no part of the fit.
        distance: (n,) m run since the start of the segment, not decreasing.
        known: (n,) samples that were measured. After a gap the rates are off by an unknown constant and the
            displacements by a straight line: both are taken out for every modelled gap.
        cutoff_wavelength: m, of which half is left.
        bridged: Gaps of up to so many samples are not modelled: straight lines bridge them well enough.
        in_place: Whether ``signals`` may be written over, and are what is returned.
    """
    removed = _line_and_parabola(len(distance))
    gaps = modelled_gaps(known, bridged)
    if gaps:
        removed = np.concatenate([removed, _after_gaps(len(known), gaps)])
    return subtract_smoothing_spline(signals, distance, known, cutoff_wavelength, removed, in_place=in_place)


@lru_cache(maxsize=LENGTHS)
def _line_and_parabola(n: int) -> FloatArray:
    """Return (2, n): in time, what the constants of the integration and a constant offset leave."""
    t = np.linspace(-1.0, 1.0, n)
    return frozen_array(np.stack([t, 1.5 * t * t - 0.5]), (2, n), name="functions")


def modelled_gaps(known: BoolArray, bridged: int) -> list[tuple[int, int]]:
    """Return the gaps ``[first, behind)`` between known samples that are longer than ``bridged`` samples.

    Args:
        known: (n,) samples that were measured.
        bridged: Samples of the longest gap that is left out.
    """
    edges = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    first, behind = edges[~known[edges]], edges[known[edges]]
    behind = behind[behind > first[0]] if len(first) else behind
    return [(int(a), int(b)) for a, b in zip(first, behind, strict=False) if a > 0 and b - a > bridged]


def _after_gaps(n: int, gaps: Sequence[tuple[int, int]]) -> FloatArray:
    """Return (2 g, n): for each modelled gap a step and the line that rises after it."""
    t = np.arange(n)
    steps = [(t >= behind).astype(np.float64) for _, behind in gaps]
    lines = [np.maximum(t - 0.5 * (first - 1 + behind), 0.0) / n for first, behind in gaps]
    return np.array([*steps, *lines])
