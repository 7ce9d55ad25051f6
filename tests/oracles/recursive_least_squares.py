"""Grey-box weighted recursive least squares, sample by sample, as the paper prints it (Eq. 8-14).

Slow and plain on purpose: ``estimation.tables.bin_table`` must equal it on any split of the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray, frozen_array


@dataclass(frozen=True, slots=True)
class RecursiveState:
    """``theta`` (p,) and ``P`` (p, p) after ``count`` samples."""

    theta: FloatArray
    covariance: FloatArray  # P of Eq. 10; times the residual variance it is the covariance of theta
    count: int

    def __post_init__(self) -> None:
        p = len(self.theta)
        object.__setattr__(self, "theta", frozen_array(self.theta, (p,), name="theta"))
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (p, p), name="covariance"))


def init(features: FloatArray, measured: FloatArray, known: FloatArray, forgetting: float = 1.0) -> RecursiveState:
    """Start from the samples collected up to the threshold count (Eq. 10-11).

    Args:
        features: (n, p) regressors X.
        measured: (n,) output y.
        known: (n,) known part Omega.
        forgetting: Weights of the start, W^(age); 1 is the paper's print.

    Raises:
        numpy.linalg.LinAlgError: X'X is singular.
    """
    n = len(measured)
    root = np.sqrt(forgetting ** np.arange(n - 1, -1, -1, dtype=np.float64))
    weighted = features * root[:, None]
    # P = (X'X)^-1 through QR, which does not square the condition number
    _, triangle = np.linalg.qr(weighted)
    inverse = np.linalg.inv(triangle)
    covariance = inverse @ inverse.T
    theta = covariance @ (weighted.T @ ((measured - known) * root))
    return RecursiveState(theta, covariance, n)


def update(
    state: RecursiveState, feature: FloatArray, measured: float, known: float, forgetting: float = 1.0
) -> RecursiveState:
    """Add one sample (Eq. 12-14).

    Args:
        feature: (p,) regressors.
        measured, known: Output and its known part.
        forgetting: 0 < W <= 1.
    """
    P = state.covariance
    Px = P @ feature
    γ = 1.0 / (forgetting + feature @ Px)
    covariance = (P - γ * np.outer(Px, Px)) / forgetting
    theta = state.theta + γ * Px * ((measured - known) - feature @ state.theta)
    return RecursiveState(theta, covariance, state.count + 1)
