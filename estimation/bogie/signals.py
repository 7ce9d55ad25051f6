"""What both nodes of a bogie measure over one uninterrupted run, integrated, with the alignment under its axles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.bogie.parameters import BOGIE
from estimation.filters import remove_wander
from estimation.motion.integration import IntegratedSegment, IntegratedWindow
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays


@dataclass(frozen=True, slots=True)
class BogieRun(FrozenArrays):
    """Signals of a bogie over a run of n samples; the rows are those of its leading and of its trailing wheelset.

    In the axes of the vehicle as it travels. What is slow in rates and displacements carries no meaning.
    """

    interval_s: float
    speed: Annotated[FloatArray, "n"]  # V, m/s
    lateral: Annotated[FloatArray, 3, 2, "n"]  # y, y', y'' of the axles; m, s
    yaw: Annotated[FloatArray, 3, 2, "n"]  # psi, psi', psi''; rad, s
    roll: Annotated[FloatArray, 2, 2, "n"]  # phi, phi'; rad, s
    frame_lateral: Annotated[FloatArray, 2, "n"]  # y_f, y_f' of the middle of the frame; m, s
    frame_yaw: Annotated[FloatArray, 3, "n"]  # psi_f, psi_f', psi_f''; rad, s
    relative: Annotated[FloatArray, 2, "n"]  # y - d as EN 15302 means it, m
    ahead: Annotated[FloatArray, 2, "k"]  # d under the axles, m, from ``k - n`` samples before the run on

    def __len__(self) -> int:
        return len(self.speed)

    @property
    def run(self) -> FloatArray:
        """Distance run (n,), m, from 0."""
        steps = 0.5 * self.interval_s * (self.speed[1:] + self.speed[:-1])
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def track(self) -> FloatArray:
        """The alignment under the axles during the run (2, n), m."""
        return self.ahead[:, self.ahead.shape[1] - len(self) :]


def mixed_displacement(run: BogieRun, simulated: FloatArray) -> FloatArray:
    """Return by what the curves are looked up (2, n), m: measured waves, and the simulated ones beyond.

    Args:
        simulated: (2, n) y - d as EN 15302 means it, m.
    """
    known = np.ones(len(run), dtype=np.bool_)
    difference = remove_wander(run.relative - simulated, run.run, known, BOGIE.carried_wave)
    return np.asarray(simulated + smoothed(difference, run))


def smoothed(rows: FloatArray, run: BogieRun) -> FloatArray:
    """Return rows (m, n) without waves shorter than twice ``smoothed_m``: two running means along the run."""
    half = max(round(0.5 * BOGIE.smoothed_m / (float(np.mean(run.speed)) * run.interval_s)), 1)
    width = 2 * half + 1
    for _ in range(2):
        padded = np.pad(rows, ((0, 0), (half + 1, half)), mode="edge")
        sums = np.cumsum(padded, axis=1)
        rows = (sums[:, width:] - sums[:, :-width]) / width
    return np.asarray(rows)
