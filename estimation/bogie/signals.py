"""What both nodes of a bogie measure over one uninterrupted run, integrated, with the alignment under its axles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from estimation.bogie.parameters import BOGIE
from estimation.filters import remove_wander
from estimation.values.arrays import FloatArray, FrozenArrays


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
    stretch: float  # by which ``relative`` falls per rise of the alignment
    swapped: bool  # the axle of the higher number leads
    ahead: Annotated[FloatArray, 2, "k"]  # d under the axles, m, from ``k - n`` samples before the run on
    place: Annotated[FloatArray, 2, "k"]  # of the axles along the section, m, as far
    facing: int = 1  # -1 where the left of the vehicle is the right of the section

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

    @property
    def onward(self) -> float:
        """1 where it runs along the section, -1 where against it."""
        return float(np.sign(self.place[0, -1] - self.place[0, 0]))

    def over(self, ahead: FloatArray) -> BogieRun:
        """Return the run over another alignment (2, k), m."""
        more = ahead[:, ahead.shape[1] - len(self) :] - self.track
        return replace(self, ahead=ahead, relative=self.relative - self.stretch * more)


def mixed_displacement(run: BogieRun, simulated: FloatArray) -> FloatArray:
    """Return by what the curves are looked up (2, n), m: measured waves, and the simulated ones beyond.

    Args:
        simulated: (2, n) y - d as EN 15302 means it, m.
    """
    known = np.ones(len(run), dtype=np.bool_)
    difference = remove_wander(run.relative - simulated, run.run, known, BOGIE.carried_wave)
    return np.asarray(simulated + difference)


@dataclass(frozen=True, slots=True)
class Followed(FrozenArrays):
    """How a simulation follows what was measured, by wheelset."""

    likeness: Annotated[FloatArray, 2]  # correlation of y - d in the waves that are measured
    open_std: Annotated[FloatArray, 2]  # m, std of what the longer ones, which are simulated, may be off
    shift: float  # m, by which the bogie is further along the track than its positions say


def followed(run: BogieRun, simulated: FloatArray, lateral: FloatArray) -> Followed:
    """Return how a simulation follows a run; longer waves of y - d as much as those that are measured.

    Args:
        simulated: (2, n) y - d as EN 15302 means it, m.
        lateral: (2, n) y, m.
    """
    known = np.ones(len(run), dtype=np.bool_)
    rows = np.concatenate([run.relative, simulated, run.lateral[0], lateral])
    measured, ours, own, other = np.split(remove_wander(rows, run.run, known, BOGIE.carried_wave), 4)
    alike = np.array([np.corrcoef(measured[axle], ours[axle])[0, 1] for axle in range(2)])
    slope = np.gradient(other, run.run, axis=1)
    shift = float(np.sum(slope * (own - other)) / max(float(np.sum(slope**2)), BOGIE.least_slope))
    return Followed(alike, (simulated - ours).std(axis=1) * np.sqrt(2.0 * np.clip(1.0 - alike, 0.0, 1.0)), shift)


def placed(run: BogieRun, shift: float) -> BogieRun:
    """Return a run that is further along the track, by a shift, m."""
    shift = min(max(shift, -BOGIE.most_shift), BOGIE.most_shift)
    before = run.ahead.shape[1] - len(run)
    way = np.concatenate([float(run.speed[0]) * run.interval_s * np.arange(-before, 0), run.run])
    ahead = np.stack([np.interp(way + shift, way, row) for row in run.ahead])
    return replace(run.over(ahead), place=run.place + run.onward * shift)
