"""What the fit of a bogie says of the rolling radius difference of one wheelset, as the geometry publishes it."""

from __future__ import annotations

import math

import numpy as np

from estimation.bogie.fit import BogieFit
from estimation.bogie.parameters import BOGIE
from estimation.geometry.conicity import CurveReplicates
from estimation.geometry.uncertainty import DisplacementError, ParameterUncertainty
from estimation.values.arrays import FloatArray


def curve_replicates(
    fit: BogieFit, axle: int, edges: FloatArray, uncertainty: ParameterUncertainty, displacement_std: float, count: float
) -> CurveReplicates:
    """Return R of an axle, 0 or 1, over bins that are centred on the nodes.

    Args:
        displacement_std: Of y - d by alignment and sensors, m.
        count: Windows.
    """
    own, visited = fit.curve(axle), fit.visited[axle]
    # what is slow has no mean: R is counted from its mean over the run
    centred = np.eye(len(visited)) - visited / visited.sum()
    curves = fit.replicates[:, own] @ centred.T
    values, vectors = np.linalg.eigh(centred @ fit.by_prior[own, own] @ centred.T)
    by_prior = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    of_scale = uncertainty.scale * curves[:1]
    variance = float(np.average((BOGIE.node_step * (np.arange(len(visited)) - len(visited) // 2)) ** 2, weights=visited))
    # instruments: the noise of y - d does not stretch it, but for that of the alignment, which is in both
    dilution = min(uncertainty.alignment_noise**2 / variance, 1.0) if variance > 0.0 else 1.0
    error = DisplacementError(
        displacement_std,
        0.0,
        math.hypot(uncertainty.displacement, dilution),
        jump_position_std=uncertainty.jump_position_std,
        jump_mean_std=uncertainty.jump_mean_std,
    )
    return CurveReplicates(
        edges=edges,
        difference=in_bins(curves),
        sensitivity=np.moveaxis(in_bins(np.concatenate([by_prior, of_scale])), 0, 1),
        usable=visited >= BOGIE.least_visited,
        error=error,
        count=count,
        band_limited=True,
        held_shares=uncertainty.held_shares,
        contact_roll=uncertainty.contact_roll,
    )


def in_bins(curves: FloatArray) -> FloatArray:
    """Return curves (r, b), straight between the centres of bins, as value, slope, curvature in each (r, b, 3)."""
    padded = np.concatenate([2 * curves[:, :1] - curves[:, 1:2], curves, 2 * curves[:, -1:] - curves[:, -2:-1]], axis=1)
    before, here, behind = padded[:, :-2], curves, padded[:, 2:]
    return np.stack([here, 0.5 * (behind - before), before - 2.0 * here + behind], axis=2)
