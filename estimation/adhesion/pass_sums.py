"""The sums of all passes of a section as arrays with an entry for every place of every pass, in order of place.

Vehicles and wheelsets that show another friction than the others at the same places are left out. What a load, a yaw
spring or a sensor is wrong by scales the 1/mu of one vehicle or wheelset against the others: the scale is where the sum
of squares of its passes is least, with the 1/mu that all passes together gave, its own slopes and error of creep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.adhesion.parameters import FileErrors
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.opinions import INVERSE, LeftOut, WindowAdhesion
from estimation.values.reasons import Reason, ReasonCode


@dataclass(frozen=True, slots=True)
class PassSums(FrozenArrays):
    """n entries at c places, of v vehicles and w wheelsets."""

    samples: Annotated[FloatArray, "n"]  # as in ``FrictionSums``
    squares: Annotated[FloatArray, "n", 6]
    saturated: Annotated[FloatArray, "n", 4, len(INVERSE)]
    place: Annotated[IntArray, "n"]  # index of the place, rising
    vehicle: Annotated[IntArray, "n"]  # index
    wheelset: Annotated[IntArray, "n"]  # index
    smoothed: Annotated[FloatArray, "n"]  # 1 where vibration was taken out of the forces, else 0
    cells: Annotated[IntArray, "k"]  # numbers of the places
    vehicles: tuple[str, ...]  # (v,) codes
    wheelsets: tuple[str, ...]  # (w,) serials

    @property
    def counts(self) -> IntArray:
        """How many passes there are of each place, (c,)."""
        return np.bincount(self.place, minlength=len(self.cells)).astype(np.int64)

    @property
    def vehicles_of_places(self) -> IntArray:
        """How many vehicles have passed each place, (c,)."""
        passed = np.unique(self.place * len(self.vehicles) + self.vehicle) // len(self.vehicles)
        return np.bincount(passed, minlength=len(self.cells)).astype(np.int64)

    def by_place(self, values: FloatArray) -> FloatArray:
        """Return the sums of values of entries, (n,) or (n, k), over each place, (c,) or (c, k)."""
        first = np.searchsorted(self.place, np.arange(len(self.cells)))
        return np.asarray(np.add.reduceat(values, first, axis=0), np.float64)

    def at(self, inverse: FloatArray) -> FloatArray:
        """Return the saturated sums (4, n) at 1/mu of the places, linear between those that are kept."""
        return self.at_each(inverse[self.place])

    def at_each(self, inverse: FloatArray) -> FloatArray:
        """Return the saturated sums (4, n), each at its own 1/mu; beyond those that are kept the last ones."""
        bounded = np.clip(inverse, INVERSE[0], INVERSE[-1])
        high = np.clip(np.searchsorted(INVERSE, bounded), 1, len(INVERSE) - 1)
        part = (bounded - INVERSE[high - 1]) / (INVERSE[high] - INVERSE[high - 1])
        entries = np.arange(len(self.place))
        low_values, high_values = self.saturated[entries, :, high - 1], self.saturated[entries, :, high]
        return np.asarray((low_values + part[:, None] * (high_values - low_values)).T)


def pass_sums(passes: Sequence[WindowAdhesion]) -> PassSums | None:
    """Return the sums of passes; None where none says anything."""
    ordered = sorted(passes, key=lambda one: one.key)
    known = [(one, one.sums) for one in ordered if one.sums is not None and len(one.sums.cells)]
    if not known:
        return None
    lengths = [len(sums.cells) for _, sums in known]
    cells, place = np.unique(np.concatenate([sums.cells for _, sums in known]), return_inverse=True)
    order = np.argsort(place, kind="stable")
    vehicles, vehicle = np.unique([one.vehicle for one, _ in known], return_inverse=True)
    wheelsets, wheelset = np.unique([one.wheelset for one, _ in known], return_inverse=True)
    return PassSums(
        np.concatenate([sums.samples for _, sums in known])[order],
        np.concatenate([sums.squares for _, sums in known])[order],
        np.concatenate([sums.saturated for _, sums in known])[order],
        place[order],
        np.repeat(vehicle, lengths)[order],
        np.repeat(wheelset, lengths)[order],
        np.repeat([float(one.smoothed) for one, _ in known], lengths)[order],
        cells,
        tuple(str(name) for name in vehicles),
        tuple(str(name) for name in wheelsets),
    )


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
    """Return the scales of groups of passes."""
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
