"""One radius function per wheel: what a gauge deviation does to the rolling radius difference.

With x = y - d and e the gauge deviation, the left wheel sits at x - e/2 against its rail and the right one at -x - e/2,
positive towards the flange, so R(x, e) = rho_L(x - e/2) - rho_R(-x - e/2): linear in hat functions of the two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import minimize_scalar

from estimation.arrays import FloatArray
from estimation.track.local_filter import smoother, without_slow_part
from estimation.track.panel import PanelParameters, columns, gauge_at, hat_functions, on_grid
from estimation.track.passes import Pass
from estimation.track.solution import PanelSolution
from estimation.types import WheelFunctions

KNOTS = np.linspace(-9e-3, 9e-3, 73)  # m
ROUGHNESS = 1e-4  # relative to the data
FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)


@dataclass(frozen=True, slots=True)
class Places:
    """Where one wheelset sat: x = y - d whole, R, and the gauge deviation (n,), m."""

    displacement: FloatArray
    difference: FloatArray
    gauge: FloatArray


def places(
    passes: Sequence[Pass], solution: PanelSolution, alignment: FloatArray, panel: PanelParameters
) -> dict[str, Places]:
    """Return the places of every wheelset, seen from itself.

    What the filter takes from y - d is put back from h(R, e), which is whole.

    Parameters
    ----------
    passes, solution, panel
        As solved; ``panel.gauge`` given.
    alignment
        (n,) m, high-passed like the panel; NaN where not known.
    """
    weights = smoother(panel.cut_off, panel.step)
    found: dict[str, list[FloatArray]] = {}
    for item in passes:
        felt = on_grid(item, panel)
        if felt is None or item.wheelset not in solution.wheelsets:
            continue
        curve = solution.curves[0, solution.wheelsets.index(item.wheelset)]
        own = item.side * (curve @ columns(felt, panel))
        slow = own - without_slow_part(own, weights)
        d = np.where(felt.inside, alignment[np.clip(felt.points, 0, panel.points - 1)], np.nan)
        x = item.side * (without_slow_part(felt.displacement, weights) - d + slow)
        met = np.isfinite(x)
        rows = np.stack([x, felt.difference, gauge_at(felt.points, panel)])
        found.setdefault(item.wheelset, []).append(rows[:, met])
    return {name: Places(*np.concatenate(rows, axis=1)) for name, rows in found.items()}


def fit(seen: Places, factor: float = 1.0) -> tuple[WheelFunctions, float]:
    """Return the functions of the wheels of one wheelset, gauge deviations taken ``factor`` times, and the misfit."""
    x, e = seen.displacement, factor * seen.gauge
    inner = 0.999 * KNOTS[-1]
    left = hat_functions(np.clip(x - e / 2, -inner, inner), KNOTS)
    right = hat_functions(np.clip(-x - e / 2, -inner, inner), KNOTS)
    B = np.concatenate([left, -right])
    normal, cross = B @ B.T, B @ seen.difference
    k = len(KNOTS)
    scale = np.trace(normal) / (2 * k)
    bend = np.diff(np.eye(k), 2, axis=0)
    known = scale * (ROUGHNESS * linalg.block_diag(bend.T @ bend, bend.T @ bend) + 1e-6 * np.eye(2 * k))
    both = linalg.solve(normal + known, cross, assume_a="pos")
    misfit = float(seen.difference @ seen.difference - 2 * both @ cross + both @ normal @ both)
    return WheelFunctions(KNOTS, both[:k], both[k:]), misfit


def fitted(seen: Mapping[str, Places], factor: float) -> dict[str, WheelFunctions]:
    """Return the functions of the wheels of every wheelset."""
    return {name: fit(one, factor)[0] for name, one in seen.items()}


def gauge_factor(seen: Mapping[str, Places], most: int = 6) -> float:
    """Return what estimated gauge deviations are to be multiplied with: wheels that fit best tell the size.

    The sign is not in the passes: left and right wheel of opposite shape fit as well with the opposite sign. It is
    taken from what wheels are, steeper towards the flange.
    """
    some = [one for _, one in sorted(seen.items())][:: max(len(seen) // most, 1)][:most]

    def misfit(factor: float) -> float:
        return sum(fit(one, factor)[1] for one in some)

    best = min(FACTORS, key=misfit)
    found = minimize_scalar(misfit, bounds=(0.6 * best, 1.6 * best), method="bounded", options={"xatol": 0.03})
    factor = float(np.asarray(found.x))
    return factor if sum(_steepening(fit(one, factor)[0], one) for one in some) >= 0 else -factor


def _steepening(wheels: WheelFunctions, seen: Places) -> float:
    """Return how much steeper the wheels are towards the flange than away from it."""
    far = float(np.quantile(np.abs(seen.displacement), 0.9))
    both = wheels.left + wheels.right
    out, middle, back = np.interp([far, 0.0, -far], wheels.knots, both)
    return float(out - 2 * middle + back)
