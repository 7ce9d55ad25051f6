"""A number that is known as a sum of normal distributions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate, Status


@dataclass(frozen=True, slots=True)
class NormalMixture:
    """A distribution as a sum of normals."""

    weight: FloatArray  # (m,), sums to 1
    mean: FloatArray  # (m,)
    std: FloatArray  # (m,)

    def above(self, limit: float) -> float:
        """Return the probability of a value above ``limit``."""
        return float(self.weight @ ndtr((self.mean - limit) / self.std))

    def quantile(self, probability: float) -> float:
        """Return the quantile of ``probability``."""
        low, high = float(np.min(self.mean - 9 * self.std)), float(np.max(self.mean + 9 * self.std))
        return float(brentq(lambda value: self.above(value) - (1.0 - probability), low, high, xtol=1e-9 * (high - low)))

    def estimate(self, count: float) -> Estimate:
        """Return mean, standard deviation and 95 % interval."""
        mean = float(self.weight @ self.mean)
        std = float(np.sqrt(self.weight @ (self.std**2 + (self.mean - mean) ** 2)))
        return Estimate(mean, std, self.quantile(0.025), self.quantile(0.975), count, Status.ESTIMATED)
