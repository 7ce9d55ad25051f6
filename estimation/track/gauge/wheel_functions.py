"""One radius function per wheel, where a gauge deviation puts the wheelset, and what a first guess of that is.

With x = y - d and e the gauge deviation, the left wheel sits at x - e/2 against its rail and the right one at -x - e/2,
positive towards the flange, so R(x, e) = rho_L(x - e/2) - rho_R(-x - e/2): linear in hat functions of the two. Solved
for x it gives where the wheelset runs at a given R and e.

A residual of a panel without gauge is nearly e(s) h1(R), so the leading eigenvectors of the covariance of residuals at
one place over (wheelset, R) are h1 and what the gauge's square does; a trial shows which mixture h1 is. Passes at a
place mostly have R of one sign: wheelsets are taken as alike on both sides, h1(-R) = -h1(R).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from estimation.track.gauge.search import GaugePrior, gauge_step, with_gauge_effect
from estimation.track.gridded_pass import GriddedPass, grid_pass
from estimation.track.panel.basis import (
    Panel,
    basis_functions,
    curve_displacement,
    gauge_at,
    gauge_curves,
    init,
    known_shift,
    pass_residual,
    update,
)
from estimation.track.panel.solution import PanelSolution, residual_of_passes, result
from estimation.track.passes import Pass, ProfileLife
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.quantities import jackknife_std
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class WheelFunctionParameters:
    """How wheel functions are fitted to passes on gauge that varies."""

    knot_step: float = 0.125e-3  # m
    roughness_weight: float = 1e-5  # relative to the data
    inlier_misfit: float = 0.5e-3  # m of misfit: further off are impacts and their filtered traces
    least_slope: float = 0.02  # of R over x: no wheelset has less
    size_factors: tuple[float, ...] = (0.5, 0.65, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0)
    most_wheelsets: int = 6  # that a factor is estimated from
    far_quantile: float = 0.8  # quantile of |R|
    most_residual: float = 1e-3  # m of residual
    least_knot_samples: float = 300.0  # samples of a knot that count
    gauge_effect: float = 0.2  # m of h1 for a metre of gauge, rms: half is the most, at the flange
    mixture_angles_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0)  # degrees between the two leading vectors
    trial_length: float = 4000.0  # m
    least_gauge_std: float = 0.3e-3  # m, std in the first trial: noise alone makes less, and as little would not matter
    knots: int = 80  # to either side
    most_difference: float = 6e-3  # m of R, of a gauge shift
    difference_points: int = 161
    gauge_step: float = 0.25e-3  # m
    gauges: int = 32  # to either side
    reach_step: float = 25e-6  # m of x in which R is looked for
    reach_points: int = 440  # to either side


WHEELS = WheelFunctionParameters()
KNOTS: FloatArray = np.asarray(WHEELS.knot_step * np.arange(-WHEELS.knots, WHEELS.knots + 1), dtype=np.float64)  # m
DIFFERENCES = np.linspace(-WHEELS.most_difference, WHEELS.most_difference, WHEELS.difference_points)
GAUGES: FloatArray = np.asarray(WHEELS.gauge_step * np.arange(-WHEELS.gauges, WHEELS.gauges + 1), dtype=np.float64)  # m
REACH = WHEELS.reach_step * np.arange(-WHEELS.reach_points, WHEELS.reach_points + 1)
CURVE_KNOTS = DIFFERENCES[::2]  # m


@dataclass(frozen=True, slots=True)
class WheelFunctions(FrozenArrays):
    """Radius of each wheel against its own lateral position, positive towards the flange, up to a constant."""

    knots: Annotated[FloatArray, "n"]  # m, increasing
    left: Annotated[FloatArray, "n"]  # m
    right: Annotated[FloatArray, "n"]  # m

    def difference(self, displacement: FloatArray, gauge_deviation: FloatArray) -> FloatArray:
        """Return rL - rR, m, at y - d and gauge deviation, m; arrays of one shape."""
        half = 0.5 * gauge_deviation
        left = np.interp(displacement - half, self.knots, self.left)
        return np.asarray(left - np.interp(-displacement - half, self.knots, self.right))


@dataclass(frozen=True, slots=True)
class ContactSamples:
    """Where one wheelset sat: x = y - d whole, how far from the model, R, and the gauge deviation (n,), m."""

    displacement: FloatArray
    misfit: FloatArray
    difference: FloatArray
    gauge: FloatArray

    def inliers(self, every: int = 1) -> ContactSamples:
        """Return every so many of those that the model reaches."""
        near = np.flatnonzero(np.abs(self.misfit) < WHEELS.inlier_misfit)[::every]
        return ContactSamples(self.displacement[near], self.misfit[near], self.difference[near], self.gauge[near])


def contact_samples(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel
) -> dict[ProfileLife, ContactSamples]:
    """Return where every wheelset sat, seen from itself; what the filter takes from y - d is put back from h(R, e)."""
    found: dict[ProfileLife, list[FloatArray]] = {}
    for item, curve in solution.used(passes):
        d = np.where(item.inside, solution.alignment[np.clip(item.points, 0, panel.grid.points - 1)], np.nan)
        misfit = item.side * (pass_residual(item, curve, panel) - d)
        without_stiffness = curve_displacement(item, curve, panel) - curve[-1] * item.stiffness_term
        model = without_stiffness + item.side * known_shift(item, panel)
        known: BoolArray = np.isfinite(misfit) & (np.abs(item.difference) < panel.parameters.reach)
        rows = np.stack([model + misfit, misfit, item.difference, gauge_at(item.points, panel)])
        found.setdefault(item.life, []).append(rows[:, known])
    return {name: ContactSamples(*np.concatenate(rows, axis=1)) for name, rows in found.items()}


def fit_wheels(seen: ContactSamples, factor: float = 1.0) -> WheelFunctions:
    """Return the functions of the wheels of one wheelset, gauge deviations taken ``factor`` times."""
    x, half = seen.displacement, 0.5 * factor * seen.gauge
    B = sparse.hstack([_hats(x - half, KNOTS), -_hats(-x - half, KNOTS)]).tocsr()
    normal, k = B.T @ B, len(KNOTS)
    scale = normal.diagonal().mean()
    bend = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(k - 2, k))
    smooth = sparse.block_diag([bend.T @ bend, bend.T @ bend])
    level = sparse.csr_matrix(np.ones((1, 2 * k)) / k)  # a constant belongs to either wheel
    known = scale * (WHEELS.roughness_weight * smooth + 1e-10 * sparse.eye(2 * k) + 1e-6 * (level.T @ level))
    both = spsolve((normal + known).tocsc(), B.T @ seen.difference)
    return WheelFunctions(KNOTS, both[:k], both[k:])


def gauge_shift_of(wheels: WheelFunctions) -> GaugeShift:
    """Return where a gauge deviation puts a wheelset with ``wheels``: R(x, e) solved for x, less that at e = 0."""
    x, e = np.meshgrid(REACH, GAUGES, indexing="ij")
    R = wheels.difference(x, e)
    rise = np.maximum(np.diff(R, axis=0), WHEELS.least_slope * np.diff(REACH)[:, None])  # jumps down are never run
    rising = np.concatenate([np.zeros((1, len(GAUGES))), np.cumsum(rise, axis=0)])
    middle = len(REACH) // 2
    rising += R[middle] - rising[middle]
    at = np.stack([np.interp(DIFFERENCES, rising[:, j], REACH) for j in range(len(GAUGES))], axis=1)
    return GaugeShift(DIFFERENCES, GAUGES, at - at[:, [len(GAUGES) // 2]])


def remove_common_shift(shifts: Mapping[ProfileLife, GaugeShift]) -> dict[ProfileLife, GaugeShift]:
    """Return the shifts less their mean at R = 0: a shift of all wheelsets alike cannot be separated from the track."""
    mean = np.mean([shift.shift[len(DIFFERENCES) // 2] for shift in shifts.values()], axis=0)
    return {name: replace(one, shift=one.shift - mean) for name, one in shifts.items()}


def total_gauge_shifts(solution: PanelSolution, panel: Panel) -> dict[ProfileLife, GaugeShift]:
    """Return all that the gauge does: what the panel knew beforehand, and h1 and h2 on top, as far as e was met."""
    assert panel.gauge is not None
    p, largest = panel.parameters, float(np.abs(panel.gauge).max())
    e = np.clip(GAUGES, -largest, largest) / p.gauge_unit
    R = np.clip(DIFFERENCES, -p.reach, p.reach)
    found = {}
    for name, curve in zip(solution.lives, solution.curves[0], strict=True):
        first, second = (np.interp(R, p.gauge_knots, values) for values in gauge_curves(curve, panel))
        shift = np.outer(first, e) + np.outer(second, e * e)
        known = panel.gauge_shifts.get(name)
        found[name] = GaugeShift(DIFFERENCES, GAUGES, shift if known is None else shift + known.shift)
    return found


def gauge_factor(seen: Mapping[ProfileLife, ContactSamples]) -> float:
    """Return what estimated gauge deviations are to be multiplied with: h1 and e share a factor, a wheel has none."""
    return _best_factor(_misfits_by_factor(seen).sum(axis=0))


def gauge_factor_with_std(seen: Mapping[ProfileLife, ContactSamples]) -> tuple[float, float]:
    """Return ``gauge_factor`` and the std of its logarithm, by leaving out each wheelset; NaN of a single one."""
    misfits = _misfits_by_factor(seen)
    whole = _best_factor(misfits.sum(axis=0))
    without = [_best_factor(np.delete(misfits, row, axis=0).sum(axis=0)) for row in range(len(misfits))]
    return whole, float(jackknife_std(np.log([whole, *without])))


def _misfits_by_factor(seen: Mapping[ProfileLife, ContactSamples]) -> FloatArray:
    """Return how badly the wheels of some wheelsets fit with each factor (w, f), m2."""
    most = WHEELS.most_wheelsets
    some = [one.inliers(2) for _, one in sorted(seen.items())][:: max(len(seen) // most, 1)][:most]
    return np.array([[_misfit_wheels(one, factor) for factor in WHEELS.size_factors] for one in some])


def _best_factor(misfits: FloatArray) -> float:
    best = min(max(int(np.argmin(misfits)), 1), len(WHEELS.size_factors) - 2)
    near = slice(best - 1, best + 2)
    bend, slope, _ = np.polyfit(np.log(WHEELS.size_factors[near]), misfits[near], 2)
    if bend <= 0:
        return WHEELS.size_factors[best]
    return float(np.clip(np.exp(-slope / (2 * bend)), WHEELS.size_factors[best - 1], WHEELS.size_factors[best + 1]))


def gauge_sign(seen: Mapping[ProfileLife, ContactSamples], shifts: Mapping[ProfileLife, GaugeShift]) -> int:
    """Return the sign that estimated gauge deviations are to be multiplied with."""
    # It is not in the passes: left and right wheel of opposite shape fit as well with the opposite sign. It is taken
    # from what wheels are, steeper towards the flange: far from the centre a wheelset runs further out in wide gauge.
    outwards = 0.0  # per millimetre of gauge
    for name, one in seen.items():
        R = one.difference[np.abs(one.difference) >= np.quantile(np.abs(one.difference), WHEELS.far_quantile)]
        wide, narrow = (shifts[name].at(R, np.full(len(R), gauge)) for gauge in (0.5e-3, -0.5e-3))
        outwards += float(np.mean(np.sign(R) * (wide - narrow)))
    return 1 if outwards >= 0 else -1


def _misfit_wheels(seen: ContactSamples, factor: float) -> float:
    shift = gauge_shift_of(fit_wheels(seen, factor))
    x = seen.displacement - shift.at(seen.difference, factor * seen.gauge)
    B = _hats(seen.difference, CURVE_KNOTS)
    curve = spsolve((B.T @ B + 1e-6 * sparse.eye(len(CURVE_KNOTS))).tocsc(), B.T @ x)
    return float(np.mean((x - B @ curve) ** 2))


def _hats(u: FloatArray, knots: FloatArray) -> sparse.csr_matrix:
    position = np.clip((u - knots[0]) / (knots[1] - knots[0]), 0.0, len(knots) - 1.001)
    cell = position.astype(np.int64)
    share = position - cell
    row = np.arange(len(u))
    values, at = np.concatenate([1.0 - share, share]), np.concatenate([cell, cell + 1])
    return sparse.csr_matrix((values, (np.concatenate([row, row]), at)), shape=(len(u), len(knots)))


def initial_gauge_effect(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, prior: GaugePrior
) -> FloatArray | None:
    """Return h1 (w, gauge_basis_count), m a ``gauge_unit``, from a panel without; None where gauge hardly varies."""
    first, second, weight = _leading_vectors(passes, solution, panel)
    candidates = []
    for degrees in WHEELS.mixture_angles_deg:
        mixed = np.cos(np.radians(degrees)) * first + np.sin(np.radians(degrees)) * second
        size = np.sqrt((mixed**2 * weight).sum() / weight.sum())
        odd = mixed * WHEELS.gauge_effect * panel.parameters.gauge_unit / size
        candidates.append(np.concatenate([-odd[:, :0:-1], np.zeros((len(odd), 1)), odd[:, 1:]], axis=1))
    return _best_candidate(candidates, solution.lives, passes, panel, prior)


def _leading_vectors(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    knots = panel.parameters.gauge_knots[panel.parameters.gauge_basis_count // 2 :]
    k, w = len(knots), len(solution.lives)
    sums, own, count = np.zeros((panel.grid.points, w * k)), np.zeros((w * k, w * k)), np.zeros(w * k)
    for item, curve in solution.used(passes):
        at = item.used_points
        residual = pass_residual(item, curve, panel)[item.inside] - solution.alignment[at]
        known = np.isfinite(residual)
        residual = item.side * np.clip(np.where(known, residual, 0.0), -WHEELS.most_residual, WHEELS.most_residual)
        R = item.difference[item.inside]
        basis = basis_functions(np.minimum(np.abs(R), panel.parameters.reach), knots) * known
        products = panel.weight_of(item.life) * basis * np.sign(R) * residual
        number = solution.lives.index(item.life)
        columns = slice(number * k, (number + 1) * k)
        sums[at, columns] += item.side * products.T
        own[columns, columns] += products @ products.T
        count[columns] += basis.sum(axis=1)
    weight = np.maximum(count, WHEELS.least_knot_samples)
    covariance = (sums.T @ sums - own) / np.sqrt(np.outer(weight, weight))
    _, vectors = np.linalg.eigh(covariance)
    second, first = (vectors[:, -2:] / np.sqrt(weight)[:, None]).T
    return first.reshape(w, k), second.reshape(w, k), weight.reshape(w, k)


def _best_candidate(
    candidates: Sequence[FloatArray],
    lives: Sequence[ProfileLife],
    passes: Sequence[GriddedPass],
    panel: Panel,
    prior: GaugePrior,
) -> FloatArray | None:
    """Return the candidate with which one round leaves the least on a part of the section; None without a gauge."""
    section = panel.grid.length
    length = min(WHEELS.trial_length, section)
    begin = 0.5 * (section - length)
    parameters = replace(panel.parameters, length=length)
    small = replace(panel, parameters=parameters, grid=Panel.of(parameters).grid, gauge=None)
    part = [
        grid_pass(cut, small.grid, item.ratio)
        for item in passes
        if (cut := _cut(item.source, begin, begin + length)) is not None
    ]
    start = result(update(init(small), part), std=False, parameters=panel.parameters)
    zero = small.with_gauge(np.zeros(small.grid.points))
    kept = [lives.index(life) for life in start.lives]
    residuals: list[float] = []
    for effect in candidates:
        gauge, _, _ = gauge_step(part, with_gauge_effect(start, effect[kept], zero), zero, prior)
        if not residuals and gauge.std() < WHEELS.least_gauge_std:
            return None
        state = update(init(small.with_gauge(gauge)), part)
        residuals.append(residual_of_passes(state, result(state, std=False, parameters=panel.parameters)))
    return candidates[int(np.argmin(residuals))]


def _cut(item: Pass, begin: float, end: float) -> Pass | None:
    within = (item.at >= begin) & (item.at <= end)
    if within.sum() < 2:  # noqa: PLR2004 - a pass has a length
        return None
    return replace(
        item,
        at=item.at[within] - begin,
        displacement=item.displacement[within],
        difference=item.difference[within],
        stiffness_term=None if item.stiffness_term is None else item.stiffness_term[within],
    )
