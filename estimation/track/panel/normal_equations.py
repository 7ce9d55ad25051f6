"""Alignment and geometry together, from many passes of many wheelsets over one place: a panel regression.

At one place, pass p of wheelset w has y = d + h_w(R) + noise, where h_w is the inverse of its rolling radius
difference R(y - d) and d belongs to the place. With h_w = sum_j c_wj phi_j (hat functions of R) this is linear in d
and c: d is the mean over the passes, c follows from what the passes have apart. No start, no rounds, one minimum; and
because R is measured far better than y, the regression of y on R is the one that its noise does not flatten.
Everything is compared after the same high-pass.

Two more columns per wheelset are linear too: the stiffness term of R, whose coefficient says by how much the assumed
ratio of yaw stiffness to creep coefficient is off; and, where the gauge deviation e(s) is given, hats of R times e and
times its square, h(R, e) = h0(R) + e h1(R) + e^2 h2(R), because gauge moves each wheel against its own rail.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from estimation.track.panel.basis import PanelParameters, filtered
from estimation.track.passes import Pass
from estimation.values.arrays import FloatArray, IntArray


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
    functions: npt.NDArray[np.float32]  # (w, k, n) sum over passes of the filtered columns
    displacement: FloatArray  # (n,) sum over passes of the filtered y
    passes: FloatArray  # (n,) sum of their weights
    difference: FloatArray  # (2, n) sums of the filtered R and of its square
    met: IntArray  # (n,) passes, whatever they weigh
    has_alignment: bool = False  # evidence of how the place lies is among the sums


def init(parameters: PanelParameters) -> PanelState:
    """Return the empty state."""
    g, k, n = parameters.groups, parameters.columns, parameters.points
    return PanelState(
        parameters,
        (),
        np.zeros((g, 0, k, k)),
        np.zeros((g, 0, k)),
        np.zeros(g),
        np.zeros((0, k, n), dtype=np.float32),
        np.zeros(n),
        np.zeros(n),
        np.zeros((2, n)),
        np.zeros(n, dtype=np.int64),
    )


def update(state: PanelState, passes: list[Pass]) -> PanelState:
    """Return the state with ``passes`` added; the cost is that of the passes, and one copy of the sums."""
    wheelsets = tuple(dict.fromkeys((*state.wheelsets, *(item.wheelset for item in passes))))
    new = len(wheelsets) - len(state.wheelsets)
    gram = np.pad(state.gram, ((0, 0), (0, new), (0, 0), (0, 0)))
    cross = np.pad(state.cross, ((0, 0), (0, new), (0, 0)))
    functions = np.pad(state.functions, ((0, new), (0, 0), (0, 0)))
    square, displacement = state.square.copy(), state.displacement.copy()
    counts, difference, met = state.passes.copy(), state.difference.copy(), state.met.copy()
    for item in passes:
        columns = filtered(item, state.parameters)
        if columns is None:
            continue
        w, (at, B, y, R) = wheelsets.index(item.wheelset), columns
        weight = state.parameters.weight_of(item.wheelset)
        for group, B_there, y_there in _dealt(at, B, y, state.parameters):
            gram[group, w] += weight * (B_there @ B_there.T)
            cross[group, w] += weight * (B_there @ y_there)
            square[group] += weight * (y_there @ y_there)
        functions[w][:, _whole(at)] += np.float32(weight) * B
        displacement[at] += weight * y
        counts[at] += weight
        met[at] += 1
        difference[0, at] += weight * R
        difference[1, at] += weight * R * R
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
        met=met,
    )


def _dealt(
    at: IntArray, B: npt.NDArray[np.float32], y: FloatArray, parameters: PanelParameters
) -> Iterator[tuple[int, npt.NDArray[np.float32], FloatArray]]:
    """Yield each group with its part of the columns (k, m) and of the displacement (m,)."""
    group = groups_of(at, parameters)
    order = np.argsort(group, kind="stable")
    B, y = B[:, order], y[order]
    ends = np.cumsum(np.bincount(group, minlength=parameters.groups))
    for number, (start, end) in enumerate(pairwise((0, *ends))):
        if end > start:
            yield number, B[:, start:end], y[start:end]


def _whole(at: IntArray) -> IntArray | slice:
    """Return increasing grid points as a slice where none is left out: many times quicker to add to."""
    return slice(int(at[0]), int(at[-1]) + 1) if at[-1] - at[0] + 1 == len(at) else at


def groups_of(at: IntArray, parameters: PanelParameters) -> IntArray:
    """Return the group (m,) of each grid point: blocks along the section, dealt in turn."""
    return np.asarray((at * parameters.step // parameters.block).astype(np.int64) % parameters.groups)
