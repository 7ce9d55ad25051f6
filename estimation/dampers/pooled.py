"""The damper of a running gear from the sums of its windows: posterior over particles, interval, finding.

Given a share of the damping the other parameters of the vehicle are linear in the innovations: their errors, of which
the class states the standard deviations, are solved for in every particle (Rao and Blackwell), and leave their part in
its weight. What windows tell beyond that is seen from leaving groups of them out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from estimation.values.arrays import FloatArray
from estimation.values.dampers import SHARES, DamperSums, GearDamper, WindowDamper
from estimation.values.intervals import NORMAL_95, jackknife_std, with_interval
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode

BETWEEN = 16  # shares at which the posterior is, from one particle to the next
GROUPS = 12  # of windows that are left out together
FEWEST = 4  # windows


@dataclass(frozen=True, slots=True)
class DamperParameters:
    """How far back windows count, and what is published.

    Attributes
    ----------
    span_km
        Of the odometer, back from the newest window.
    weak_share
        A damper with less of its damping is weak.
    likely
        Probability of that from which on it is a finding.
    widest_std
        Of a share that is published.
    most_diverged
        Share of the windows.
    largest_errors
        Of the other parameters: mean square over their stds.
    """

    span_km: float = 5_000.0
    weak_share: float = 0.5
    likely: float = 0.9
    widest_std: float = 0.2
    most_diverged: float = 0.2
    largest_errors: float = 4.0


@dataclass(frozen=True, slots=True)
class Posterior:
    """What sums say: mean and std of the share, and the mean square of the other parameters' errors over their stds."""

    share: float
    std: float
    errors: float


def posterior(sums: FloatArray) -> Posterior:
    """Return what sums say.

    Parameters
    ----------
    sums
        (q - 1, m, m) products of the innovations of q particles over the windows.
    """
    t = (np.arange(BETWEEN) + 0.5) / BETWEEN
    low, apart = np.array(SHARES[:-1]), np.diff(SHARES)
    share = (low[:, None] + apart[:, None] * t).ravel()
    # signals of a share between two particles: innovations, and their changes by the other parameters
    own = sums[:, 0, 0, None] + 2.0 * t * sums[:, 0, -1, None] + t**2 * sums[:, -1, -1, None]
    mixed = sums[:, None, 1:-1, 0] + t[:, None] * sums[:, None, 1:-1, -1]
    size = sums.shape[1] - 2
    precision = sums[:, None, 1:-1, 1:-1] + np.eye(size)
    best = -np.linalg.solve(np.broadcast_to(precision, (*mixed.shape, size)), mixed[..., None])[..., 0]
    square = own + (mixed * best).sum(axis=-1)
    left = np.linalg.slogdet(precision)[1]
    likelihood = -0.5 * (square + left).ravel()
    weight = np.exp(likelihood - likelihood.max()) * np.repeat(apart, BETWEEN)
    weight /= weight.sum()
    mean = float(weight @ share)
    spread = float(weight @ (share - mean) ** 2)
    errors = float(weight @ (best**2).mean(axis=-1).ravel())
    return Posterior(mean, float(np.sqrt(spread + np.mean(apart[:1]) ** 2 / (12.0 * BETWEEN**2))), errors)
