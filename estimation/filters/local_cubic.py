"""The high-pass of passes along a section: a signal minus its local cubic fit.

The local fit over distance has weights of compact support that reproduce every cubic, so the filter is the same for
every pass, does not depend on what is further away than its reach, and removes the slow wander of integrated sensors.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from scipy import fft

from estimation.values.arrays import BoolArray, FloatArray, frozen_array

Precision = TypeVar("Precision", bound=np.floating[Any])
REACH_IN_WIDTHS = 3.5
CUT_OFF_IN_WIDTHS = 3.43  # wavelength that is halved over the width of the weights: (1 + u) exp(-u) = 1/2, u = 1.678


@lru_cache(maxsize=64)
def local_cubic_kernel(cutoff_wavelength: float, step: float) -> FloatArray:
    """Return the weights (2 m + 1,) of the local cubic fit on a grid of ``step`` m, read-only; they sum to one.

    Args:
        cutoff_wavelength: Wavelength, m, of which half remains after the high-pass.
    """
    width = cutoff_wavelength / CUT_OFF_IN_WIDTHS
    m = int(np.ceil(REACH_IN_WIDTHS * width / step))
    u = np.arange(-m, m + 1) * step / width
    weights = np.exp(-0.5 * u * u)
    moments = [float((weights * u**k).sum()) for k in (0, 2, 4)]
    # (a + b u^2) w(u) with sum 1 and no second moment reproduces cubics
    a, b = np.linalg.solve([[moments[0], moments[1]], [moments[1], moments[2]]], [1.0, 0.0])
    return frozen_array((a + b * u * u) * weights, (2 * m + 1,), name="weights")


def high_pass(signals: npt.NDArray[Precision], weights: npt.NDArray[Precision]) -> npt.NDArray[Precision]:
    """Return ``signals`` (m, n) minus their local fit; the first and last len(weights)//2 samples mean nothing.

    Args:
        weights: (2 k + 1,) from :func:`local_cubic_kernel` for that grid, of the same precision.
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
