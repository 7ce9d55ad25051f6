"""The high-pass of a stretch: one filter for everything that is compared, with a cut-off that is a wavelength.

Two designs. The *smoother* takes out the most probable wander (``wander_smoother``); the *projection* takes out the
least-squares fit of cosines in distance down to the cut-off. Both are linear, take stretches of any length and speed,
have no transient at the ends, and take out whole what offsets and gaps of an acceleration integrate to.
``docs/decisions/wander-smoother.md`` compares them.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimation.filters.smoothing_spline import subtract_smoothing_spline
from estimation.values.arrays import BoolArray, FloatArray


class HighPass(StrEnum):
    """The design of the high-pass."""

    SMOOTHER = "smoother"
    PROJECTION = "projection"


def remove_wander(
    signals: FloatArray,
    distance: FloatArray,
    known: BoolArray,
    longest: float,
    design: HighPass = HighPass.SMOOTHER,
    bridged: int = 0,
) -> FloatArray:
    """Return ``signals`` (m, n) without what varies more slowly along the track than ``longest``.

    Parameters
    ----------
    signals
        (m, n), of one stretch; values at samples that are not known are no part of the fit.
    distance
        (n,) m run since the start of the stretch, not decreasing.
    known
        (n,) samples that were measured. After a gap the rates are off by a constant that nobody knows and the
        displacements by a straight line: both are taken out for every modelled gap.
    longest
        Cut-off wavelength, m.
    design
        Which filter.
    bridged
        Gaps of up to so many samples are not modelled: straight lines bridge them well enough.
    """
    removed = np.concatenate([_line_and_parabola(len(distance)), _after_gaps(known, bridged)])
    if design is HighPass.SMOOTHER:
        return subtract_smoothing_spline(signals, distance, known, longest, removed)
    basis = np.concatenate([slow_basis(distance, longest), removed])
    weighted = basis * known
    gram = weighted @ basis.T
    gram[np.diag_indices_from(gram)] *= 1 + 1e-12  # cosines and parabola are nearly dependent in short stretches
    return np.asarray(signals - cho_solve(cho_factor(gram), weighted @ signals.T).T @ basis)


def slow_basis(distance: FloatArray, longest: float) -> FloatArray:
    """Return (k, n) cosines in distance, a constant among them, of wavelengths from ``longest`` up."""
    length = float(distance[-1])
    terms = int(2 * length / longest)
    basis = np.empty((terms + 1, len(distance)))
    basis[0] = 1.0
    first = np.cos(np.pi * distance / length)
    if terms:
        basis[1] = first
    for k in range(2, terms + 1):
        basis[k] = 2 * first * basis[k - 1] - basis[k - 2]  # Chebyshev: cos(k x)
    return basis


def _line_and_parabola(n: int) -> FloatArray:
    """Return (2, n): in time, what the constants of the integration and a constant offset leave."""
    t = np.linspace(-1.0, 1.0, n)
    return np.stack([t, 1.5 * t * t - 0.5])


def modelled_gaps(known: BoolArray, bridged: int) -> list[tuple[int, int]]:
    """Return the gaps ``[first, behind)`` between known samples that are longer than ``bridged`` samples."""
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
