"""Accelerations integrated once and twice, stretch by stretch."""

from __future__ import annotations

import numpy as np

from estimation.motion.parameters import SignalParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.windows import ACCELERATIONS, Window


def segments(
    usable: BoolArray, window: Window, parameters: SignalParameters, longest_gap: int | None = None
) -> list[tuple[int, int]]:
    """Return the runs of usable samples with only short gaps in them, long enough to be worth it.

    Parameters
    ----------
    usable
        (n,).
    window
        Its sampling interval is used.
    parameters
        Gates.
    longest_gap
        Samples that may be missing in a row; by default as many as may be bridged.
    """
    gap = parameters.bridged_samples if longest_gap is None else longest_gap
    index = np.flatnonzero(usable)
    breaks = np.flatnonzero(np.diff(index) > gap + 1)
    starts = np.concatenate([index[:1], index[breaks + 1]])
    stops = np.concatenate([index[breaks], index[-1:]]) + 1
    least = parameters.shortest_segment_s / window.sample_interval_s
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if b - a >= least]


def running_integrals(window: Window, known: BoolArray, part: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return accelerations, rates and displacements (4, n) each, in the order of ``ACCELERATIONS``, of one stretch.

    Means, and straight lines of the rates, are taken out on the way, so that what still wanders is small; the slow
    part of the result carries no meaning.

    Parameters
    ----------
    window
        Measured accelerations.
    known
        (n,) where samples of the stretch are usable; others are bridged by straight lines.
    part
        The stretch.
    """
    dt = window.sample_interval_s
    t = np.arange(part.stop - part.start)
    accelerations = np.stack([bridged(getattr(window, name)[part], known) for name in ACCELERATIONS])
    accelerations -= accelerations.mean(axis=1, keepdims=True)
    rates = _running_integral(accelerations, dt)
    centred = t - t.mean()
    rates -= rates.mean(axis=1, keepdims=True) + np.outer(rates @ centred / (centred @ centred), centred)
    return accelerations, rates, _running_integral(rates, dt)


def bridged(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return ``values`` with straight lines across the samples that are not known."""
    if known.all():
        return values
    t = np.arange(len(values))
    return np.interp(t, t[known], values[known])


def _running_integral(values: FloatArray, dt: float) -> FloatArray:
    """Trapezoidal running integral along the last axis, starting at zero."""
    result = np.zeros_like(values)
    np.cumsum(0.5 * dt * (values[:, 1:] + values[:, :-1]), axis=1, out=result[:, 1:])
    return result


def distance_run(window: Window, known: BoolArray, part: slice) -> FloatArray:
    """Distance run in the stretch, (n,) m, ascending from zero; where a sample is missing, interpolated."""
    speed = bridged(window.speed[part], known)
    return np.asarray(_running_integral(speed[None, :], window.sample_interval_s)[0])
