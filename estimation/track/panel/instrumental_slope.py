"""What errors of R do: they flatten the curves, and make stiffness ratios too small.

Between the passes of a place noise of R flattens y = d + h(R) (``docs/decisions/errors-in-variables.md``). By how much
is known from the share r2 of y that the curves explain, and better from an instrument z: each wheelset's R as a filter
predicts it from the mean displacement of the place, which holds none of that noise,

    factor = sum h(z) (y - h_E) / sum h(z) h(R)

with h_E for the stiffness term. R is a sum of a rolling part, that no uncertain parameter scales, and of the stiffness
term E, proportional to yaw stiffness over creep coefficient and out of phase with it. A wrong ratio leaves residuals:
y = d + h(R + delta E) = d + h(R) + h' delta E + ... has one more term, E.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.filters import high_pass
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, PanelState, curve_displacement, groups_of, known_shift
from estimation.track.panel.solution import PanelSolution, curves_of_sum
from estimation.track.parameters import TRACK
from estimation.track.passes import ProfileLife
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.quantities import jackknife_std


@dataclass(frozen=True, slots=True)
class SlopeCorrection:
    """Factor that curves are to be multiplied with, and its std."""

    factor: float = 1.0
    std: float = 0.0
    explained: float = 1.0  # r2: share of the differences of y between the passes of a place that the curves explain


def slope_correction(state: PanelState, solution: PanelSolution) -> SlopeCorrection:
    """Return by how much the curves of a panel are too flat."""
    passed = state.passes > 0.0
    passes, y = state.passes[passed], state.displacement[passed]
    curves = solution.curves[0]
    fitted = curves_of_sum(state, curves)[passed]
    gram = np.einsum("wj,gwjk,wk->", curves, state.gram, curves)
    of_curves = float(gram - (fitted**2 / passes).sum())
    along = float(np.einsum("wk,gwk->", curves, state.cross) - (fitted * y / passes).sum())
    whole = float(state.square.sum() - (y**2 / passes).sum())
    if not (of_curves > 0.0 and whole > 0.0 and along > 0.0):
        return SlopeCorrection(1.0, float("inf"), 0.0)
    explained = min(along**2 / (of_curves * whole), 1.0)
    excess = 1.0 / explained - 1.0
    return SlopeCorrection(1.0 + TRACK.flattening_share * excess, TRACK.flattening_std * excess, explained)


def corrected(state: PanelState, solution: PanelSolution, factor: float) -> PanelSolution:
    """Return a solution with its curves multiplied by ``factor``, and the alignment that follows from them."""
    passes = np.where(state.passes > 0.0, state.passes, 1.0)
    without_stiffness = solution.curves[0].copy()
    without_stiffness[:, -1] = 0.0
    added = (factor - 1.0) * curves_of_sum(state, without_stiffness) / passes
    return replace(
        solution,
        curves=np.concatenate([factor * solution.curves[:, :, :-1], solution.curves[:, :, -1:]], axis=2),
        alignment=solution.alignment - added,
    )


def common_slope(solution: PanelSolution, other: PanelSolution) -> float:
    """Return the factor by which the curves of ``solution`` come nearest to those of another one, without a gauge."""
    count = len(solution.knots)
    along, square = 0.0, 0.0
    for number, life in enumerate(solution.lives):
        curve = other.curve_of(life)
        if curve is None:
            continue
        weight, mine = solution.weight[number], solution.curves[0, number, :count]
        along += float((weight * mine) @ curve[:count])
        square += float((weight * mine) @ mine)
    return along / square if along > 0.0 else 1.0


@dataclass(frozen=True, slots=True)
class _Filtered:
    source: GriddedPass
    displacement: FloatArray  # (m,) y, m
    difference: FloatArray  # (m,) R, m, as the section has it


def with_instrument(
    slope: SlopeCorrection, passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel
) -> SlopeCorrection:
    """Return the slope's correction with what the instrument shows of it, or as it was where that is weak."""
    if not slope.explained > 0.0:
        return slope  # the curves explain nothing, and nothing is known of their slope
    sums = _sums(passes, solution, panel)
    whole = sums.sum(axis=0)
    along, product, of_instrument, of_curves = whole
    if not along > panel.parameters.least_correlation * float(np.sqrt(of_instrument * of_curves)):
        return slope
    without = whole - sums
    if not (without[:, 0] > 0.0).all():
        return slope
    factors = np.concatenate([[product / along], without[:, 1] / without[:, 0]])
    excess = 1.0 / slope.explained - 1.0
    std = float(np.hypot(jackknife_std(factors[:, None])[0], panel.parameters.systematic_share * excess))
    if not std < slope.std:
        return slope
    precision = np.array([std, slope.std]) ** -2
    factor = float(precision @ np.array([factors[0], slope.factor]) / precision.sum())
    return SlopeCorrection(factor, float(precision.sum() ** -0.5), slope.explained)


def _sums(passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel) -> FloatArray:
    grid, groups = panel.grid, panel.parameters.groups
    filtered = [_filtered(item, panel) for item in passes if not item.empty]
    summed, passed = np.zeros((2, grid.points))
    for item in filtered:
        summed[item.source.used_points] += item.displacement[item.source.inside]
        passed[item.source.used_points] += 1.0
    mean, taps = summed / np.maximum(passed, 1.0), 2 * int(panel.parameters.slope_reach / grid.step) + 1
    # where enough have passed within the reach of the filter
    enough = np.convolve(passed >= panel.parameters.least_passes, np.ones(taps), "same") > taps - 0.5
    predicted = _predictions(filtered, mean, enough, panel)
    terms: list[tuple[IntArray, FloatArray, float]] = []
    total, count = np.zeros((3, grid.points)), np.zeros(grid.points)
    for item in filtered:
        source, curve = item.source, solution.curve_of(item.source.life)
        if curve is None:
            continue
        used = source.inside & _at(enough, source.points, panel)
        values = _compared(item, curve, predicted[source.life], panel)[:, used]
        points, weight = source.points[used], panel.weight_of(source.life)
        total[:, points] += weight * values
        count[points] += weight
        terms.append((points, values, weight))
    total /= np.where(count > 0.0, count, 1.0)
    sums = np.zeros((groups, 4))
    for points, values, weight in terms:
        y, h, z = values - total[:, points]
        np.add.at(sums, groups_of(points, panel), weight * np.stack([z * h, z * y, z * z, h * h], axis=1))
    return sums


def _filtered(item: GriddedPass, panel: Panel) -> _Filtered:
    displacement = item.displacement - known_shift(item, panel)
    y, R = high_pass(np.stack([displacement, item.difference]), panel.grid.kernel)
    return _Filtered(item, y, item.side * R)


def _predictions(
    filtered: Sequence[_Filtered], mean: FloatArray, enough: BoolArray, panel: Panel
) -> dict[ProfileLife, FloatArray]:
    """Return z (n,), m, of every wheelset: the mean displacement through the filter that fits its R best."""
    reach = int(panel.parameters.slope_reach / panel.grid.step)
    shifted = np.lib.stride_tricks.sliding_window_view(np.pad(mean, reach), 2 * reach + 1)
    normal: dict[ProfileLife, FloatArray] = {}
    right: dict[ProfileLife, FloatArray] = {}
    for item in filtered:
        used = item.source.inside & _at(enough, item.source.points, panel)
        X, life = shifted[item.source.points[used]], item.source.life
        normal[life] = normal.get(life, 0.0) + X.T @ X
        right[life] = right.get(life, 0.0) + X.T @ item.difference[used]
    size = {life: panel.parameters.ridge * max(float(np.trace(N)) / len(N), 1e-30) for life, N in normal.items()}
    return {
        life: np.asarray(shifted @ np.linalg.solve(N + size[life] * np.eye(len(N)), right[life]))
        for life, N in normal.items()
    }


def _compared(item: _Filtered, curve: FloatArray, predicted: FloatArray, panel: Panel) -> FloatArray:
    """Return y, h(R) and h(z) (3, m) of a pass, m, high-passed and without the stiffness term."""
    source, p = item.source, panel.parameters
    stiffness_term = curve[-1] * source.stiffness_term
    z = np.clip(source.side * _at(predicted, source.points, panel), -p.reach, p.reach)
    of_z = np.interp(z, p.knots, curve[: p.basis_count])
    h = np.stack([stiffness_term, curve_displacement(source, curve, panel), of_z])
    of_stiffness, of_difference, of_prediction = source.side * high_pass(h, panel.grid.kernel)
    return np.stack([item.displacement - of_stiffness, of_difference - of_stiffness, of_prediction])


def _at(values: FloatArray | BoolArray, points: IntArray, panel: Panel) -> np.ndarray:
    return values[np.clip(points, 0, panel.grid.points - 1)]


@dataclass(frozen=True, slots=True)
class Ratio:
    """Of a vehicle: true yaw stiffness over creep coefficient, relative to the assumed one."""

    value: float = 1.0
    std: float = TRACK.ratio_prior_std


def ratio_values(ratios: Mapping[str, Ratio]) -> dict[str, float]:
    """Return the value of each vehicle's ratio."""
    return {vehicle: ratio.value for vehicle, ratio in ratios.items()}


def refine_ratios(
    ratios: Mapping[str, Ratio],
    passes: Sequence[GriddedPass],
    solution: PanelSolution,
    panel: Panel,
    explained: float = 1.0,
) -> dict[str, Ratio]:
    """Return the ratios after one Gauss-Newton step from the solution of the adjusted passes.

    The step of a vehicle is the mean over its wheelsets, weighted by the squares of their slopes, as far as the data
    are worth against what is known beforehand. What the curves leave of y, besides the share r2 that is ``explained``,
    is error of R; as far as R is its stiffness term it makes the ratio too small, in every block of data alike. Where
    measured profiles had to determine the curves, the ratios are as assumed.
    """
    if solution.curves_fixed:
        return {item.source.vehicle: Ratio() for item in passes if item.source.stiffness_term is not None}
    rise = np.diff(solution.curves[0, :, : panel.parameters.basis_count], axis=1) / np.diff(panel.parameters.knots)
    seen = np.minimum(solution.weight[:, 1:], solution.weight[:, :-1])
    slopes = (rise * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1e-12)  # dh/dR (w,) over what was seen
    numerators: dict[str, np.ndarray] = {}
    squares: dict[str, float] = {}
    for vehicle, life in sorted(
        {(item.source.vehicle, item.life) for item in passes if item.source.stiffness_term is not None}
    ):
        if life not in solution.lives:
            continue
        w = solution.lives.index(life)
        numerators[vehicle] = numerators.get(vehicle, 0.0) + slopes[w] * solution.curves[:, w, -1]
        squares[vehicle] = squares.get(vehicle, 0.0) + slopes[w] ** 2
    result = {}
    flattened, prior = _stiffness_shares(passes), TRACK.ratio_prior_std**2
    excess = 1.0 / max(explained, panel.parameters.least_explained) - 1.0
    for vehicle, numerator in numerators.items():
        if not squares[vehicle] > 0.0:
            continue  # its passes met nothing
        steps = numerator / squares[vehicle]
        before = ratios.get(vehicle, Ratio())
        data_std = float(jackknife_std(steps[:, None])[0])
        if not np.isfinite(data_std):
            data_std = 0.0  # not computed in this round
        data_std = float(np.hypot(data_std, excess * flattened[vehicle]))
        worth = prior / (prior + data_std**2)
        value = 1.0 + worth * (before.value + panel.parameters.damping * float(steps[0]) - 1.0)
        result[vehicle] = Ratio(float(np.clip(value, 0.5, 1.5)), float(np.sqrt(worth) * data_std))
    return result


def with_ratio_std(
    ratios: Mapping[str, Ratio],
    passes: Sequence[GriddedPass],
    solution: PanelSolution,
    panel: Panel,
    explained: float = 1.0,
) -> dict[str, Ratio]:
    """Return the ratios with which ``passes`` were adjusted, each with its std from the groups of ``solution``."""
    systematic, refined = (
        panel.parameters.ratio_systematic_std,
        refine_ratios(ratios, passes, solution, panel, explained),
    )
    stds = {vehicle: float(np.hypot(ratio.std, systematic)) for vehicle, ratio in refined.items()}
    return {vehicle: replace(ratios.get(vehicle, Ratio()), std=std) for vehicle, std in stds.items()}


def error_of_difference(ratios: Mapping[str, Ratio], passes: Sequence[GriddedPass]) -> float:
    """Return the relative std of R that the stiffness ratio leaves, of the vehicle where it is largest."""
    # in a stiff bogie nearly all of R is its stiffness term, a small difference of two yaws, whose errors follow the
    # motion as curves do: there the passes determine neither the ratio nor the curves
    shares = _stiffness_shares([item for item in passes if item.source.vehicle in ratios])
    return max((float(np.sqrt(share)) * ratios[vehicle].std for vehicle, share in shares.items()), default=0.0)


def _stiffness_shares(passes: Sequence[GriddedPass]) -> dict[str, float]:
    sums: dict[str, np.ndarray] = {}
    for item in passes:
        E, R = item.stiffness_term[item.inside], item.difference[item.inside]
        squares = np.array([E @ E, R @ R])
        sums[item.source.vehicle] = sums.get(item.source.vehicle, 0.0) + squares
    return {vehicle: float(np.clip(part / max(whole, 1e-300), 0.0, 1.0)) for vehicle, (part, whole) in sums.items()}
