"""Gauge deviation as a second latent function of the place, from the passes alone.

Gauge moves each wheel against its own rail: a wheelset of difference R sits at h(R, e) = h0(R) + e h1(R) + e^2 h2(R).
Over R, unlike over y - d, this is smooth: contact jumps are steps of R and flats of h. For given h it is linear in
the small change of e, and for given e it is linear in h: the two are solved in turn, each exactly, d eliminated. One
place is seen by all passes, so 48 passes tell d and e apart where two would not.

That needs h1 beforehand (``initial_shape``), and ends near where it starts; a search goes on from there (``search``).
h1 and e have a common factor that this leaves open, with its sign; the wheels' own functions (``wheel_functions``) fix
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.filters.local_cubic import high_pass, local_cubic_kernel
from estimation.track.panel.basis import OnGrid, PanelParameters, basis_functions, columns, gauge_at, on_grid
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Pass
from estimation.values.arrays import BoolArray, FloatArray, IntArray

FEWEST_PASSES = 6  # at a place, to tell two functions of it
STEPS = 14  # of conjugate gradients


@dataclass(frozen=True, slots=True)
class GaugePrior:
    """What is known of the gauge deviation beforehand."""

    std: float = 2e-3  # m
    smooth: float = 5.0  # m along the track
    noise: float = 0.15e-3  # m of y - d - h(R, e) of a pass


@dataclass(frozen=True, slots=True)
class _Seen:
    """One pass: residual of y and its derivative by e before the filter, on its own grid."""

    points: IntArray  # (m,) clipped to the section
    on: BoolArray  # (m,) on the section
    inside: BoolArray  # (m,) where the residual means something
    residual: FloatArray  # (m,) times ``root``
    slope: FloatArray  # (m,) dh/de, times ``root``
    root: float  # of the weight of the pass


def with_gauge_effect(solution: PanelSolution, effect: FloatArray, panel: PanelParameters) -> PanelSolution:
    """Return a solution without gauge with h1 (w, gauge_hats), m for ``panel.gauge_unit`` of gauge, put in."""
    h0, stiffness_term = solution.curves[:, :, : panel.hats], solution.curves[:, :, -1:]
    h1 = np.broadcast_to(effect, (len(h0), *effect.shape))
    return replace(solution, curves=np.concatenate([h0, h1, np.zeros_like(h1), stiffness_term], axis=2))


def gauge_step(
    passes: Sequence[Pass], solution: PanelSolution, panel: PanelParameters, prior: GaugePrior
) -> FloatArray:
    """Return the gauge deviation (n,) after one Gauss-Newton step from ``panel.gauge``, with mean zero."""
    assert panel.gauge is not None
    weights = local_cubic_kernel(panel.cutoff_wavelength, panel.step)
    seen = [found for item in passes if (found := _seen(item, solution, panel, weights)) is not None]
    count, weight = np.zeros((2, panel.points))
    for one in seen:
        count[one.points[one.inside]] += 1
        weight[one.points[one.inside]] += one.root**2
    share = np.where(count >= FEWEST_PASSES, 1.0 / np.where(weight > 0.0, weight, 1.0), 0.0)
    shape = _shape(prior.smooth, panel.step)
    change = _solve([one.residual for one in seen], seen, share, shape, weights, (prior.noise / prior.std) ** 2)
    gauge = panel.gauge + change
    met = share > 0
    return np.asarray(np.where(met, gauge - gauge[met].mean(), 0.0)) if met.any() else panel.gauge


def _shape(smooth: float, step: float) -> FloatArray:
    """Return the kernel (2 m + 1,) of a smooth process of unit variance driven by white noise."""
    reach = int(np.ceil(2 * smooth / step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step * 2.5 / smooth) ** 2)
    return np.asarray(kernel / np.sqrt((kernel**2).sum()))


def _seen(item: Pass, solution: PanelSolution, panel: PanelParameters, weights: FloatArray) -> _Seen | None:
    felt = on_grid(item, panel)
    if felt is None or item.wheelset not in solution.wheelsets:
        return None
    curve = solution.curves[0, solution.wheelsets.index(item.wheelset)]
    rest = high_pass(felt.displacement - item.side * (curve @ columns(felt, panel)), weights)
    on = (felt.points >= 0) & (felt.points < panel.points)
    root = float(np.sqrt(panel.weight_of(item.wheelset)))
    return _Seen(
        np.clip(felt.points, 0, panel.points - 1),
        np.asarray(on),
        felt.inside,
        np.where(felt.inside, root * rest, 0.0),
        np.where(on, root * item.side * _slope(felt, curve, panel), 0.0),
        root,
    )


def _slope(felt: OnGrid, curve: FloatArray, panel: PanelParameters) -> FloatArray:
    """Return dh/de (m,) = h1 + 2 e h2."""
    k, k1 = panel.hats, panel.gauge_basis_count
    coarse = basis_functions(np.clip(felt.difference, -panel.reach, panel.reach), panel.gauge_knots)
    e = gauge_at(felt.points, panel) / panel.gauge_unit
    return np.asarray((curve[k : k + k1] @ coarse + 2 * e * (curve[k + k1 : k + 2 * k1] @ coarse)) / panel.gauge_unit)


def _solve(
    residuals: list[FloatArray],
    seen: list[_Seen],
    share: FloatArray,
    shape: FloatArray,
    weights: FloatArray,
    ridge: float,
) -> FloatArray:
    """Minimise |residual - F[dh/de K u]|^2 + ridge |u|^2 with d free; return K u. Conjugate gradients."""

    def smooth(values: FloatArray) -> FloatArray:
        return np.convolve(values, shape, "same")

    def without_alignment(rows: list[FloatArray]) -> list[FloatArray]:
        mean = np.zeros(len(share))
        for one, row in zip(seen, rows, strict=True):
            mean[one.points[one.inside]] += one.root * row[one.inside]
        mean *= share
        return [
            np.where(one.inside & (share[one.points] > 0), row - one.root * mean[one.points], 0.0)
            for one, row in zip(seen, rows, strict=True)
        ]

    def felt(gauge: FloatArray) -> list[FloatArray]:
        return without_alignment(
            [np.where(one.inside, high_pass(one.slope * gauge[one.points], weights), 0.0) for one in seen]
        )

    def back(rows: list[FloatArray]) -> FloatArray:
        total = np.zeros(len(share))
        for one, row in zip(seen, rows, strict=True):
            np.add.at(total, one.points[one.on], (one.slope * high_pass(row, weights))[one.on])
        return total

    u = np.zeros(len(share))
    left = smooth(back(without_alignment(residuals)))
    direction, size = left.copy(), float(left @ left)
    enough = 1e-6 * size
    for _ in range(STEPS):
        if size <= enough or size == 0.0:
            break
        image = smooth(back(felt(smooth(direction)))) + ridge * direction
        length = size / float(direction @ image)
        u += length * direction
        left -= length * image
        before, size = size, float(left @ left)
        direction = left + size / before * direction
    return smooth(u)
