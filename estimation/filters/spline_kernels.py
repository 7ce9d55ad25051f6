"""Compiled sums of the smoothing spline: normal equations on uniform knots, their solution, and what it leaves.

The normal matrix is a band, one row and the next three columns for each B-spline, with a border of a few functions that
are taken out whole. Every sum goes in an order of its own, so that it is the same on every processor.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, IntArray

PIECES = 4  # B-splines of third degree at a place
LANES = 8  # partial sums of a long product


@compiled(nogil=True)
def place(distance: FloatArray, end: float, per_step: float, interval: IntArray, pieces: FloatArray, last: int) -> None:
    """Write the knot interval (n,) of every place, and the four B-splines there (4, n).

    Args:
        distance: (n,) m, not decreasing.
        end, per_step: The largest place that is looked up, m, and knot intervals per m.
        interval, pieces: Written: (n,) and (4, n).
    """
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
    """Add the weighted products of B-splines to the rows of the band (k, 4).

    Args:
        weight: (n,) of each sample.
        band: (k, 4), added to.
    """
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
    """Add to ``sums`` (m, k) the weighted products of rows (m, n) with every B-spline.

    Args:
        rows, weight: (m, n) and (n,).
        sums: (m, k), added to.
    """
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
    """Write the products (k, m) of weighted functions (k, n) with rows (m, n).

    Args:
        weighted, rows: (k, n) and (m, n).
        products: (k, m), written.
    """
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
    """Take splines of these coefficients (m, k), and shares (r, m) of functions (r, n), from rows (m, n).

    Args:
        rows: (m, n), changed.
        coefficients: (m, k) of the splines.
        removed, shares: (r, n) functions, and (r, m) how much of each is taken out.
    """
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
