"""The friction along a section from the sums of its passes, pooled over the fleet: pure functions.

Over all passes of a place c the sum of squares of e - a_w x - b_v q - g(mu_c) is least. a_w is what the slope of the
curve of a wheelset is off by; b_v, common to all places of a vehicle, is by how much its linear creep differs from that
of its class: known beforehand with the std of creep coefficient and yaw spring, and of what the filter makes of the
moment, and measured against usual rails (``creep_levels``). What no b explains is saturation, whose share of the creep
grows with the force. Of a place 1/mu is known beforehand as ``usual`` with a wide std. With a and b known, what the
passes say of each place, and what all of them have wrong (``common_std``), is put together along the track
(``along_track``).

The level of creep is the same whether a section is slippery for the most part or all vehicles creep by more than their
class. More creep than two stds of what a class leaves open is unlikely for all
vehicles alike; then the shape decides: an error of linear creep leaves squares that no friction takes up, slippery
rails leave none of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtr, stdtrit

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.pass_sums import (
    Agreed,
    PassSums,
    along_track,
    common_std,
    contradicting,
    creep_levels,
    pass_sums,
)
from estimation.motion.parameters import MOTION
from estimation.values.arrays import FloatArray
from estimation.values.opinions import CellFriction, LeftOut, SectionAdhesion, WindowAdhesion
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import CELL_LENGTH, INVERSE
from estimation.values.units import MEDIAN_SQUARE, NORMAL_95


def slippery_throughout(
    sums: PassSums, creep: FloatArray, slope: FloatArray, creep_error_std: float, parameters: FrictionParameters
) -> bool:
    """Return whether it is the rails that make the creep of all vehicles large."""
    common = float(np.mean(creep))
    if common < parameters.most_creep_stds * creep_error_std:
        return False
    by_rails, by_creep = (_left(sums, b, slope) for b in (creep - common, creep))
    gg, gq = sums.saturated[:, 1], sums.saturated[:, 2]
    square = common**2 * float(sums.squares[:, 2].sum())
    error_alone = square + float(sums.by_place(gg - 2.0 * common * gq).min(axis=1).sum())
    return by_rails - by_creep < parameters.least_creep_support * error_alone


def _left(sums: PassSums, creep: FloatArray, slope: FloatArray) -> float:
    b, a = creep[sums.vehicle], slope[sums.wheelset]
    _, eq, qq, _, qx, _ = sums.squares.T
    linear = b * (b * qq - 2.0 * eq + 2.0 * a * qx)
    return float(linear.sum() + sums.by_place(_own_misfits(sums, creep, slope)).min(axis=1).sum())


TINY = np.finfo(float).tiny
NO_BOUND = Reason(ReasonCode.CREEP_TOO_SMALL, "creep shows no upper bound, and axle boxes that vibrate no lower one")


def section_adhesion(
    track_section: str, passes: Sequence[WindowAdhesion], parameters: FrictionParameters, length: float = math.inf
) -> SectionAdhesion | None:
    """Return the friction on the ``length`` (m) of a section and where it is low; None where no pass says anything."""
    telling = [window_pass for window_pass in passes if window_pass.sums is not None and len(window_pass.sums.cells)]
    pooled, left_out = pooled_friction(telling, parameters)
    cells = tuple(cell for cell in pooled if 0.0 <= cell.from_m < length)
    if not cells:
        return None
    starts = [window_pass.start_ns for window_pass in telling]
    return SectionAdhesion(
        track_section,
        min(starts),
        max(starts),
        len(_staying(telling, left_out)),
        cells,
        low_stretches(cells, parameters),
        left_out,
        certain_stretches(cells, parameters),
    )


def pooled_friction(
    passes: Sequence[WindowAdhesion], parameters: FrictionParameters
) -> tuple[tuple[CellFriction, ...], tuple[LeftOut, ...]]:
    """Return the friction of every place that passes have met, in order of distance, and whose passes are left out."""
    left_out: list[LeftOut] = []
    while (sums := pass_sums(_staying(passes, left_out))) is not None:
        solution = _solved(sums, parameters)
        more = contradicting(sums, solution, parameters.file, parameters)
        if not more:
            return _places(sums, solution, parameters), tuple(left_out)
        left_out.extend(more)
    return (), tuple(left_out)


def _staying(passes: Sequence[WindowAdhesion], left_out: Sequence[LeftOut]) -> Sequence[WindowAdhesion]:
    vehicles = {item.vehicle for item in left_out if item.wheelset is None}
    wheelsets = {item.wheelset for item in left_out}
    return [item for item in passes if item.vehicle not in vehicles and item.wheelset not in wheelsets]


def _places(sums: PassSums, solution: _Solution, parameters: FrictionParameters) -> tuple[CellFriction, ...]:
    counts, passed = sums.counts, np.unique(sums.place * len(sums.vehicles) + sums.vehicle) // len(sums.vehicles)
    vehicles = np.bincount(passed, minlength=len(sums.cells))
    # what noise and what is known beforehand leave to the passes of a place alone; about 1/mu g is in proportion to it
    inverse, noise = np.maximum(solution.inverse, TINY), max(solution.noise, TINY)
    precision = sums.by_place(sums.at(solution.inverse)[1]) / inverse**2 / noise
    alone_std = np.asarray(1.0 / np.sqrt(precision + 1.0 / parameters.usual_std**2))
    mean, std = _along(sums, solution, alone_std, parameters)
    _, gg, gq, _ = sums.by_place(sums.at(mean).T).T
    slope = np.asarray(mean * gq / np.maximum(gg, TINY))
    usual = slope[mean < 1.0 / parameters.low]
    by_creep = solution.left_creep_std * slope
    # the scale of a sensor makes a b at every friction, as at usual places
    by_scale = parameters.file.creep_std * (np.maximum(slope, np.median(usual)) if len(usual) else slope)
    smoothed = sums.by_place(sums.smoothed) > 0.0
    places = []
    for c, cell in enumerate(sums.cells):
        stds = float(alone_std[c]), float(std[c]), float(by_creep[c]), float(by_scale[c])
        place = _cell(int(cell), int(counts[c]), float(mean[c]), stds, parameters)
        if smoothed[c] and place.friction.value is None and place.at_least:  # such forces make the bound too high
            place = replace(place, friction=Estimate.unknown(NO_BOUND, place.friction.count), at_least=0.0)
        places.append(replace(place, vehicles=int(vehicles[c])))
    return tuple(places)


@dataclass(frozen=True, slots=True)
class _Solution(Agreed):
    creep: FloatArray  # (v,) b
    left_creep_std: float  # that a b of all vehicles is left
    common_std: FloatArray  # (c,) of 1/mu: by what all passes of a place have wrong


def _solved(sums: PassSums, parameters: FrictionParameters) -> _Solution:
    by_level = _in_turn(sums, parameters, None)
    if not slippery_throughout(sums, by_level.creep, by_level.slope, parameters.creep_error_std, parameters):
        return by_level
    return _in_turn(sums, parameters, (by_level.creep - by_level.creep.mean(), parameters.creep_error_std))


def _in_turn(sums: PassSums, parameters: FrictionParameters, given: tuple[FloatArray, float] | None) -> _Solution:
    """Return 1/mu, b (``given`` with its std, or by the level of creep), a and the noise, in turn until they hold."""
    creep, slope = np.zeros(len(sums.vehicles)), np.zeros(len(sums.wheelsets))
    inverse, common = _least(sums.by_place(_own_misfits(sums, creep, slope))), np.zeros(len(sums.cells))
    noise, left_std = _noise(sums, sums.at(inverse), creep, slope), 0.0
    for _ in range(parameters.rounds):
        creep, left_std = given or creep_levels(sums, slope, inverse > parameters.most_usual + common, parameters)
        inverse = _least(sums.by_place(_misfits(sums, creep, slope, noise, parameters)))
        saturated = sums.at(inverse)
        noise = _noise(sums, saturated, creep, slope)
        sloping = sums.squares[:, 3] - saturated[3] - creep[sums.vehicle] * sums.squares[:, 4]
        slope = np.bincount(sums.wheelset, sloping) / (np.bincount(sums.wheelset, sums.squares[:, 5]) + TINY)
        common = common_std(sums, inverse, creep, slope, parameters.usual, parameters)
    return _Solution(inverse, slope, noise, parameters.creep_error_std, creep, left_std, common)


def _noise(sums: PassSums, saturated: FloatArray, creep: FloatArray, slope: FloatArray) -> float:
    """Return the variance of e that the scatter of the passes about their common 1/mu shows, m2."""
    # the product of what is left of a pass with g has the variance of e, times its correlated samples, times g g
    ge, gg, gq, gx = saturated
    rest = ge - gg - creep[sums.vehicle] * gq - slope[sums.wheelset] * gx
    saturates = gg > 0.0
    return float(np.median(rest[saturates] ** 2 / gg[saturates]) / MEDIAN_SQUARE) if saturates.any() else 0.0


def _misfits(
    sums: PassSums, creep: FloatArray, slope: FloatArray, noise: float, parameters: FrictionParameters
) -> FloatArray:
    """Return the sums of squares (n, k) that every friction leaves of a pass at a place, but for a constant."""
    # what is known of the place beforehand is spread over its passes
    beforehand = noise * ((INVERSE - parameters.usual) / parameters.usual_std) ** 2
    return _own_misfits(sums, creep, slope) + beforehand / sums.counts[sums.place][:, None]


def _own_misfits(sums: PassSums, creep: FloatArray, slope: FloatArray) -> FloatArray:
    b, a = creep[sums.vehicle][:, None], slope[sums.wheelset][:, None]
    ge, gg, gq, gx = (sums.saturated[:, row] for row in range(4))
    return np.asarray(gg - 2.0 * ge + 2.0 * b * gq + 2.0 * a * gx)


def _least(misfits: FloatArray) -> FloatArray:
    """Return 1/mu (m,) where a parabola through the least of sums of squares (m, k) and its neighbours is least."""
    least = np.argmin(misfits, axis=1)
    middle, rows = np.clip(least, 1, len(INVERSE) - 2), np.arange(len(misfits))
    x0, x1, x2 = (INVERSE[middle + step] for step in (-1, 0, 1))
    y0, y1, y2 = (misfits[rows, middle + step] for step in (-1, 0, 1))
    falling, rising = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (rising - falling) / (x2 - x0)
    inside = (middle == least) & (bend > 0.0)
    lowest = 0.5 * (x0 + x1) - 0.5 * falling / np.where(inside, bend, 1.0)
    return np.asarray(np.where(inside, np.clip(lowest, x0, x2), INVERSE[least]))


def _along(
    sums: PassSums, solution: _Solution, alone_std: FloatArray, parameters: FrictionParameters
) -> tuple[FloatArray, FloatArray]:
    """Return 1/mu of the places and its std; passes that scatter by more than the noise say less of their place."""
    misfits = _misfits(sums, solution.creep, solution.slope, solution.noise, parameters)
    of_others, n = _least(sums.by_place(misfits)[sums.place] - misfits), sums.counts
    deviations = of_others - (sums.by_place(of_others) / n)[sums.place]
    scatter = np.sqrt((n - 1) / n * sums.by_place(deviations**2))
    widened = (alone_std / np.maximum(scatter, alone_std)) ** 2
    misfits = sums.by_place(_own_misfits(sums, solution.creep, solution.slope))
    smoothed = parameters.smoothed_std * sums.by_place(sums.smoothed) / sums.counts
    place_std = np.hypot(np.maximum(parameters.track_std, solution.common_std), smoothed)
    return along_track(sums.cells, misfits * widened[:, None] / max(solution.noise, TINY), place_std, parameters)


def _cell(
    cell: int, n: int, inverse: float, stds: tuple[float, float, float, float], parameters: FrictionParameters
) -> CellFriction:
    alone_std, sampled, by_creep, by_scale = stds
    if n < parameters.fewest_passes:
        few = Reason(ReasonCode.TOO_FEW_PASSES, f"{n} of {parameters.fewest_passes} passes that are needed")
        return CellFriction(cell, Estimate.unknown(few, float(n)), 0.0, 0.0, n)
    if alone_std > parameters.learnt_std_share * parameters.usual_std:
        small = Reason(ReasonCode.CREEP_TOO_SMALL, f"creep is so small in {n} passes that it shows no friction")
        return CellFriction(cell, Estimate.unknown(small, float(n)), 0.0, 0.0, n)
    # what more passes do not show, with sensors as on file, decides where friction is low
    decided = math.hypot(math.hypot(parameters.law_std, parameters.file.factor_std) * inverse, by_creep)
    systematic = math.hypot(decided, by_scale)
    half = math.hypot(float(stdtrit(n - 1, 0.975)) * sampled, NORMAL_95 * systematic)
    std = math.hypot(sampled, systematic)
    probability = float(stdtr(n - 1, (inverse - 1.0 / parameters.low) / math.hypot(sampled, decided)))
    low, high = 1.0 / (inverse + half), 1.0 / max(inverse - half, 1e-9)
    if high > parameters.least_upper:
        small = Reason(ReasonCode.CREEP_TOO_SMALL, f"the friction is at least {low:.2f}; creep shows no upper bound")
        return CellFriction(cell, Estimate.unknown(small, float(n)), low, probability, n)
    value = Estimate(1.0 / inverse, std / inverse**2, low, high, float(n), Status.ESTIMATED)
    return CellFriction(cell, value, low, probability, n)


def low_stretches(cells: Sequence[CellFriction], parameters: FrictionParameters) -> tuple[tuple[float, float], ...]:
    """Return where friction is low: (begin, end) in m of adjoining places, in order of distance."""
    # One place of a stretch, at least, is likely to be low by what vehicles agree on, or near to certain by what one
    # shows, and is no good rails; the stretch reaches as far as that is not unlikely. One other place may be between.
    # The creep of one vehicle is better known on a section where it is held against that of others.
    reached = min(parameters.at_ends, parameters.likely)
    beside = any(cell.vehicles >= parameters.fewest_vehicles for cell in cells)
    by_one = max(parameters.likely, parameters.beside_others if beside else parameters.certain)
    stretches: list[tuple[float, float, bool]] = []
    for cell in cells:
        if cell.friction.value is None or cell.low_probability < reached:
            continue
        agreed, high = cell.vehicles >= parameters.fewest_vehicles, cell.friction.high
        needed = parameters.likely if agreed else by_one
        shows = cell.low_probability >= needed and high is not None and high < parameters.good
        if stretches and cell.from_m - stretches[-1][1] <= CELL_LENGTH:
            begin, _, before = stretches.pop()
            stretches.append((begin, cell.to_m, before or shows))
        else:
            stretches.append((cell.from_m, cell.to_m, shows))
    return tuple((begin, end) for begin, end, shows in stretches if shows)


def certain_stretches(cells: Sequence[CellFriction], parameters: FrictionParameters) -> tuple[tuple[float, float], ...]:
    """Return where friction is certainly low: (begin, end) in m of adjoining places, in order of distance."""
    # a vehicle that is alone is certain of nothing: the geometries by which it judges the rails are its own
    certain = max(parameters.certain, parameters.likely)
    stretches: list[tuple[float, float]] = []
    for cell in cells:
        agreed = cell.vehicles >= parameters.fewest_vehicles and cell.friction.value is not None
        if not agreed or cell.low_probability < certain:
            continue
        begin = stretches.pop()[0] if stretches and stretches[-1][1] == cell.from_m else cell.from_m
        stretches.append((begin, cell.to_m))
    return tuple(stretches)


def touched(window: WindowAdhesion, stretches: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return the stretches of low friction that a window was on."""
    if window.sums is None or not len(window.sums.cells):
        return ()
    margin, cells = MOTION.low_friction_margin, window.sums.cells
    first, last = CELL_LENGTH * cells[0] - margin, CELL_LENGTH * (cells[-1] + 1) + margin
    return tuple((begin, end) for begin, end in stretches if begin < last and end > first)
