"""The interval of a share of things that come in clusters, such as the measurements of one wheelset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import betaln

from estimation.accuracy.parameters import SHARE


def share_interval(clusters: Sequence[tuple[int, int]], tail: float) -> tuple[float, float] | None:
    """Return the interval of a share from how many there are and how many count, by cluster; None where there is none.

    ``tail`` is the probability on either side. Clusters have nothing in common. Within one, things count with a chance
    of its own, which is beta distributed about the share, with a correlation that is not known either: of both the
    posterior is integrated. One cluster, or clusters of which all counts, say little of the correlation: then it is
    wide. Clusters of one give the interval of Jeffreys.
    """
    counted = np.array([one for one in clusters if one[0]], dtype=np.float64).reshape(-1, 2)
    if not len(counted):
        return None
    alike, times = np.unique(counted, axis=0, return_counts=True)
    number, count = alike.T[:, :, np.newaxis, np.newaxis]
    # nodes of the share by the arcsine, in which the prior of Jeffreys is even
    share = (np.sin(0.5 * np.pi * (np.arange(SHARE.nodes) + 0.5) / SHARE.nodes) ** 2)[:, np.newaxis]
    correlation = ((np.arange(SHARE.correlations) + 0.5) / SHARE.correlations) ** 2
    total = (1.0 - correlation) / correlation
    a, b = share * total, (1.0 - share) * total
    likelihood = np.tensordot(times, betaln(a + count, b + number - count) - betaln(a, b), 1)
    # the prior of the correlation, times the distances of its nodes
    prior = (1.0 - correlation) ** SHARE.correlation_power * np.sqrt(correlation)
    weight = (np.exp(likelihood - likelihood.max()) * prior).sum(axis=1)
    below = np.cumsum(weight) - 0.5 * weight
    low, high = np.interp([tail, 1.0 - tail], below / weight.sum(), share[:, 0])
    whole = float(counted[:, 1].sum() / counted[:, 0].sum())
    return min(float(low), whole), max(float(high), whole)
