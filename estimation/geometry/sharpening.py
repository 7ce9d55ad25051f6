"""A rolling radius difference without the blur of its displacement.

The error of y - d, and a gauge that moves contact jumps, blur a curve R(x) over some tenths of a millimetre; the
quadratics of the bins blur it further. What is behind is found by least squares with bounds (``non_negative``): R is
the integral of slopes in cells of an eighth of a bin. Blurred by a normal error and reduced to the quadratics of the
bins, it has to give the nodes that were observed. A slope is not negative, or no more than twice what was observed;
this is what brings a jump back into one place.

How far the blur reaches is known roughly. The longest that the nodes allow is taken: one that is too long leaves a
misfit, because no curve within the bounds becomes as sharp as what was observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr

from estimation.values.arrays import BoolArray, FloatArray, IntArray

HELD_SLACK = 1e-12  # of the largest gradient: below, an unknown that is held at 0 stays there
PATIENCE = 3  # exchanges of all without fewer on the wrong side, before it is one at a time


@dataclass(frozen=True, slots=True)
class Bounded:
    """A solution; linear in the right side as long as the same unknowns are free."""

    value: FloatArray  # (n,)
    free: IntArray  # which are not held at 0
    scale: FloatArray  # (n,) by which unknowns are multiplied before they are solved
    factor: tuple[FloatArray, bool]  # of the free ones

    def linear(self, right: FloatArray) -> FloatArray:
        """Return what the unknowns (n, m) are for right sides (n, m), with the same ones free."""
        found = np.zeros(right.shape)
        scale = self.scale[self.free, None]
        found[self.free] = cho_solve(self.factor, scale * right[self.free], check_finite=False) * scale
        return found


def non_negative(gram: FloatArray, right: FloatArray, most: int) -> Bounded | None:
    """Return the least squares of which the first unknown has any sign, and the others are not negative.

    None where ``most`` exchanges do not suffice, or the matrix (n, n) does not determine the unknowns.
    """
    diagonal = np.diag(gram)
    if not (diagonal > 0.0).all():
        return None
    scale = 1.0 / np.sqrt(diagonal)
    matrix, wanted = gram * scale * scale[:, None], right * scale
    free = np.ones(len(right), dtype=np.bool_)
    fewest, patience = len(right) + 1, PATIENCE
    for _ in range(most):
        places = np.flatnonzero(free)
        try:
            factor = cho_factor(matrix[np.ix_(places, places)], lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return None
        value = np.zeros(len(right))
        value[places] = cho_solve(factor, wanted[places], check_finite=False)
        wrong = _wrong(value, matrix @ value - wanted, free)
        if not wrong.any():
            return Bounded(value * scale, places, scale, factor)
        patience = PATIENCE if wrong.sum() < fewest else patience - 1
        fewest = min(fewest, int(wrong.sum()))
        free = free ^ (wrong if patience >= 0 else _last(wrong))
    return None


def _wrong(value: FloatArray, gradient: FloatArray, free: BoolArray) -> BoolArray:
    """Return which unknowns are negative, or would lower the sum if they were free; never the first one."""
    wrong = np.where(free, value < 0.0, gradient < -HELD_SLACK * np.abs(gradient).max())
    wrong[0] = False
    return wrong


def _last(wrong: BoolArray) -> BoolArray:
    one = np.zeros(len(wrong), dtype=np.bool_)
    one[np.flatnonzero(wrong)[-1]] = True
    return one


CELLS = 8  # in a bin
LEAST_STD = 5e-6  # m of a node: blurs are not quite normal
LEAST_ROUGHNESS = 0.25  # std that a change of the slope by 1 from cell to cell counts for; a contact jump has 2 to 10
ROUGHNESS = 2.5e3  # 1/m, the same per blur: the longer it is, the less of the slopes is known
MOST_MISFIT = 1.0  # rms, in std of the nodes
BLURS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)  # of the longest that is to be expected
SAMPLES = 8  # in a bin, for its quadratic
REACH = 3.0  # std of the blur that the cells go beyond the bins
STEPS = 200  # of the search for slopes; most end after ten
_KEPT = 64  # operators: the bins and blurs of wheelsets are much alike


@dataclass(frozen=True, slots=True)
class Sharpening:
    """How nodes of a curve become a sharp one; linear in the nodes: slopes that were at their bound stay there."""

    displacement: FloatArray  # (n,) m
    blur: float  # m, std that is taken away
    left: float  # m, std that is not taken away because nothing fits
    inverse: FloatArray  # (n, m) value at a displacement per value at a node
    constant: FloatArray  # (n,) m

    def curve(self, nodes: FloatArray) -> FloatArray:
        """Return the sharp curve (n,), m, of values at the nodes (m,)."""
        return np.asarray(self.inverse @ nodes + self.constant)


def edges_and_centres(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the nodes of adjoining bins, ascending: (2 b + 1,)."""
    return np.append(np.column_stack([low, 0.5 * (low + high)]).ravel(), high[-1])


def nodes_of(shape: FloatArray) -> FloatArray:
    """Return quadratics of bins (b, 3, ...) over u at the nodes (2 b + 1, ...); at an edge the mean of both bins.

    Args:
        shape: Value, slope and curvature over u = (x - centre)/width.
    """
    value, slope, curvature = shape[:, 0], shape[:, 1], shape[:, 2]
    at_low, at_high = value - slope / 2 + curvature / 4, value + slope / 2 + curvature / 4
    at_edge = np.concatenate([at_low[:1], 0.5 * (at_low[1:] + at_high[:-1])])
    inner = np.stack([at_edge, value], axis=1).reshape(2 * len(value), *value.shape[1:])
    return np.concatenate([inner, at_high[-1:]])


def unsharpened(low: FloatArray, high: FloatArray, longest: float) -> Sharpening:
    """Return what leaves the nodes of bins (b,) as they are: blurred, and jumps anywhere in their bins.

    Args:
        low, high: (b,) m, edges of adjoining bins of one width.
        longest: m, std of the blur that is to be expected at most.
    """
    x = edges_and_centres(low, high)
    in_bin = float(high[0] - low[0]) / np.sqrt(12.0)
    return Sharpening(x, 0.0, float(np.hypot(longest, in_bin)), np.eye(len(x)), np.zeros(len(x)))


def sharpen(
    low: FloatArray, high: FloatArray, nodes: FloatArray, std: FloatArray, longest: float, steps: int = STEPS
) -> Sharpening:
    """Return how to take away the longest blur up to ``longest`` that the nodes allow.

    Args:
        low, high: (b,) m, edges of adjoining bins of one width.
        nodes: (2 b + 1,) m, the curve at :func:`edges_and_centres`.
        steps: Of the search for slopes; a blur for which they do not suffice counts as one that does not fit.
    """
    weight = 1.0 / np.hypot(std, LEAST_STD)
    least = min(0.0, 2.0 * float(np.min(np.diff(nodes[1::2]) / np.diff(low)))) if len(low) > 1 else 0.0
    for share in BLURS:
        found = _sharpen(low, high, nodes, weight, share * longest, least, steps)
        if found is not None:
            return found
    return unsharpened(low, high, longest)


def _sharpen(
    low: FloatArray, high: FloatArray, nodes: FloatArray, weight: FloatArray, blur: float, least: float, steps: int
) -> Sharpening | None:
    """Return how to take away a blur (m); None where no curve with slopes of at least ``least`` becomes these nodes."""
    width = float(high[0] - low[0])
    step, beyond = width / CELLS, _beyond(width, blur)
    response = _response(len(low), width, blur)
    cells = response.shape[1]
    base = least * response.sum(axis=1)
    rows = weight[:, None] * np.column_stack([np.ones(len(nodes)), response])
    wanted = weight * (nodes - base)
    gram = rows.T @ rows
    gram[1:, 1:] += max(LEAST_ROUGHNESS, ROUGHNESS * blur) ** 2 * _changes(cells)
    found = non_negative(gram, rows.T @ wanted, steps)
    if found is None or np.sqrt(np.mean((rows @ found.value - wanted) ** 2)) > MOST_MISFIT:
        return None
    solved = found.linear(rows.T * weight)
    inside = slice(beyond, cells + 1 - beyond)
    integral = np.concatenate([np.zeros((1, len(nodes))), np.cumsum(step * solved[1:], axis=0)]) + solved[0]
    slope = least * step * np.arange(cells + 1)
    return Sharpening(
        displacement=low[0] + step * np.arange(cells + 1 - 2 * beyond),
        blur=blur,
        left=0.0,
        inverse=integral[inside],
        constant=(slope - integral @ base)[inside],
    )


@lru_cache(maxsize=_KEPT)
def _changes(cells: int) -> FloatArray:
    """Return the normal matrix (cells, cells) of changes of the slope from cell to cell."""
    matrix = 2.0 * np.eye(cells) - np.eye(cells, k=1) - np.eye(cells, k=-1)
    matrix[[0, -1], [0, -1]] = 1.0
    matrix.flags.writeable = False
    return matrix


def _beyond(width: float, blur: float) -> int:
    """Return how many cells there are beyond the bins at each end."""
    return max(CELLS, int(np.ceil(REACH * blur * CELLS / width)))


@lru_cache(maxsize=_KEPT)
def _response(bins: int, width: float, blur: float) -> FloatArray:
    """Return what a slope of 1 in each cell makes of the nodes of the bins, blurred: (2 b + 1, cells), m."""
    beyond = _beyond(width, blur)
    edges = width / CELLS * (np.arange(CELLS * bins + 2 * beyond + 1) - beyond)
    u = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    x = width * (np.arange(bins)[:, None] + 0.5 + u)
    ramp = _blurred_ramp(x.ravel()[:, None] - edges, blur)
    curves = (ramp[:, :-1] - ramp[:, 1:]).reshape(bins, SAMPLES, -1)
    quadratic = np.linalg.pinv(np.vander(u, 3, increasing=True))
    response = nodes_of(np.einsum("kq,bqn->bkn", quadratic, curves))
    response.flags.writeable = False
    return response


def _blurred_ramp(x: FloatArray, blur: float) -> FloatArray:
    """Return max(x, 0) averaged over a normal error of x with std ``blur``."""
    if blur <= 0.0:
        return np.maximum(x, 0.0)
    z = x / blur
    return np.asarray(x * ndtr(z) + blur / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * z**2))


STEEP = 2.0  # times the median slope: what is steeper is part of a jump


def jumps_displaced(x: FloatArray, curve: FloatArray, middle: float, by: float) -> FloatArray:
    """Return a curve (n,) whose contact jumps are further from ``middle`` by ``by`` (m; negative: nearer)."""
    _, rises = split_at_rises(x, curve, middle)
    return np.asarray(curve - rises + displaced(x, rises, middle, by))


def split_at_rises(x: FloatArray, curve: FloatArray, middle: float) -> tuple[FloatArray, FloatArray]:
    """Return a curve (n,) without what is steep or falls, and what is steep of it; both are zero at ``middle``."""
    slope, steps = np.diff(curve) / np.diff(x), np.diff(x)
    limit = STEEP * max(float(np.median(slope)), 0.0)
    flat = np.append(0.0, np.cumsum(np.clip(slope, 0.0, limit) * steps))
    rises = np.append(0.0, np.cumsum(np.maximum(slope - limit, 0.0) * steps))
    return flat - np.interp(middle, x, flat), rises - np.interp(middle, x, rises)


def displaced(x: FloatArray, values: FloatArray, middle: float, by: float | FloatArray) -> FloatArray:
    """Return values (n,) that are further from ``middle`` by ``by`` (m, or (n,) m; negative: nearer)."""
    away = x - middle
    return np.interp(middle + np.sign(away) * np.maximum(np.abs(away) - by, 0.0), x, values)
