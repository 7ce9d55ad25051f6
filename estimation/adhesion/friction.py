"""The friction along a section from the sums of its passes, pooled over the fleet: pure functions.

Over all passes of a place c the sum of squares of e - a_w x - b_v q - g(mu_c) is least. a_w is what the slope of the
curve of a wheelset is off by; b_v, common to all places of a vehicle, is by how much its linear creep differs from that
of its class: known beforehand with the std of creep coefficient and yaw spring, and of what the filter makes of the
moment. What no b explains is saturation, whose share of the creep grows with the force. Of a place 1/mu is known
beforehand as ``usual`` with a wide std: on the whole the rails are as rails are, which is what b is measured against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from estimation.values.adhesion import CELL_LENGTH, INVERSE, CellFriction, SectionAdhesion, WindowAdhesion
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.intervals import NORMAL_95
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode

LEARNT = 0.7  # of the std beforehand: with more, the passes say nothing of a place
TINY = np.finfo(float).tiny
MEDIAN_SQUARE = 0.4549  # of a standard normal variable


@dataclass(frozen=True, slots=True)
class FrictionParameters:
    """When friction is published, and when it is low."""

    low: float = 0.15  # limit of low adhesion
    likely: float = 0.5  # probability of a friction below the limit from which a place has low adhesion
    fewest_passes: int = 3  # of wheelsets
    creep_error_std: float = 0.1  # of b, relative
    usual: float = 3.3  # 1/mu of rails that nothing is known of: a friction of 0.3
    usual_std: float = 3.0  # of it
    most_usual: float = 5.0  # 1/mu of places that show b: where creep is far from linear its law matters more
    law_std: float = 0.1  # of 1/mu, relative: creep laws differ
    track_std: float = 0.8  # of 1/mu: the error of the alignment is the same in all passes
    neighbours: float = 0.25  # weight of the places next to one: friction changes over some 100 m
    least_upper: float = 0.6  # an interval that reaches beyond says no more than a lower bound
    rounds: int = 12


@dataclass(frozen=True, slots=True)
class _Stack:
    """Sums of all passes in arrays: p of them in every place of c."""

    squares: FloatArray  # (p, c, 6)
    saturated: FloatArray  # (p, c, 4, k)
    there: BoolArray  # (p, c)
    vehicle: IntArray  # (p,)
    wheelset: IntArray  # (p,)
    cells: IntArray  # (c,)


def section_adhesion(
    track_section: str, passes: Sequence[WindowAdhesion], parameters: FrictionParameters
) -> SectionAdhesion | None:
    """Return the friction along a section and where it is low; None where no pass says anything.

    Parameters
    ----------
    track_section
        Code of the section.
    passes
        Of it, over the time that is pooled, in any order.
    parameters
        Limits and what is known beforehand.
    """
    known = [one for one in passes if one.sums is not None and len(one.sums.cells)]
    if not known:
        return None
    cells = section_friction(known, parameters)
    starts = [one.start_ns for one in known]
    stretches = low_stretches(cells, parameters)
    return SectionAdhesion(track_section, min(starts), max(starts), len(known), cells, stretches)


def section_friction(passes: Sequence[WindowAdhesion], parameters: FrictionParameters) -> tuple[CellFriction, ...]:
    """Return the friction of every place that passes have met, in order of distance.

    Parameters
    ----------
    passes
        Of one section over the time that is pooled, in any order; those without sums say nothing.
    parameters
        Limits and what is known beforehand.
    """
    known = sorted((one for one in passes if one.sums is not None and len(one.sums.cells)), key=lambda one: one.key)
    if not known:
        return ()
    stack = _stacked(known)
    found = _solved(stack, parameters)
    misfits = _with_neighbours(stack, _misfits(stack, found.creep, found.slope, found.noise, parameters), parameters)
    inverse = np.array([_least(misfit) for misfit in misfits.sum(axis=0)])
    by_creep = found.creep_std * _slope(stack, found.inverse)
    left = _left_std(stack, found, parameters)
    return tuple(
        _cell(int(cell), float(inverse[c]), misfits[stack.there[:, c], c], by_creep[c], left[c], parameters)
        for c, cell in enumerate(stack.cells)
    )


def _stacked(passes: Sequence[WindowAdhesion]) -> _Stack:
    sums = [one.sums for one in passes if one.sums is not None]
    cells = np.unique(np.concatenate([one.cells for one in sums]))
    p, c = len(sums), len(cells)
    squares, saturated = np.zeros((p, c, 6)), np.zeros((p, c, 4, len(INVERSE)))
    there = np.zeros((p, c), np.bool_)
    for i, one in enumerate(sums):
        at = np.searchsorted(cells, one.cells)
        squares[i, at], saturated[i, at], there[i, at] = one.squares, one.saturated, True
    vehicle, wheelset = _numbers([one.vehicle for one in passes]), _numbers([one.wheelset for one in passes])
    return _Stack(squares, saturated, there, vehicle, wheelset, cells)


def _numbers(names: Sequence[str]) -> IntArray:
    return np.unique(np.array(names), return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True, slots=True)
class _Solution:
    """What all passes of a section agree on."""

    inverse: FloatArray  # (c,) 1/mu
    creep: FloatArray  # (v,) b
    slope: FloatArray  # (w,) a
    noise: float  # m2: variance of e times the samples that say as much as one
    creep_std: float  # that a b of all vehicles is left


def _solved(stack: _Stack, parameters: FrictionParameters) -> _Solution:
    """Return 1/mu of the places, b of the vehicles, a of the wheelsets, and the noise, in turn until they hold."""
    creep, slope = np.zeros(int(stack.vehicle.max()) + 1), np.zeros(int(stack.wheelset.max()) + 1)
    inverse = np.full(len(stack.cells), parameters.usual)
    noise = stack.squares[..., 0].sum() / max(int(stack.there.sum()), 1)
    for _ in range(parameters.rounds):
        misfits = _misfits(stack, creep, slope, noise, parameters)
        inverse = np.array([_least(misfit) for misfit in misfits.sum(axis=0)])
        at = _at(stack, inverse)
        noise = _noise(stack, at, creep, slope)
        prior = noise / parameters.creep_error_std**2
        usual = inverse < parameters.most_usual
        b, a = creep[stack.vehicle][:, None], slope[stack.wheelset][:, None]
        left = (stack.squares[..., 1] - at[2] - a * stack.squares[..., 4])[:, usual].sum(axis=1)
        own = stack.squares[:, usual, 2].sum(axis=1)
        creep = np.bincount(stack.vehicle, left) / (np.bincount(stack.vehicle, own) + prior)
        left = (stack.squares[..., 3] - at[3] - b * stack.squares[..., 4]).sum(axis=1)
        own = stack.squares[..., 5].sum(axis=1)
        slope = np.bincount(stack.wheelset, left) / (np.bincount(stack.wheelset, own) + TINY)
    return _Solution(inverse, creep, slope, noise, _creep_std(stack, inverse, noise, parameters))


def _at(stack: _Stack, inverse: FloatArray) -> FloatArray:
    """Return the saturated sums (4, p, c) at 1/mu (c,) of the places, linear between those that are kept."""
    high = np.clip(np.searchsorted(INVERSE, inverse), 1, len(INVERSE) - 1)
    part = (inverse - INVERSE[high - 1]) / (INVERSE[high] - INVERSE[high - 1])
    places = np.arange(len(inverse))
    low_values, high_values = stack.saturated[:, places, :, high - 1], stack.saturated[:, places, :, high]
    return np.asarray(np.moveaxis(low_values + part[:, None, None] * (high_values - low_values), (0, 2), (2, 0)))


def _noise(stack: _Stack, at: FloatArray, creep: FloatArray, slope: FloatArray) -> float:
    """Return the variance of e that the scatter of the passes about their common 1/mu shows, m2.

    The product of what is left of a pass with g has the variance of e, times its correlated samples, times g g.
    """
    ge, gg, gq, gx = at
    left = ge - gg - creep[stack.vehicle][:, None] * gq - slope[stack.wheelset][:, None] * gx
    there = gg > 0.0
    return float(np.median(left[there] ** 2 / gg[there]) / MEDIAN_SQUARE) if there.any() else 0.0


def _creep_std(stack: _Stack, inverse: FloatArray, noise: float, parameters: FrictionParameters) -> float:
    """Return the std of a b that all vehicles share, every 1/mu unknown: about 1/mu, g is in proportion to it."""
    _, gg, gq, _ = _at(stack, inverse).sum(axis=1)
    own = gg / inverse**2 + noise / parameters.usual_std**2
    left = stack.squares[..., 2].sum() - ((gq / inverse) ** 2 / own).sum()
    return float(1.0 / np.sqrt(max(left, 0.0) / noise + 1.0 / parameters.creep_error_std**2))


def _misfits(
    stack: _Stack, creep: FloatArray, slope: FloatArray, noise: float, parameters: FrictionParameters
) -> FloatArray:
    """Return the sums of squares (p, c, k) that every friction leaves of the passes of a place, but for a constant.

    What is known of it beforehand is spread over the passes.
    """
    b, a = creep[stack.vehicle][:, None, None], slope[stack.wheelset][:, None, None]
    ge, gg, gq, gx = (stack.saturated[:, :, row] for row in range(4))
    known = noise * ((INVERSE - parameters.usual) / parameters.usual_std) ** 2
    shared = known / np.maximum(stack.there.sum(axis=0), 1)[:, None]
    return np.asarray(gg - 2.0 * ge + 2.0 * b * gq + 2.0 * a * gx + stack.there[:, :, None] * shared)


def _least(misfit: FloatArray) -> float:
    """Return 1/mu where a parabola through the least sum of squares and its neighbours is least."""
    at = int(np.argmin(misfit))
    if at in {0, len(misfit) - 1}:
        return float(INVERSE[at])
    x, y = INVERSE[at - 1 : at + 2], misfit[at - 1 : at + 2]
    left, right = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    bend = (right - left) / (x[2] - x[0])
    if bend <= 0.0:
        return float(x[1])
    return float(np.clip(0.5 * (x[0] + x[1]) - 0.5 * left / bend, x[0], x[2]))


def _with_neighbours(stack: _Stack, misfits: FloatArray, parameters: FrictionParameters) -> FloatArray:
    """Return sums of squares (p, c, k) with a share of those of the places before and behind."""
    adjoining = (np.diff(stack.cells) == 1)[None, :, None]
    shared = parameters.neighbours * adjoining
    found = misfits.copy()
    found[:, 1:] += shared * misfits[:, :-1]
    found[:, :-1] += shared * misfits[:, 1:]
    return found


def _left_std(stack: _Stack, found: _Solution, parameters: FrictionParameters) -> FloatArray:
    """Return the std of 1/mu (c,) that noise and what is known beforehand leave: the spread of few passes may be small.

    About 1/mu g is in proportion to it.
    """
    _, gg, _, _ = _at(stack, found.inverse).sum(axis=1)
    known = gg / np.maximum(found.inverse, TINY) ** 2 / max(found.noise, TINY)
    return np.asarray(1.0 / np.sqrt(known + 1.0 / parameters.usual_std**2))


def _slope(stack: _Stack, inverse: FloatArray) -> FloatArray:
    """Return by how much 1/mu (c,) falls as b of all vehicles rises."""
    _, gg, gq, _ = _at(stack, inverse).sum(axis=1)
    return np.asarray(inverse * gq / np.maximum(gg, TINY))


def _cell(
    cell: int, inverse: float, misfits: FloatArray, by_creep: float, left: float, parameters: FrictionParameters
) -> CellFriction:
    """Return the friction of a place from the sums of squares (n, k) of its passes."""
    n = len(misfits)
    if n < parameters.fewest_passes:
        few = Reason(ReasonCode.TOO_FEW_PASSES, f"{n} of {parameters.fewest_passes} passes that are needed")
        return CellFriction(cell, Estimate.unknown(few, float(n)), 0.0, 0.0, n)
    left_out = np.array([_least(misfits.sum(axis=0) - own) for own in misfits])
    if left > LEARNT * parameters.usual_std:
        small = Reason(ReasonCode.CREEP_TOO_SMALL, f"creep is so small in {n} passes that it shows no friction")
        return CellFriction(cell, Estimate.unknown(small, float(n)), 0.0, 0.0, n)
    sampled = max(left, float(np.sqrt((n - 1) / n * ((left_out - left_out.mean()) ** 2).sum())))
    systematic = float(np.sqrt((parameters.law_std * inverse) ** 2 + parameters.track_std**2 + by_creep**2))
    half = float(np.hypot(stdtrit(n - 1, 0.975) * sampled, NORMAL_95 * systematic))
    std = float(np.hypot(sampled, systematic))
    probability = float(stdtr(n - 1, (inverse - 1.0 / parameters.low) / std))
    low, high = 1.0 / (inverse + half), 1.0 / max(inverse - half, 1e-9)
    if high > parameters.least_upper:
        small = Reason(ReasonCode.CREEP_TOO_SMALL, f"the friction is at least {low:.2f}; creep shows no upper bound")
        return CellFriction(cell, Estimate.unknown(small, float(n)), low, probability, n)
    value = Estimate(1.0 / inverse, std / inverse**2, low, high, float(n), Status.ESTIMATED)
    return CellFriction(cell, value, low, probability, n)


def low_stretches(cells: Sequence[CellFriction], parameters: FrictionParameters) -> tuple[tuple[float, float], ...]:
    """Return where friction is low: (begin, end) in m of adjoining places, in order of distance.

    Parameters
    ----------
    cells
        Of one section, in order of distance.
    parameters
        The probability from which a place counts.
    """
    found: list[tuple[float, float]] = []
    for one in cells:
        if one.friction.value is None or one.low_probability < parameters.likely:
            continue
        if found and one.from_m - found[-1][1] <= CELL_LENGTH:
            found[-1] = (found[-1][0], one.to_m)
        else:
            found.append((one.from_m, one.to_m))
    return tuple(found)
