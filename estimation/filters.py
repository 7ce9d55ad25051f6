"""High-passes in distance: smoothing spline for windows, local cubic for passes.

An integrated acceleration is what the wheelset did plus a wander. The wander is modelled as an integrated random walk
of third order *in distance*: its third derivative by distance is white. The most probable wander w given the whole
segment of u is then the smoothing spline

    minimise  sum_i ds_i (u_i - w(s_i))^2 + mu integral (w''')^2 ds,        mu = (L / 2 pi)^6,

which is what a Kalman filter over the segment and the Rauch-Tung-Striebel smoother back give, computed as one banded
least-squares problem. Of a wave of length l it leaves 1 / (1 + (l/L)^6): half at the cut-off L, 98.5 % at L/2, 1.5 %
at 2 L. At the ends of a segment, where a filter would have to guess, the spline runs on as a parabola.

``remove_wander`` is the high-pass of a segment: it also takes out what offsets and gaps of an acceleration integrate
to. ``docs/decisions/wander-smoother.md`` gives the reasons.

The normal matrix is a band, one row and the next three columns for each B-spline, with a border of a few functions that
are taken out whole. Every sum goes in an order of its own, so that it is the same on every processor.

The high-pass of passes along a section is a signal minus its local cubic fit. The local fit over distance has weights
of compact support that reproduce every cubic, so the filter is the same for every pass, does not depend on what is
further away than its reach, and removes the slow wander of integrated sensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from scipy import fft

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from estimation.values.memory import MEMORY

PIECES = 4  # B-splines of third degree at a place
LANES = 8  # partial sums of a long product


@compiled(nogil=True)
def place(distance: FloatArray, end: float, per_step: float, interval: IntArray, pieces: FloatArray, last: int) -> None:
    """Write the knot interval (n,) of every place, and the four B-splines there (4, n)."""
    for i in range(len(distance)):
        at = min(distance[i], end) * per_step
        j = min(int(at), last) if at > 0.0 else 0  # of what is no number, too
        t = at - j
        s = 1.0 - t
        interval[i] = j
        pieces[0, i] = s * s * s / 6.0
        pieces[1, i] = (t * t * (3.0 * t - 6.0) + 4.0) / 6.0
        pieces[2, i] = (s * s * (3.0 * s - 6.0) + 4.0) / 6.0
        pieces[3, i] = t * t * t / 6.0


@compiled(nogil=True)
def add_band(weight: FloatArray, interval: IntArray, pieces: FloatArray, band: FloatArray) -> None:
    """Add the weighted products of B-splines to the rows of the band (k, 4)."""
    for i in range(len(weight)):
        j, w = interval[i], weight[i]
        b0, b1, b2, b3 = pieces[0, i], pieces[1, i], pieces[2, i], pieces[3, i]
        w0, w1, w2 = w * b0, w * b1, w * b2
        band[j, 0] += w0 * b0
        band[j, 1] += w0 * b1
        band[j, 2] += w0 * b2
        band[j, 3] += w0 * b3
        band[j + 1, 0] += w1 * b1
        band[j + 1, 1] += w1 * b2
        band[j + 1, 2] += w1 * b3
        band[j + 2, 0] += w2 * b2
        band[j + 2, 1] += w2 * b3
        band[j + 3, 0] += w * b3 * b3


@compiled(nogil=True)
def add_roughness(band: FloatArray, scale: float) -> None:
    """Add ``scale`` times the squared third difference of the coefficients."""
    difference = (-1.0, 3.0, -3.0, 1.0)
    for k in range(len(band) - PIECES + 1):
        for a in range(PIECES):
            for b in range(a, PIECES):
                band[k + a, b - a] += scale * difference[a] * difference[b]


@compiled(nogil=True)
def project(rows: FloatArray, weight: FloatArray, interval: IntArray, pieces: FloatArray, sums: FloatArray) -> None:
    """Add to ``sums`` (m, k) the weighted products of rows (m, n) with every B-spline."""
    n = len(weight)
    first = 0
    while first < n:
        j = interval[first]
        behind = first + 1
        while behind < n and interval[behind] == j:
            behind += 1
        for r in range(len(rows)):
            row = rows[r]
            a0 = a1 = a2 = a3 = 0.0
            for i in range(first, behind):
                v = weight[i] * row[i]
                a0 += pieces[0, i] * v
                a1 += pieces[1, i] * v
                a2 += pieces[2, i] * v
                a3 += pieces[3, i] * v
            sums[r, j] += a0
            sums[r, j + 1] += a1
            sums[r, j + 2] += a2
            sums[r, j + 3] += a3
        first = behind


@compiled(nogil=True)
def multiply(weighted: FloatArray, rows: FloatArray, products: FloatArray) -> None:
    """Write the products (k, m) of weighted functions (k, n) with rows (m, n)."""
    n = weighted.shape[1]
    for p in range(len(weighted)):
        for r in range(len(rows)):
            lanes = np.zeros(LANES)
            for i in range(0, n - LANES + 1, LANES):
                for lane in range(LANES):
                    lanes[lane] += weighted[p, i + lane] * rows[r, i + lane]
            for i in range(n - n % LANES, n):
                lanes[0] += weighted[p, i] * rows[r, i]
            products[p, r] = lanes.sum()


@compiled(nogil=True)
def factorise(band: FloatArray) -> bool:
    """Replace the band by its Cholesky factor U, row by row; return whether it is positive definite."""
    n = len(band)
    for i in range(n):
        if not band[i, 0] > 0.0:
            return False
        root = math.sqrt(band[i, 0])
        reach = min(PIECES, n - i)
        for d in range(reach):
            band[i, d] /= root
        for d in range(1, reach):
            for e in range(d, reach):
                band[i + d, e - d] -= band[i, d] * band[i, e]
    return True


@compiled(nogil=True)
def solve(band: FloatArray, right: FloatArray) -> None:
    """Replace right sides (m, k) by solutions of the equations whose factor is ``band``."""
    n = len(band)
    for r in range(len(right)):
        x = right[r]
        for i in range(n):
            x[i] /= band[i, 0]
            for d in range(1, min(PIECES, n - i)):
                x[i + d] -= band[i, d] * x[i]
        for i in range(n - 1, -1, -1):
            for d in range(1, min(PIECES, n - i)):
                x[i] -= band[i, d] * x[i + d]
            x[i] /= band[i, 0]


@compiled(nogil=True)
def subtract(
    rows: FloatArray,
    interval: IntArray,
    pieces: FloatArray,
    coefficients: FloatArray,
    removed: FloatArray,
    shares: FloatArray,
) -> None:
    """Take splines of these coefficients (m, k), and shares (r, m) of functions (r, n), from rows (m, n)."""
    n = len(interval)
    first = 0
    while first < n:
        j = interval[first]
        behind = first + 1
        while behind < n and interval[behind] == j:
            behind += 1
        for r in range(len(rows)):
            c0, c1, c2, c3 = coefficients[r, j], coefficients[r, j + 1], coefficients[r, j + 2], coefficients[r, j + 3]
            for i in range(first, behind):
                rows[r, i] -= pieces[0, i] * c0 + pieces[1, i] * c1 + pieces[2, i] * c2 + pieces[3, i] * c3
            for q in range(len(removed)):
                share = shares[q, r]
                for i in range(first, behind):
                    rows[r, i] -= share * removed[q, i]
        first = behind


ORDER = 3  # of the derivative that is white


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Knots and reach of the filters."""

    regularisation: float = 1e-12  # of the normal equations: what is removed may be nearly a spline itself
    knots_per_cut_off: int = 12  # twice as many change what is left of a wave by less than a hundredth of it
    reach_in_widths: float = 3.5
    cut_off_in_widths: float = 3.43  # halved over the width of the weights: (1 + u) exp(-u) = 1/2, u = 1.678


FILTERS = FilterParameters()


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
    gram[np.diag_indices_from(gram)] *= 1 + FILTERS.regularisation
    gram -= _products(of_removed, explained)
    coefficients = spline.solved(wander)
    factor, right = np.linalg.cholesky(gram), _products(weighted, rows) - _products(of_removed, coefficients)
    shares = np.asarray(np.linalg.solve(factor.T, np.linalg.solve(factor, right)))
    coefficients -= shares.T @ explained
    subtract(rows, spline.interval, spline.pieces, coefficients, removed, shares)
    return rows


@dataclass(frozen=True, slots=True)
class _Spline:
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
    count = max(int(np.ceil(FILTERS.knots_per_cut_off * length / cutoff_wavelength)), 1)
    step = length / count
    interval, pieces = np.empty(len(distance), np.int64), np.empty((PIECES, len(distance)))
    place(distance, length * (1 - 1e-12), 1 / step, interval, pieces, count - 1)
    weight, band = np.where(known, np.gradient(distance), 0.0), np.zeros((count + PIECES - 1, PIECES))
    add_band(weight, interval, pieces, band)
    add_roughness(band, (cutoff_wavelength / (2 * np.pi)) ** (2 * ORDER) * step ** (1 - 2 * ORDER))
    band[:, 0] *= 1 + FILTERS.regularisation
    if not factorise(band):
        raise np.linalg.LinAlgError("the samples do not determine the wander")
    return _Spline(weight, interval, pieces, band)


def _products(weighted: FloatArray, rows: FloatArray) -> FloatArray:
    products = np.empty((len(weighted), len(rows)))
    multiply(weighted, rows, products)
    return products


def remove_wander(
    signals: FloatArray,
    distance: FloatArray,
    known: BoolArray,
    cutoff_wavelength: float,
    bridged: int = 0,
    *,
    in_place: bool = False,
) -> FloatArray:
    """Return ``signals`` (m, n) without what varies more slowly along the track than ``cutoff_wavelength``, m.

    Args:
        signals: (m, n), of one segment; values at samples that are not known are no part of the fit.
        known: (n,) samples that were measured. After a gap the rates are off by an unknown constant and the
            displacements by a straight line: both are taken out for every modelled gap.
        bridged: Gaps of up to so many samples are not modelled: straight lines bridge them well enough.
        in_place: Whether ``signals`` may be written over, and are what is returned.
    """
    removed = _line_and_parabola(len(distance))
    gaps = modelled_gaps(known, bridged)
    if gaps:
        removed = np.concatenate([removed, _after_gaps(len(known), gaps)])
    return subtract_smoothing_spline(signals, distance, known, cutoff_wavelength, removed, in_place=in_place)


@lru_cache(maxsize=MEMORY.segment_lengths)
def _line_and_parabola(n: int) -> FloatArray:
    """Return (2, n): in time, what the constants of the integration and a constant offset leave."""
    t = np.linspace(-1.0, 1.0, n)
    return frozen_array(np.stack([t, 1.5 * t * t - 0.5]), (2, n), name="functions")


def modelled_gaps(known: BoolArray, bridged: int) -> list[tuple[int, int]]:
    """Return the gaps ``[first, behind)`` between known samples that are longer than ``bridged`` samples."""
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


def between_known(places: FloatArray, at: FloatArray, known: BoolArray) -> BoolArray:
    """Return which places (m,) are between points (n,) that are both known."""
    return np.asarray(np.interp(places, at, known.astype(np.float64), left=0.0, right=0.0) > 1.0 - 1e-9)


Precision = TypeVar("Precision", bound=np.floating[Any])


@lru_cache(maxsize=64)
def local_cubic_kernel(cutoff_wavelength: float, step: float) -> FloatArray:
    """Return weights (2 m + 1,) of the local cubic fit on a grid, m; its high-pass leaves half of the cut-off wave."""
    width = cutoff_wavelength / FILTERS.cut_off_in_widths
    m = int(np.ceil(FILTERS.reach_in_widths * width / step))
    u = np.arange(-m, m + 1) * step / width
    weights = np.exp(-0.5 * u * u)
    moments = [float((weights * u**k).sum()) for k in (0, 2, 4)]
    # (a + b u^2) w(u) with sum 1 and no second moment reproduces cubics
    a, b = np.linalg.solve([[moments[0], moments[1]], [moments[1], moments[2]]], [1.0, 0.0])
    return frozen_array((a + b * u * u) * weights, (2 * m + 1,), name="weights")


def high_pass(signals: npt.NDArray[Precision], weights: npt.NDArray[Precision]) -> npt.NDArray[Precision]:
    """Return ``signals`` (m, n) minus their local fit; the first and last len(weights)//2 samples mean nothing.

    The weights are those of :func:`local_cubic_kernel` for that grid, of the same precision.
    """
    n, reach = signals.shape[-1], len(weights) // 2
    size = fft.next_fast_len(n + 2 * reach, real=True)
    fit = fft.irfft(fft.rfft(signals, size) * _spectrum(weights.tobytes(), weights.dtype.str, size), size)
    return np.asarray(signals - fit[..., reach : reach + n])


@lru_cache(maxsize=64)
def _spectrum(weights: bytes, kind: str, size: int) -> npt.NDArray[Any]:
    """Return the transform of weights of a type that numpy knows by ``kind``, padded to ``size``."""
    return np.asarray(fft.rfft(np.frombuffer(weights, dtype=kind), size))


def valid_support(valid: BoolArray, weights: FloatArray) -> BoolArray:
    """Return where every sample within the reach of the filter is valid."""
    m = len(weights) // 2
    padded = np.concatenate([np.zeros(m), ~valid, np.zeros(m)])
    padded[:m] = padded[len(padded) - m :] = 1.0
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray(sums[2 * m + 1 :] - sums[: -(2 * m + 1)] == 0)
