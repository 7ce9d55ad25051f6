"""The parameters of the vehicles from the passes: yaw stiffness over creep coefficient, which scales part of R.

R = rL - rR is measured as a sum of a rolling part, -(2 l r0/V) psi', that no uncertain parameter scales, and of the
stiffness term E = -(r0/(l f11)) (k_psi psi + I psi''), which is proportional to yaw stiffness over creep coefficient.
The two are out of phase, so a wrong ratio leaves residuals: y = d + h(R + delta E) = d + h(R) + h' delta E + ... has
one more term, E.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel
from estimation.track.panel.solution import PanelSolution
from estimation.values.quantities import jackknife_std

PRIOR_STD = 0.15  # of the ratio, relative
SYSTEMATIC_STD = 0.02  # of the ratio, relative: a model of small terms is left, blocks of data cannot show it
LEAST_EXPLAINED = 0.67  # a smaller share says that something else is wrong
DAMPING = 0.6  # of a step: position and ratio are refined at once, and each would make up for the other's error


@dataclass(frozen=True, slots=True)
class Ratio:
    """Of a vehicle: true yaw stiffness over creep coefficient, relative to the assumed one."""

    value: float = 1.0
    std: float = PRIOR_STD


def ratio_values(ratios: Mapping[str, Ratio]) -> dict[str, float]:
    """Return the value of each vehicle's ratio."""
    return {vehicle: one.value for vehicle, one in ratios.items()}


def refine_ratios(
    ratios: Mapping[str, Ratio],
    passes: Sequence[GriddedPass],
    solution: PanelSolution,
    panel: Panel,
    explained: float = 1.0,
) -> dict[str, Ratio]:
    """Return the ratios after one Gauss-Newton step from the solution of the adjusted passes.

    The step of a vehicle is the mean over its wheelsets, weighted by the squares of their slopes, as far as the data
    are worth against what is known beforehand. Where measured profiles had to determine the curves, the ratios are as
    assumed.

    Args:
        explained: Share r2 of the differences of y between the passes of a place that the curves explain. What they
            leave is error of R; as far as R is its stiffness term it makes the ratio too small, in every block of data
            alike.
    """
    if solution.report.curves_fixed:
        return {item.source.vehicle: Ratio() for item in passes if item.source.stiffness_term is not None}
    slopes = _slopes(solution, panel)
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
    flattened = _stiffness_shares(passes)
    excess = 1.0 / max(explained, LEAST_EXPLAINED) - 1.0
    for vehicle, numerator in numerators.items():
        if not squares[vehicle] > 0.0:
            continue  # its passes met nothing
        steps = numerator / squares[vehicle]
        before = ratios.get(vehicle, Ratio())
        data_std = float(jackknife_std(steps[:, None])[0])
        if not np.isfinite(data_std):
            data_std = 0.0  # not computed in this round
        data_std = float(np.hypot(data_std, excess * flattened[vehicle]))
        worth = PRIOR_STD**2 / (PRIOR_STD**2 + data_std**2)
        value = 1.0 + worth * (before.value + DAMPING * float(steps[0]) - 1.0)
        result[vehicle] = Ratio(float(np.clip(value, 0.5, 1.5)), float(np.sqrt(worth) * data_std))
    return result


def with_ratio_std(
    ratios: Mapping[str, Ratio],
    passes: Sequence[GriddedPass],
    solution: PanelSolution,
    panel: Panel,
    explained: float = 1.0,
) -> dict[str, Ratio]:
    """Return the ratios with which ``passes`` were adjusted, each with its std from the groups of ``solution``.

    Args:
        solution, panel: As solved, with standard deviations.
    """
    found = refine_ratios(ratios, passes, solution, panel, explained)
    return {
        vehicle: replace(ratios.get(vehicle, Ratio()), std=float(np.hypot(one.std, SYSTEMATIC_STD)))
        for vehicle, one in found.items()
    }


def error_of_difference(ratios: Mapping[str, Ratio], passes: Sequence[GriddedPass]) -> float:
    """Return the relative std of R that the stiffness ratio leaves, of the vehicle where it is largest.

    In a stiff bogie nearly all of R is its stiffness term, a small difference of two yaws, whose errors follow the
    motion as curves do: there the passes determine neither the ratio nor the curves.

    Args:
        ratios: By vehicle, with their standard deviations.
    """
    shares = _stiffness_shares([item for item in passes if item.source.vehicle in ratios])
    return max((float(np.sqrt(share)) * ratios[vehicle].std for vehicle, share in shares.items()), default=0.0)


def _stiffness_shares(passes: Sequence[GriddedPass]) -> dict[str, float]:
    """Return by vehicle the mean square of the stiffness term over that of R, at most 1."""
    sums: dict[str, np.ndarray] = {}
    for item in passes:
        E, R = item.stiffness_term[item.inside], item.difference[item.inside]
        squares = np.array([E @ E, R @ R])
        sums[item.source.vehicle] = sums.get(item.source.vehicle, 0.0) + squares
    return {vehicle: float(np.clip(own / max(whole, 1e-300), 0.0, 1.0)) for vehicle, (own, whole) in sums.items()}


def _slopes(solution: PanelSolution, panel: Panel) -> np.ndarray:
    """Return dh/dR (w,) of every wheelset, averaged over what it has seen."""
    rise = np.diff(solution.curves[0, :, : panel.parameters.basis_count], axis=1) / np.diff(panel.parameters.knots)
    seen = np.minimum(solution.weight[:, 1:], solution.weight[:, :-1])
    return np.asarray((rise * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1e-12))
