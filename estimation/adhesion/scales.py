"""Vehicles and wheelsets that show another friction than the others at the same places.

All passes of a place within the pooled hours share its friction. What a load, a yaw spring or a sensor is wrong by
scales the 1/mu of one vehicle or wheelset against the others: the scale is where the sum of squares of its passes is
least, with the 1/mu of the places that all passes together gave, its own slopes and an own error of linear creep. One
that differs by more than its class states is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.adhesion.file_errors import FileErrors
from estimation.adhesion.pass_sums import PassSums
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.opinions import LeftOut
from estimation.values.reasons import Reason, ReasonCode

GRID = frozen_array(np.linspace(-1.8, 1.8, 73), (73,), name="GRID")
"""(s,) logarithms of scales that are tried: a sixth to six times."""

WHEELSET_SCATTER = 0.1  # std of the logarithm of a wheelset's scale beside the noise: its curve and its profiles
FEWEST_VEHICLES = 3  # of two that contradict each other nobody knows which is wrong
MOST_DEVIATION = 3.0  # stds
MOST_STD = 0.25  # of the logarithm of a scale that is compared
FAR = 0.5  # of the logarithm: over which that std is measured
TINY = np.finfo(float).tiny


@dataclass(frozen=True, slots=True)
class Scales(FrozenArrays):
    """Logarithms of the scales of 1/mu of g groups of passes."""

    logarithm: Annotated[FloatArray, "n"]
    misfits: Annotated[FloatArray, len(GRID), "n"]  # sums of squares at ``GRID`` over the noise, but for a constant

    def std_from(self, other: FloatArray) -> FloatArray:
        """Return the std (g,) of the difference from other logarithms that the misfit there says; infinite for none.

        The scale itself has nearly normal errors, its logarithm has not: a curvature would say too little.

        Args:
            other: (g,).
        """
        there = np.array([np.interp(at, GRID, misfit) for at, misfit in zip(other, self.misfits.T, strict=True)])
        more = there - self.misfits.min(axis=0)
        away = np.abs(np.clip(other, GRID[0], GRID[-1]) - self.logarithm)
        return np.where(more > 0.0, away / np.sqrt(np.where(more > 0.0, more, 1.0)), np.inf)

    @property
    def known(self) -> BoolArray:
        """(g,) those that a scale well below, or above the least of the grid, does not fit."""
        below = self.logarithm - FAR
        return np.asarray(self.std_from(np.where(below >= GRID[0], below, self.logarithm + FAR)) < MOST_STD)


@dataclass(frozen=True, slots=True)
class Agreed:
    """What all passes agree on, against which each group is held."""

    inverse: FloatArray  # (c,) 1/mu
    slope: FloatArray  # (w,) a
    noise: float  # m2
    creep_std: float  # of b beforehand


def scales(sums: PassSums, group: IntArray, agreed: Agreed) -> Scales:
    """Return the scales of groups of passes.

    Args:
        group: (n,) index of the group of each entry.
        agreed: What all passes gave together.
    """
    inverse, slope = agreed.inverse[sums.place], agreed.slope[sums.wheelset]
    own = np.bincount(group, sums.squares[:, 2]) + agreed.noise / agreed.creep_std**2 + TINY
    misfits = np.empty((len(GRID), len(own)))
    for k, logarithm in enumerate(GRID):
        ge, gg, gq, gx = sums.at_each(inverse * np.exp(logarithm))
        creep = np.bincount(group, sums.squares[:, 1] - gq - slope * sums.squares[:, 4]) / own
        misfits[k] = np.bincount(group, gg - 2.0 * ge + 2.0 * slope * gx) - creep**2 * own
    return Scales(_least(misfits), misfits / max(agreed.noise, TINY))


def _least(misfits: FloatArray) -> FloatArray:
    """Return where misfits (s, g) are least, by a parabola through the least and its neighbours."""
    step, groups = GRID[1] - GRID[0], np.arange(misfits.shape[1])
    least = np.argmin(misfits, axis=0)
    at = np.clip(least, 1, len(GRID) - 2)
    before, own, behind = misfits[at - 1, groups], misfits[at, groups], misfits[at + 1, groups]
    bend = before - 2.0 * own + behind
    inside = (at == least) & (bend > 0.0)
    moved = 0.5 * (before - behind) / np.where(inside, bend, 1.0)
    return np.asarray(np.where(inside, GRID[at] + moved * step, GRID[least]))


def contradicting(sums: PassSums, agreed: Agreed, file: FileErrors) -> LeftOut | None:
    """Return the vehicle that differs most from the others by more than is stated; if none, such a wheelset; else None.

    One at a time: what all passes agree on has part of its error, until it is left out.

    Args:
        sums: Of all passes that are left.
    """
    by_vehicle, by_wheelset = (scales(sums, group, agreed) for group in (sums.vehicle, sums.wheelset))
    vehicle_of = np.zeros(len(by_wheelset.logarithm), np.int64)
    vehicle_of[sums.wheelset] = sums.vehicle
    known = by_vehicle.known
    if known.sum() < FEWEST_VEHICLES:
        return None
    usual = np.full(len(known), np.median(by_vehicle.logarithm[known]))
    own = by_vehicle.logarithm[vehicle_of]
    scatter = WHEELSET_SCATTER / np.sqrt(np.bincount(vehicle_of))
    stated = np.hypot(np.hypot(file.spring, file.load), scatter)
    vehicle = _most_deviating(by_vehicle, usual, stated, known)
    if vehicle is not None:
        factor = float(np.exp(by_vehicle.logarithm[vehicle] - usual[vehicle]))
        return _left_out(sums.vehicles[vehicle], None, factor, "the other vehicles")
    of_wheelset = np.full(len(own), np.hypot(WHEELSET_SCATTER, file.spring))
    wheelset = _most_deviating(by_wheelset, own, of_wheelset, by_wheelset.known & known[vehicle_of])
    if wheelset is None:
        return None
    factor = float(np.exp(by_wheelset.logarithm[wheelset] - own[wheelset]))
    return _left_out(sums.vehicles[vehicle_of[wheelset]], sums.wheelsets[wheelset], factor, "the rest of its vehicle")


def _most_deviating(found: Scales, usual: FloatArray, stated: FloatArray, known: BoolArray) -> int | None:
    """Return the known group that deviates most from ``usual``, in stds of noise and ``stated``; None for no such."""
    deviation = np.where(known, np.abs(found.logarithm - usual) / np.hypot(found.std_from(usual), stated), 0.0)
    worst = int(np.argmax(deviation))
    return worst if deviation[worst] > MOST_DEVIATION else None


def _left_out(vehicle: str, wheelset: str | None, factor: float, others: str) -> LeftOut:
    subject = f"vehicle {vehicle}" if wheelset is None else f"wheelset {wheelset}"
    text = f"{subject} shows {factor:.2f} times the 1/friction of {others} at the same places"
    return LeftOut(vehicle, wheelset, Reason(ReasonCode.FRICTION_DIFFERS, text))
