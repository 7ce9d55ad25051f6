"""Where and how curves are compared with measured ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class AccuracyParameters:
    """Where and how curves are compared with measured ones."""

    # fleet accuracy
    tail_probability: float = 0.025  # on either side of a 95 % interval
    search_reach: float = 0.6e-3  # m
    search_step: float = 5e-6  # m
    most_bin_stds: float = 3.0  # standard deviations that one bin counts at most
    # wheel contact
    displacement_reach: float = 12e-3  # m: an amplitude of 8 mm about a centre that is 4 mm off
    displacement_step: float = 0.1e-3  # m
    amplitudes: tuple[float, ...] = (1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3, 7e-3, 8e-3)  # m

    def displacement(self) -> FloatArray:
        """Return where curves are compared (n,), m."""
        steps = round(self.displacement_reach / self.displacement_step)
        return np.asarray(self.displacement_step * np.arange(-steps, steps + 1), dtype=np.float64)


ACCURACY = AccuracyParameters()


@dataclass(frozen=True, slots=True)
class ShareParameters:
    """How the interval of a share is integrated; only what is shown of an accuracy depends on it."""

    nodes: int = 200  # of the share
    correlations: int = 30  # nodes of the correlation within a cluster
    # density (1 - correlation)^this: of an even one it would take 50 fleets that hold all to show that this is too much
    correlation_power: float = 1.0


SHARE = ShareParameters()
