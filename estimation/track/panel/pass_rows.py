"""The rows of the panel regression that one pass makes, high-passed.

At every grid point at most two of the piecewise linear functions of R are not zero. Their high-pass is made by adding
the filter's weights at these alone, instead of filtering every function over the whole pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.filters.local_cubic import high_pass
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, gauge_at, knot_shares, known_shift
from estimation.values.arrays import FloatArray, IntArray, as_slice

Singles = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PassRows:
    """The rows of a regression that one pass makes, high-passed, at the grid points that can be used."""

    points: IntArray  # (m,)
    design: Singles  # (k, m)
    displacement: FloatArray  # (m,) y, m
    difference: FloatArray  # (m,) R, m


def pass_rows(item: GriddedPass, panel: Panel) -> PassRows:
    """Return the high-passed design matrix, y and R of a pass that is not empty.

    Design matrix and R change their sign where the wheelset's left wheel runs on the section's right rail.

    Args:
        panel: Its basis functions, and what is known beforehand.
    """
    used = as_slice(np.flatnonzero(item.inside))
    displacement = item.displacement - known_shift(item, panel)
    y, R = high_pass(np.stack([displacement, item.difference]), panel.grid.kernel)[:, used]
    design = item.side * _design(item, panel)[:, used]
    return PassRows(item.used_points, design, y, item.side * R)


def _design(item: GriddedPass, panel: Panel) -> Singles:
    """Return the high-passed functions (k, m) of a pass that its displacement is a sum of, at all its grid points.

    Single precision: half the time, and the basis functions have no drift that would use it up.
    """
    p, m = panel.parameters, len(item.points)
    weights = panel.grid.kernel.astype(np.float32)
    rows = np.zeros((panel.unknowns, m), dtype=np.float32)
    R = np.clip(item.difference, -p.reach, p.reach)
    cell, share = knot_shares(R, p.knots)
    add_filtered_hats(rows, cell, share.astype(np.float32), np.ones(m, dtype=np.float32), weights)
    if panel.gauge is not None:
        cell, share = knot_shares(R, p.gauge_knots)
        e = gauge_at(item.points, panel) / p.gauge_unit
        for number, factor in enumerate((e, e**2)):
            first = p.basis_count + number * p.gauge_basis_count
            add_filtered_hats(rows[first:], cell, share.astype(np.float32), factor.astype(np.float32), weights)
    rows[-1] = high_pass(item.stiffness_term.astype(np.float32), weights)
    return rows


@compiled(nogil=True)
def add_filtered_hats(rows: Singles, cell: IntArray, share: Singles, factor: Singles, weights: Singles) -> None:
    """Add piecewise linear functions, times a factor and less their local fit, to rows.

    Args:
        rows: (k, m) that are added to.
        cell, share: (m,) number of the function below each sample, and the share of the next one.
        factor: (m,) of both.
        weights: (2 r + 1,) of the local fit, symmetric.
    """
    m, reach = len(cell), len(weights) // 2
    for i in range(m):
        high = factor[i] * share[i]
        low = factor[i] - high
        below, above = rows[cell[i]], rows[cell[i] + 1]
        for j in range(max(0, i - reach), min(m, i + reach + 1)):
            weight = weights[reach + j - i]
            below[j] -= low * weight
            above[j] -= high * weight
        below[i] += low
        above[i] += high
