"""Alignment and geometry together, from many passes of many wheelsets over one place: a panel regression.

At one place, pass p of wheelset w has y = d + h_w(R) + noise, where h_w is the inverse of its rolling radius
difference R(y - d) and d belongs to the place. With h_w = sum_j c_wj phi_j (hat functions of R) this is linear in d
and c: d is the mean over the passes, c follows from what the passes have apart. No start, no rounds, one minimum; and
because R is measured far better than y, the regression of y on R is the one that its noise does not flatten.
Everything is compared after the same high-pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.arrays import FloatArray, IntArray
from estimation.errors import ParameterError
from estimation.track.local_filter import smoother, trusted, without_slow_part
from estimation.track.passes import Pass, gridded


@dataclass(frozen=True, slots=True)
class PanelParameters:
    """Grid, filter and functions of the panel."""

    step: float = 0.5  # m
    length: float = 12_000.0  # m of the section
    cut_off: float = 30.0  # m
    reach: float = 2.5e-3  # m of R that the hat functions span, both ways
    hats: int = 41
    groups: int = 12  # of the jackknife, dealt along the section
    block: float = 250.0  # m
    roughness: float = 1e-3  # of h, relative to the data
    least_passes: int = 3  # at a place

    def __post_init__(self) -> None:
        for name in ("step", "length", "cut_off", "reach", "block"):
            if not getattr(self, name) > 0:
                raise ParameterError(f"{getattr(self, name)!r} is not positive", field=name)

    @property
    def points(self) -> int:
        """Grid points of the section."""
        return int(self.length / self.step) + 1

    @property
    def knots(self) -> FloatArray:
        """Knots (hats,) of R, m."""
        return np.linspace(-self.reach, self.reach, self.hats)


@dataclass(frozen=True, slots=True)
class PanelState:
    """Sums over passes; merging or adding passes in any order gives the same sums up to rounding.

    ``gram`` and ``cross`` are per group of blocks along the section; ``functions``, ``displacement`` and ``passes`` are
    per grid point. Wheelsets are in the order in which they came.
    """

    parameters: PanelParameters
    wheelsets: tuple[str, ...]
    gram: FloatArray  # (g, w, k, k)
    cross: FloatArray  # (g, w, k)
    square: FloatArray  # (g,) sum of y^2
    functions: FloatArray  # (w, k, n) sum over passes of the filtered hats
    displacement: FloatArray  # (n,) sum over passes of the filtered y
    passes: IntArray  # (n,)
    difference: FloatArray  # (2, n) sums of the filtered R and of its square


def init(parameters: PanelParameters) -> PanelState:
    """Return the empty state."""
    g, k, n = parameters.groups, parameters.hats, parameters.points
    return PanelState(
        parameters,
        (),
        np.zeros((g, 0, k, k)),
        np.zeros((g, 0, k)),
        np.zeros(g),
        np.zeros((0, k, n)),
        np.zeros(n),
        np.zeros(n, dtype=np.int64),
        np.zeros((2, n)),
    )


def update(state: PanelState, passes: list[Pass]) -> PanelState:
    """Return the state with ``passes`` added; the cost is that of the passes, and one copy of the sums."""
    wheelsets = tuple(dict.fromkeys((*state.wheelsets, *(item.wheelset for item in passes))))
    new = len(wheelsets) - len(state.wheelsets)
    gram = np.pad(state.gram, ((0, 0), (0, new), (0, 0), (0, 0)))
    cross = np.pad(state.cross, ((0, 0), (0, new), (0, 0)))
    functions = np.pad(state.functions, ((0, new), (0, 0), (0, 0)))
    square, displacement = state.square.copy(), state.displacement.copy()
    counts, difference = state.passes.copy(), state.difference.copy()
    for item in passes:
        columns = filtered(item, state.parameters)
        if columns is None:
            continue
        w, (at, B, y, R) = wheelsets.index(item.wheelset), columns
        for group in np.unique(groups_of(at, state.parameters)):
            mine = groups_of(at, state.parameters) == group
            gram[group, w] += B[:, mine] @ B[:, mine].T
            cross[group, w] += B[:, mine] @ y[mine]
            square[group] += y[mine] @ y[mine]
        functions[w][:, at] += B
        displacement[at] += y
        counts[at] += 1
        difference[0, at] += R
        difference[1, at] += R * R
    return replace(
        state,
        wheelsets=wheelsets,
        gram=gram,
        cross=cross,
        square=square,
        functions=functions,
        displacement=displacement,
        passes=counts,
        difference=difference,
    )


def groups_of(at: IntArray, parameters: PanelParameters) -> IntArray:
    """Return the group (m,) of each grid point: blocks along the section, dealt in turn."""
    return np.asarray((at * parameters.step // parameters.block).astype(np.int64) % parameters.groups)


def filtered(item: Pass, parameters: PanelParameters) -> tuple[IntArray, FloatArray, FloatArray, FloatArray] | None:
    """Return grid points (m,), filtered hats (k, m), y (m,) and R (m,) of a pass; None where it is too short.

    Hats and R change their sign where the wheelset's left wheel runs on the section's right rail.
    """
    weights = smoother(parameters.cut_off, parameters.step)
    first, displacement, difference = gridded(item, parameters.step)
    points = np.arange(first, first + len(displacement))
    if len(points) <= 2 * len(weights):
        return None
    R = without_slow_part(difference, weights)
    certain = trusted(np.ones(len(points), dtype=np.bool_), weights)
    twice = trusted(certain, weights)  # the hats of the filtered R are filtered themselves
    inside = twice & (points >= 0) & (points < parameters.points)
    if not inside.any():
        return None
    B = without_slow_part(hat_functions(np.where(certain, R, 0.0), parameters.knots), weights)
    y = without_slow_part(displacement, weights)
    return points[inside], item.side * B[:, inside], y[inside], item.side * R[inside]


def hat_functions(R: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the values (k, n) of the piecewise linear functions of R; beyond the outer knots they go on straight."""
    cell = np.clip(np.searchsorted(knots, R) - 1, 0, len(knots) - 2)
    share = (R - knots[cell]) / (knots[cell + 1] - knots[cell])
    values = np.zeros((len(knots), len(R)))
    at = np.arange(len(R))
    values[cell, at] = 1.0 - share
    values[cell + 1, at] = share
    return values
