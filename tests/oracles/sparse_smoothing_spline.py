"""The smoothing spline by the B-splines of scipy, sparse products and one dense Cholesky factor."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from estimation.filters import FILTERS, ORDER
from estimation.values.arrays import BoolArray, FloatArray

DEGREE = 3


def sparse_smoothing_spline(
    signals: FloatArray, distance: FloatArray, known: BoolArray, cutoff_wavelength: float, removed: FloatArray
) -> FloatArray:
    """Return signals (m, n) less their wander, as ``subtract_smoothing_spline`` does."""
    step = float(distance[-1]) / max(int(np.ceil(FILTERS.knots_per_cut_off * distance[-1] / cutoff_wavelength)), 1)
    knots = step * np.arange(-DEGREE, round(float(distance[-1]) / step) + DEGREE + 1)
    spline = BSpline.design_matrix(np.clip(distance, 0.0, distance[-1] * (1 - 1e-12)), knots, DEGREE)
    difference = np.diff(np.eye(spline.shape[1]), ORDER, axis=0)
    roughness = (cutoff_wavelength / (2 * np.pi)) ** (2 * ORDER) * step ** (1 - 2 * ORDER) * difference.T @ difference
    weight = np.where(known, np.gradient(distance), 0.0)
    columns = np.column_stack([spline.toarray(), removed.T])
    gram = (columns * weight[:, None]).T @ columns
    gram[: len(roughness), : len(roughness)] += roughness
    gram[np.diag_indices_from(gram)] *= 1 + FILTERS.regularisation
    solution = cho_solve(cho_factor(gram), (columns * weight[:, None]).T @ signals.T)
    return np.asarray(signals - (columns @ solution).T)
