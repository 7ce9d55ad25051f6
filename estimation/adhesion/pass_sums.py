"""The sums of all passes of a section as arrays with an entry for every place of every pass, in order of place.

Vehicles and wheelsets that show another friction than the others at the same places are left out. What a load, a yaw
spring or a sensor is wrong by scales the 1/mu of one vehicle or wheelset against the others: the scale is where the sum
of squares of its passes is least, with the 1/mu that all passes together gave, its own slopes and error of creep.

The friction of places that adjoin: what passes say of each, and that friction mostly changes little over a place.

A chain over the places with 1/mu on a grid (a hidden Markov model, Rabiner 1989). From a place to the next one the
logarithm of 1/mu changes with a std; some places have nothing in common with the one before, as leaf fall has a
sharp end: they begin with what is known of rails beforehand.

What the passes of a place have wrong in common: the std of 1/mu that no pass more makes smaller.

All passes meet the same track: what its alignment, its gauge, its cross level and curves put into e is the same in all
of them, and their scatter does not show it. It is in what is left of e, though: were all of that common to the passes,
a place would be known as one pass alone would know it. How much of it is common the places show themselves. Creep
cannot be less than linear: a place that seems to say so is wrong by that much at least.

By how much the linear creep of vehicles differs from that of their class, from the level of their creep.

The level of a place is what e shows in proportion to q, whatever its shape. Half of the places of a section, at least,
are rails as rails are: over the places of a vehicle the median of what exceeds the creep of usual rails is its b, as
far as b is likely at all. The shape of e over q says nothing of b here: what alignment, curves, cross level and contact
jumps put into e has a shape, too, and quiet sensors would make it sure that a b of that shape, and rails of a tenth of
their friction, are there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.adhesion.creep_forces import FileErrors, FrictionParameters
from estimation.adhesion.parameters import FORCES
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.opinions import LeftOut, WindowAdhesion
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import INVERSE
from estimation.values.units import MEDIAN_ERROR, NORMAL_90, STD_PER_MAD


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
    ordered = sorted(passes, key=lambda window_pass: window_pass.key)
    with_sums = [(item, item.sums) for item in ordered if item.sums is not None and len(item.sums.cells)]
    if not with_sums:
        return None
    lengths = [len(sums.cells) for _, sums in with_sums]
    cells, place = np.unique(np.concatenate([sums.cells for _, sums in with_sums]), return_inverse=True)
    order = np.argsort(place, kind="stable")
    vehicles, vehicle = np.unique([item.vehicle for item, _ in with_sums], return_inverse=True)
    wheelsets, wheelset = np.unique([item.wheelset for item, _ in with_sums], return_inverse=True)
    return PassSums(
        np.concatenate([sums.samples for _, sums in with_sums])[order],
        np.concatenate([sums.squares for _, sums in with_sums])[order],
        np.concatenate([sums.saturated for _, sums in with_sums])[order],
        place[order],
        np.repeat(vehicle, lengths)[order],
        np.repeat(wheelset, lengths)[order],
        np.repeat([float(item.smoothed) for item, _ in with_sums], lengths)[order],
        cells,
        tuple(str(name) for name in vehicles),
        tuple(str(name) for name in wheelsets),
    )


SCALES = frozen_array(
    np.linspace(-FORCES.widest_scale, FORCES.widest_scale, FORCES.scale_points), (FORCES.scale_points,), name="SCALES"
)
"""(s,) logarithms of scales that are tried: a sixth to six times."""


TINY = np.finfo(float).tiny


@dataclass(frozen=True, slots=True)
class Scales(FrozenArrays):
    """Logarithms of the scales of 1/mu of g groups of passes."""

    logarithm: Annotated[FloatArray, "n"]
    misfits: Annotated[FloatArray, len(SCALES), "n"]  # sums of squares at ``SCALES`` over the noise, but for a constant

    def std_from(self, other: FloatArray) -> FloatArray:
        """Return the std (g,) of the difference from other logarithms that the misfit there says; infinite for none."""
        # the scale itself has nearly normal errors, its logarithm has not: a curvature would say too little
        there = np.array([np.interp(at, SCALES, misfit) for at, misfit in zip(other, self.misfits.T, strict=True)])
        more = there - self.misfits.min(axis=0)
        away = np.abs(np.clip(other, SCALES[0], SCALES[-1]) - self.logarithm)
        return np.where(more > 0.0, away / np.sqrt(np.where(more > 0.0, more, 1.0)), np.inf)

    @property
    def known(self) -> BoolArray:
        """(g,) those that a scale well below, or above the least of the grid, does not fit."""
        below = self.logarithm - FORCES.scale_reach
        beside = np.where(below >= SCALES[0], below, self.logarithm + FORCES.scale_reach)
        return np.asarray(self.std_from(beside) < FORCES.most_scale_std)


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
    weights = np.bincount(group, sums.squares[:, 2]) + agreed.noise / agreed.creep_std**2 + TINY
    misfits = np.empty((len(SCALES), len(weights)))
    for k, logarithm in enumerate(SCALES):
        ge, gg, gq, gx = sums.at_each(inverse * np.exp(logarithm))
        creep = np.bincount(group, sums.squares[:, 1] - gq - slope * sums.squares[:, 4]) / weights
        misfits[k] = np.bincount(group, gg - 2.0 * ge + 2.0 * slope * gx) - creep**2 * weights
    return Scales(_least(misfits), misfits / max(agreed.noise, TINY))


def _least(misfits: FloatArray) -> FloatArray:
    """Return where misfits (s, g) are least, by a parabola through the least and its neighbours."""
    step, groups = SCALES[1] - SCALES[0], np.arange(misfits.shape[1])
    least = np.argmin(misfits, axis=0)
    middle = np.clip(least, 1, len(SCALES) - 2)
    before, here, behind = (misfits[middle + place, groups] for place in (-1, 0, 1))
    bend = before - 2.0 * here + behind
    inside = (middle == least) & (bend > 0.0)
    moved = 0.5 * (before - behind) / np.where(inside, bend, 1.0)
    return np.asarray(np.where(inside, SCALES[middle] + moved * step, SCALES[least]))


def contradicting(
    sums: PassSums, agreed: Agreed, file: FileErrors, parameters: FrictionParameters
) -> Sequence[LeftOut]:
    """Return the vehicle that differs most from the others by more than is stated; if none, such wheelsets.

    One vehicle at a time, and one wheelset of each vehicle: what it is held against has part of its error, until it is
    left out.
    """
    by_vehicle, by_wheelset = (scales(sums, group, agreed) for group in (sums.vehicle, sums.wheelset))
    vehicle_of = np.zeros(len(by_wheelset.logarithm), np.int64)
    vehicle_of[sums.wheelset] = sums.vehicle
    known = by_vehicle.known
    if known.sum() < parameters.fewest_with_scale:
        return ()
    usual = np.full(len(known), np.median(by_vehicle.logarithm[known]))
    of_its_vehicle = by_vehicle.logarithm[vehicle_of]
    # a wheelset may have run under two vehicles meanwhile
    pairs = np.unique(sums.vehicle * len(sums.wheelsets) + sums.wheelset) // len(sums.wheelsets)
    scatter = parameters.wheelset_scatter / np.sqrt(np.bincount(pairs))
    stated = np.hypot(np.hypot(file.spring, file.load), scatter)
    deviation = _deviation(by_vehicle, usual, stated, known)
    vehicle = int(np.argmax(deviation))
    if deviation[vehicle] > parameters.most_deviation_stds:
        factor = float(np.exp(by_vehicle.logarithm[vehicle] - usual[vehicle]))
        return (_left_out(sums.vehicles[vehicle], None, factor, "the other vehicles"),)
    of_wheelset = np.full(len(of_its_vehicle), np.hypot(parameters.wheelset_scatter, file.spring))
    deviation = _deviation(by_wheelset, of_its_vehicle, of_wheelset, by_wheelset.known & known[vehicle_of])
    order = np.lexsort((-deviation, vehicle_of))
    worst = order[np.unique(vehicle_of[order], return_index=True)[1]]
    factors = np.exp(by_wheelset.logarithm - of_its_vehicle)
    return tuple(
        _left_out(sums.vehicles[vehicle_of[w]], sums.wheelsets[w], float(factors[w]), "the rest of its vehicle")
        for w in worst[deviation[worst] > parameters.most_deviation_stds]
    )


def _deviation(shown: Scales, usual: FloatArray, stated: FloatArray, known: BoolArray) -> FloatArray:
    """Return by how many stds of noise and ``stated`` known groups deviate from ``usual``; 0 for the others."""
    return np.where(known, np.abs(shown.logarithm - usual) / np.hypot(shown.std_from(usual), stated), 0.0)


def _left_out(vehicle: str, wheelset: str | None, factor: float, others: str) -> LeftOut:
    subject = f"vehicle {vehicle}" if wheelset is None else f"wheelset {wheelset}"
    text = f"{subject} shows {factor:.2f} times the 1/friction of {others} at the same places"
    return LeftOut(vehicle, wheelset, Reason(ReasonCode.FRICTION_DIFFERS, text))


GRID = frozen_array(np.geomspace(1.0, INVERSE[-1], FORCES.inverse_points), (FORCES.inverse_points,), name="GRID")
"""(g,) 1/mu, each a constant part above the one before: steps in the logarithm are alike."""


def along_track(
    cells: IntArray, misfits: FloatArray, place_std: FloatArray, parameters: FrictionParameters
) -> tuple[FloatArray, FloatArray]:
    """Return 1/mu of the places and its std (c,), each from all of them.

    Args:
        cells: (c,) numbers of the places, rising; the chain begins again behind a gap.
        misfits: (c, k) twice the negative logarithm of the likelihood at each of ``INVERSE``, but for a constant.
        place_std: (c,) error of 1/mu of each place that all its passes share.
    """
    width = np.gradient(GRID)
    prior = np.exp(-0.5 * ((GRID - parameters.usual) / parameters.usual_std) ** 2) * width
    prior /= prior.sum()
    logarithm = np.log(GRID)
    steps = np.exp(-0.5 * ((logarithm[:, None] - logarithm) / parameters.change_std) ** 2)
    steps = (1.0 - parameters.fresh) * steps / steps.sum(axis=1, keepdims=True) + parameters.fresh * prior
    values = CubicSpline(INVERSE, misfits, axis=1)(GRID)
    alone = np.exp(-0.5 * (values - values.min(axis=1, keepdims=True)))
    widened = np.empty_like(alone)
    wrong = parameters.wrong_place_share
    for std in np.unique(place_std):
        spread = (1.0 - wrong) * _spread(std, width) + wrong * _spread(parameters.wrong_factor * std, width)
        widened[place_std == std] = alone[place_std == std] @ spread.T
    likelihoods = np.asarray(widened / widened.max(axis=1, keepdims=True) + parameters.least_likelihood)
    adjoins = np.diff(cells) == 1
    forward, back = np.empty_like(likelihoods), np.ones_like(likelihoods)
    for place, likelihood in enumerate(likelihoods):
        before = forward[place - 1] @ steps if place and adjoins[place - 1] else prior
        forward[place] = _normal(before * likelihood)
    for place in range(len(cells) - 2, -1, -1):
        if adjoins[place]:
            back[place] = _normal(steps @ (back[place + 1] * likelihoods[place + 1]))
    posterior = forward * back
    posterior /= posterior.sum(axis=1, keepdims=True)
    mean = posterior @ GRID
    return mean, np.sqrt(np.maximum(posterior @ GRID**2 - mean**2, 0.0))


def _spread(std: float, width: FloatArray) -> FloatArray:
    """Return the probabilities (g, g) of what a place shows, by row, at each 1/mu that it may have, by column."""
    spread = np.exp(-0.5 * ((GRID[:, None] - GRID) / std) ** 2) * width
    return np.asarray(spread / spread.sum(axis=1, keepdims=True))


def _normal(values: FloatArray) -> FloatArray:
    return np.asarray(values / values.sum())


def common_std(
    sums: PassSums,
    inverse: FloatArray,
    creep: FloatArray,
    slope: FloatArray,
    usual: float,
    parameters: FrictionParameters,
) -> FloatArray:
    """Return the std of 1/mu (c,) that what all passes of a place have in common leaves."""
    b, a = creep[sums.vehicle], slope[sums.wheelset]
    _, gg, gq, _ = sums.at(np.full(len(sums.cells), usual))
    samples, left = sums.by_place(sums.samples), sums.by_place(_left(sums, inverse, b, a))
    variance = np.maximum(left / samples, left.sum() / samples.sum())
    one_pass = usual * np.sqrt(np.maximum(variance, 0.0) * sums.counts / (sums.by_place(gg) + TINY))
    level = sums.by_place(sums.squares[:, 1] - b * sums.squares[:, 2] - a * sums.squares[:, 4])
    by_level = usual * level / (sums.by_place(gq) + TINY)
    # in parts of what one pass leaves, from where places seem to be
    beyond = (by_level - parameters.best_inverse) / (one_pass + TINY)
    by_quantile = -float(np.quantile(beyond, parameters.below_best_share)) / NORMAL_90
    shown, places, prior = max(by_quantile, parameters.least_common_std), len(beyond), parameters.prior_places
    return np.asarray(float(np.sqrt((places * shown**2 + prior) / (places + prior))) * one_pass)


def _left(sums: PassSums, inverse: FloatArray, b: FloatArray, a: FloatArray) -> FloatArray:
    """Return the sum of squares (n,) of what is left of e; ``b`` and ``a`` (n,) are those of each entry."""
    ee, eq, qq, ex, qx, xx = sums.squares.T
    ge, gg, gq, gx = sums.at(inverse)
    linear = b * (b * qq - 2.0 * eq + 2.0 * gq) + a * (a * xx - 2.0 * ex + 2.0 * gx) + 2.0 * a * b * qx
    return np.asarray(np.maximum(ee + gg - 2.0 * ge + linear, 0.0))


def creep_levels(
    sums: PassSums, slope: FloatArray, slippery: BoolArray, before: FrictionParameters
) -> tuple[FloatArray, float]:
    """Return b (v,) of the vehicles, and the std that what all share leaves to it.

    A vehicle that has met ``slippery`` places (c,), no usual rails, for the most part is held against all of its.
    """
    usual = sums.at(np.full(len(sums.cells), before.usual))[2]
    entry = sums.vehicle * len(sums.cells) + sums.place
    left = sums.squares[:, 1] - slope[sums.wheelset] * sums.squares[:, 4] - usual
    passed, index = np.unique(entry, return_inverse=True)
    square = np.bincount(index, sums.squares[:, 2], len(passed)) + TINY
    exceeds, expected = np.bincount(index, left, len(passed)) / square, np.bincount(index, usual, len(passed)) / square
    vehicle = passed // len(sums.cells)
    by_rails = before.level_std * float(np.median(expected)) / before.usual
    usual_rails = ~slippery[passed % len(sums.cells)]
    exceeding = []
    for number in range(len(sums.vehicles)):
        of_vehicle = vehicle == number
        chosen = of_vehicle & usual_rails
        chosen = chosen if 2 * chosen.sum() >= of_vehicle.sum() else of_vehicle
        exceeding.append(_shrunk(exceeds[chosen], by_rails, before.creep_error_std))
    return np.array(exceeding), float(1.0 / np.sqrt(before.creep_error_std**-2 + by_rails**-2))


def _shrunk(exceeds: FloatArray, by_rails: float, likely: float) -> float:
    """Return the median of what places (p,) exceed the usual by, as far as a b of std ``likely`` is its cause."""
    middle = float(np.median(exceeds))
    spread = STD_PER_MAD * float(np.median(np.abs(exceeds - middle)))
    sampled = MEDIAN_ERROR * spread / np.sqrt(len(exceeds))
    return float(middle * likely**2 / (likely**2 + by_rails**2 + sampled**2))
