"""The slow wander of integrated signals, by a fixed-interval smoother in distance.

An integrated acceleration is what the wheelset did plus a wander. The wander is modelled as an integrated random walk
of third order *in distance*: its third derivative by distance is white. The most probable wander w given the whole
segment of u is then the smoothing spline

    minimise  sum_i ds_i (u_i - w(s_i))^2 + mu integral (w''')^2 ds,        mu = (L / 2 pi)^6,

which is what a Kalman filter over the segment and the Rauch-Tung-Striebel smoother back give, computed as one sparse
least-squares problem. Of a wave of length l it leaves 1 / (1 + (l/L)^6): half at the cut-off L, 98.5 % at L/2, 1.5 %
at 2 L. At the ends of a segment, where a filter would have to guess, the spline runs on as a parabola.

``remove_wander`` is the high-pass of a segment: it also takes out what offsets and gaps of an acceleration integrate
to. ``docs/decisions/wander-smoother.md`` gives the reasons.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from estimation.values.arrays import BoolArray, FloatArray

ORDER = 3  # of the derivative that is white
DEGREE = 3  # of the spline's pieces
KNOTS_PER_CUT_OFF = 12  # twice as many change what is left of a wave by less than a hundredth of it


def subtract_smoothing_spline(
    signals: FloatArray, distance: FloatArray, known: BoolArray, cutoff_wavelength: float, removed: FloatArray
) -> FloatArray:
    """Return ``signals`` (m, n) less their wander.

    Parameters
    ----------
    signals
        (m, n).
    distance
        (n,) m, not decreasing, from zero.
    known
        (n,) samples that count; the others are given the wander of their neighbours.
    cutoff_wavelength
        Wavelength of which half is left, m.
    removed
        (k, n) functions that are taken out whole beside the wander, such as what an offset integrates to.
    """
    step = float(distance[-1]) / max(int(np.ceil(KNOTS_PER_CUT_OFF * distance[-1] / cutoff_wavelength)), 1)
    spline = _spline(distance, step)
    penalty = _roughness(spline.shape[1], step, cutoff_wavelength)
    weight = np.where(known, np.gradient(distance), 0.0)
    count = len(penalty)
    weighted_spline, weighted_removed = spline.T.multiply(weight).tocsr(), removed * weight
    gram = np.empty((count + len(removed), count + len(removed)))
    gram[:count, :count] = (weighted_spline @ spline).toarray() + penalty
    gram[:count, count:] = weighted_spline @ removed.T
    gram[count:, :count] = gram[:count, count:].T
    gram[count:, count:] = weighted_removed @ removed.T
    gram[np.diag_indices_from(gram)] *= 1 + 1e-12  # what is removed may be nearly a spline itself
    right = np.concatenate([weighted_spline @ signals.T, weighted_removed @ signals.T])
    solution = cho_solve(cho_factor(gram), right)
    return np.asarray(signals - (spline @ solution[:count]).T - solution[count:].T @ removed)


def _spline(distance: FloatArray, step: float):  # type: ignore[no-untyped-def]  # noqa: ANN202 - a sparse array of scipy
    """Return the B-splines (n, k) on knots every ``step``, sparse."""
    length = float(distance[-1])
    knots = step * np.arange(-DEGREE, round(length / step) + DEGREE + 1)
    return BSpline.design_matrix(np.clip(distance, 0.0, length * (1 - 1e-12)), knots, DEGREE)


def _roughness(count: int, step: float, cutoff_wavelength: float) -> FloatArray:
    """Return mu times the integral of the squared third derivative as a quadratic form (k, k) of the coefficients.

    The third derivative of a cubic spline is constant between knots: the third difference over ``step``^3.
    """
    difference = np.diff(np.eye(count), ORDER, axis=0)
    return np.asarray(
        (cutoff_wavelength / (2 * np.pi)) ** (2 * ORDER) * step ** (1 - 2 * ORDER) * difference.T @ difference
    )


def remove_wander(
    signals: FloatArray,
    distance: FloatArray,
    known: BoolArray,
    cutoff_wavelength: float,
    bridged: int = 0,
) -> FloatArray:
    """Return ``signals`` (m, n) without what varies more slowly along the track than ``cutoff_wavelength``.

    Parameters
    ----------
    signals
        (m, n), of one segment; values at samples that are not known are no part of the fit.
    distance
        (n,) m run since the start of the segment, not decreasing.
    known
        (n,) samples that were measured. After a gap the rates are off by an unknown constant and the
        displacements by a straight line: both are taken out for every modelled gap.
    cutoff_wavelength
        m, of which half is left.
    bridged
        Gaps of up to so many samples are not modelled: straight lines bridge them well enough.
    """
    removed = np.concatenate([_line_and_parabola(len(distance)), _after_gaps(known, bridged)])
    return subtract_smoothing_spline(signals, distance, known, cutoff_wavelength, removed)


def _line_and_parabola(n: int) -> FloatArray:
    """Return (2, n): in time, what the constants of the integration and a constant offset leave."""
    t = np.linspace(-1.0, 1.0, n)
    return np.stack([t, 1.5 * t * t - 0.5])


def modelled_gaps(known: BoolArray, bridged: int) -> list[tuple[int, int]]:
    """Return the gaps ``[first, behind)`` between known samples that are longer than ``bridged`` samples.

    Parameters
    ----------
    known
        (n,) samples that were measured.
    bridged
        Samples of the longest gap that is left out.
    """
    edges = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    first, behind = edges[~known[edges]], edges[known[edges]]
    behind = behind[behind > first[0]] if len(first) else behind
    return [(int(a), int(b)) for a, b in zip(first, behind, strict=False) if a > 0 and b - a > bridged]


def _after_gaps(known: BoolArray, bridged: int) -> FloatArray:
    """Return (2 g, n): for each modelled gap a step and the line that rises after it."""
    gaps = modelled_gaps(known, bridged)
    t = np.arange(len(known))
    steps = [(t >= behind).astype(np.float64) for _, behind in gaps]
    lines = [np.maximum(t - 0.5 * (first - 1 + behind), 0.0) / len(known) for first, behind in gaps]
    return np.array([*steps, *lines]).reshape(-1, len(known))
