"""The high-pass of a segment: one filter for everything that is compared, with a cut-off that is a wavelength.

It takes out the most probable wander (:mod:`estimation.filters.smoothing_spline`) and what offsets and gaps of an
acceleration integrate to. It is linear, takes segments of any length and speed, and has no transient at the ends.
``docs/decisions/wander-smoother.md`` gives the reasons.
"""

from __future__ import annotations

import numpy as np

from estimation.filters.smoothing_spline import subtract_smoothing_spline
from estimation.values.arrays import BoolArray, FloatArray


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
