"""Alignment and geometry together, from many passes over one place: the sums of a panel regression.

At one place, pass p of wheelset w has y = d + h_w(R) + noise (``docs/unknown-track.md``). With h_w piecewise linear
this is linear in d and h. Two more terms are, too: the stiffness term of R, and, where the gauge deviation e is given,
functions of R times e and e^2.

At every grid point at most two of the piecewise linear functions of R are not zero. Their high-pass is made by adding
the filter's weights at these alone, instead of filtering every function over the whole pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.filters import high_pass
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, gauge_at, knot_shares, known_shift
from estimation.track.passes import ProfileLife
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


Precision = TypeVar("Precision", bound=np.floating[Any])


@dataclass(frozen=True, slots=True)
class PanelState:
    """Sums over passes; merging or adding passes in any order gives the same sums up to rounding.

    ``gram`` and ``cross`` are per group of blocks along the section; ``basis_sums``, ``displacement`` and ``passes``
    are per grid point. Wheelsets are in the order in which they came.
    """

    panel: Panel
    lives: tuple[ProfileLife, ...]  # of the wheelsets
    gram: FloatArray  # (g, w, k, k)
    cross: FloatArray  # (g, w, k)
    square: FloatArray  # (g,) sum of y^2
    basis_sums: npt.NDArray[np.float32]  # (w, k, n) sum over passes of the filtered basis functions
    displacement: FloatArray  # (n,) sum over passes of the filtered y
    passes: FloatArray  # (n,) sum of their weights
    difference: FloatArray  # (2, n) sums of the filtered R and of its square
    count: IntArray  # (n,) passes, whatever they weigh
    has_alignment: bool = False  # whether a prior alignment is among the sums


def init(panel: Panel) -> PanelState:
    """Return the empty state of a panel."""
    g, k, n = panel.parameters.groups, panel.unknowns, panel.grid.points
    return PanelState(
        panel=panel,
        lives=(),
        gram=np.zeros((g, 0, k, k)),
        cross=np.zeros((g, 0, k)),
        square=np.zeros(g),
        basis_sums=np.zeros((0, k, n), dtype=np.float32),
        displacement=np.zeros(n),
        passes=np.zeros(n),
        difference=np.zeros((2, n)),
        count=np.zeros(n, dtype=np.int64),
    )


def update(state: PanelState, passes: Sequence[GriddedPass]) -> PanelState:
    """Return the state with ``passes`` added; the cost is that of the passes, and one copy of the sums."""
    lives = tuple(dict.fromkeys((*state.lives, *(item.life for item in passes))))
    new = len(lives) - len(state.lives)
    sums = replace(
        state,
        lives=lives,
        gram=_extended(state.gram, 1, new),
        cross=_extended(state.cross, 1, new),
        square=state.square.copy(),
        basis_sums=_extended(state.basis_sums, 0, new),
        displacement=state.displacement.copy(),
        passes=state.passes.copy(),
        difference=state.difference.copy(),
        count=state.count.copy(),
    )
    for item in passes:
        if not item.empty:
            _add(sums, lives.index(item.life), pass_rows(item, state.panel), state.panel.weight_of(item.life))
    return sums


def _extended(sums: npt.NDArray[Precision], axis: int, new: int) -> npt.NDArray[Precision]:
    """Return a copy of sums with so many zeros more along an axis."""
    shape = list(sums.shape)
    shape[axis] += new
    found = np.zeros(shape, dtype=sums.dtype)
    found[(slice(None),) * axis + (slice(0, sums.shape[axis]),)] = sums
    return found


def _add(sums: PanelState, w: int, rows: PassRows, weight: float) -> None:
    """Add the rows of one pass of wheelset ``w`` in place, to sums that have no other owner."""
    at, y, R = rows.points, rows.displacement, rows.difference
    for group, B_there, y_there in _by_block(rows, sums.panel):
        sums.gram[group, w] += weight * (B_there @ B_there.T)
        sums.cross[group, w] += weight * (B_there @ y_there)
        sums.square[group] += weight * (y_there @ y_there)
    sums.basis_sums[w][:, as_slice(at)] += np.float32(weight) * rows.design
    sums.displacement[at] += weight * y
    sums.passes[at] += weight
    sums.count[at] += 1
    sums.difference[0, at] += weight * R
    sums.difference[1, at] += weight * R * R


def _by_block(rows: PassRows, panel: Panel) -> Iterator[tuple[int, npt.NDArray[np.float32], FloatArray]]:
    """Yield the group of each block with its part of the design matrix (k, m) and of the displacement (m,)."""
    block = _block_of(rows.points, panel)
    ends = np.flatnonzero(np.diff(block)) + 1
    for start, end in pairwise((0, *ends.tolist(), len(block))):
        group = int(block[start]) % panel.parameters.groups
        yield group, rows.design[:, start:end], rows.displacement[start:end]


def groups_of(at: IntArray, panel: Panel) -> IntArray:
    """Return the group (m,) of each grid point (m,): blocks along the section, assigned in turn."""
    return np.asarray(_block_of(at, panel) % panel.parameters.groups)


def _block_of(at: IntArray, panel: Panel) -> IntArray:
    return np.asarray((at * panel.grid.step // panel.parameters.block).astype(np.int64))
