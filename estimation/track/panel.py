"""Alignment and geometry together, from many passes of many wheelsets over one place: a panel regression.

At one place, pass p of wheelset w has y = d + h_w(R) + noise, where h_w is the inverse of its rolling radius
difference R(y - d) and d belongs to the place. With h_w = sum_j c_wj phi_j (hat functions of R) this is linear in d
and c: d is the mean over the passes, c follows from what the passes have apart. No start, no rounds, one minimum; and
because R is measured far better than y, the regression of y on R is the one that its noise does not flatten.
Everything is compared after the same high-pass.

Two more columns per wheelset are linear too: the elastic part of R, whose coefficient says by how much the assumed
ratio of yaw stiffness to creep coefficient is off; and, where the gauge deviation e(s) is given, hats of R times e and
times its square, h(R, e) = h0(R) + e h1(R) + e^2 h2(R), because gauge moves each wheel against its own rail.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from estimation.arrays import BoolArray, FloatArray, IntArray
from estimation.errors import ParameterError
from estimation.track.local_filter import smoother, trusted, without_slow_part
from estimation.track.measured import MeasuredCurve
from estimation.track.passes import Pass, gridded
from estimation.types import GaugeShift


@dataclass(frozen=True, slots=True)
class PanelParameters:
    """Grid, filter and functions of the panel."""

    step: float = 1.0  # m
    length: float = 12_000.0  # m of the section
    cut_off: float = 30.0  # m
    difference_cut_off: float = 120.0  # m, of R before h is applied to it: h is not linear, so R must be whole
    reach: float = 5.0e-3  # m of R that the hat functions span, both ways; further out is flange contact, and h flat
    impact: float = 6.0e-3  # m of R; beyond lie flange impacts, hunting and clipped sensors: what is near is left out
    hats: int = 41
    gauge: FloatArray | None = field(default=None, compare=False)  # (points,) m, deviation; None: none is modelled
    gauge_hats: int = 15
    shifts: Mapping[str, GaugeShift] | None = field(default=None, compare=False)  # of wheelsets, as far as known
    measured: Mapping[str, MeasuredCurve] | None = field(default=None, compare=False)  # of wheelsets, as far as known
    weights: Mapping[str, float] | None = field(default=None, compare=False)  # of a pass, by wheelset; 1 unless told
    gauge_unit: float = 2e-3  # m
    groups: int = 12  # of the jackknife, dealt along the section
    block: float = 250.0  # m
    roughness: float = 1e-3  # of h, relative to the data
    least_passes: int = 3  # at a place

    def __post_init__(self) -> None:
        for name in ("step", "length", "cut_off", "difference_cut_off", "reach", "impact", "block", "gauge_unit"):
            if not getattr(self, name) > 0:
                raise ParameterError(f"{getattr(self, name)!r} is not positive", field=name)

    @property
    def points(self) -> int:
        """Grid points of the section."""
        return int(self.length / self.step) + 1

    @property
    def knots(self) -> FloatArray:
        """Knots (hats,) of R, m."""
        return _knots(self.reach, self.hats)

    @property
    def gauge_knots(self) -> FloatArray:
        """Knots (gauge_hats,) of R, m, of h1 and h2."""
        return _knots(self.reach, self.gauge_hats)

    @property
    def columns(self) -> int:
        """Unknowns per wheelset: h0, then h1 and h2 where gauge is modelled, then the elastic part."""
        return self.hats + (0 if self.gauge is None else 2 * self.gauge_hats) + 1

    def weight_of(self, wheelset: str) -> float:
        """Return how much a pass of this wheelset counts."""
        return 1.0 if self.weights is None else self.weights.get(wheelset, 1.0)

    @property
    def reach_points(self) -> int:
        """Grid points at each end of a pass that the two filters cannot say anything of."""
        return (len(smoother(self.cut_off, self.step)) + len(smoother(self.difference_cut_off, self.step))) // 2


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
    lies: bool = False  # evidence of how the place lies is among the sums


def _knots(reach: float, count: int) -> FloatArray:
    """Return knots (count,), closer together around zero, where contact jumps are small and data many."""
    return np.asarray(reach * np.sinh(np.linspace(-1.5, 1.5, count)) / np.sinh(1.5))


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


def filtered(
    item: Pass, parameters: PanelParameters
) -> tuple[IntArray, npt.NDArray[np.float32], FloatArray, FloatArray] | None:
    """Return grid points (m,), filtered columns (k, m), y (m,) and R (m,) of a pass; None where it is too short.

    Columns and R change their sign where the wheelset's left wheel runs on the section's right rail.
    """
    felt = on_grid(item, parameters)
    if felt is None:
        return None
    weights = smoother(parameters.cut_off, parameters.step)
    # single precision: half the time, and columns have no drift that would use it up
    shapes = columns(felt, parameters).astype(np.float32)
    B = without_slow_part(shapes, weights.astype(np.float32))[:, felt.inside]
    y, R = without_slow_part(np.stack([felt.displacement, felt.difference]), weights)[:, felt.inside]
    return felt.points[felt.inside], item.side * B, y, item.side * R


def unexplained(item: Pass, curve: FloatArray, parameters: PanelParameters) -> tuple[IntArray, FloatArray] | None:
    """Return grid points (m,) and the filtered y - h(R) (m,) of a pass, m; None where it is too short.

    Parameters
    ----------
    item
        The pass.
    curve
        (columns,) coefficients of its wheelset.
    parameters
        Of the panel.
    """
    felt = on_grid(item, parameters)
    if felt is None:
        return None
    rest = felt.displacement - item.side * (curve @ columns(felt, parameters))
    filtered_rest = without_slow_part(rest, smoother(parameters.cut_off, parameters.step))
    return felt.points[felt.inside], filtered_rest[felt.inside]


@dataclass(frozen=True, slots=True)
class OnGrid:
    """A pass on the grid of the section; ``inside`` where both filters see enough of it, and no impact."""

    points: IntArray  # (m,)
    displacement: FloatArray  # (m,) y, m, without ``shift``, slow part meaningless
    shift: FloatArray  # (m,) m, what is known beforehand of what the gauge does to y
    difference: FloatArray  # (m,) R, m, without what is longer than ``difference_cut_off``
    elastic: FloatArray  # (m,) m
    certain: BoolArray  # (m,) where R is, and no impact
    inside: BoolArray  # (m,)


def on_grid(item: Pass, parameters: PanelParameters) -> OnGrid | None:
    """Return a pass on the grid, R high-passed once; None where it is too short or off the section."""
    first, displacement, difference = gridded(item, parameters.step)
    points = np.arange(first, first + len(displacement))
    if len(points) <= 2 * parameters.reach_points + 1:
        return None
    long = smoother(parameters.difference_cut_off, parameters.step)
    certain = trusted(np.ones(len(points), dtype=np.bool_), long)
    elastic = (
        np.zeros(len(points)) if item.elastic is None else np.interp(points * parameters.step, item.at, item.elastic)
    )
    R, E = without_slow_part(np.stack([difference, elastic]), long)
    certain &= np.abs(R) <= parameters.impact
    inside = trusted(certain, smoother(parameters.cut_off, parameters.step))
    inside &= (points >= 0) & (points < parameters.points)
    if not inside.any():
        return None
    R, E = np.where(certain, R, 0.0), np.where(certain, E, 0.0)
    shift = _shift(item, points, R, parameters)
    return OnGrid(points, displacement - shift, shift, R, E, certain, inside)


def _shift(item: Pass, points: IntArray, R: FloatArray, parameters: PanelParameters) -> FloatArray:
    known = None if parameters.shifts is None else parameters.shifts.get(item.wheelset)
    if known is None:
        return np.zeros(len(points))
    return item.side * known.at(R, gauge_at(points, parameters))


def columns(felt: OnGrid, parameters: PanelParameters) -> FloatArray:
    """Return the functions (k, m) of a pass that its displacement is a sum of, before the filter."""
    R = np.clip(felt.difference, -parameters.reach, parameters.reach)
    rows = [hat_functions(R, parameters.knots)]
    if parameters.gauge is not None:
        coarse = hat_functions(R, parameters.gauge_knots)
        e = gauge_at(felt.points, parameters) / parameters.gauge_unit
        rows += [coarse * e, coarse * e**2]
    return np.concatenate([*rows, felt.elastic[None, :]])


def gauge_at(points: IntArray, parameters: PanelParameters) -> FloatArray:
    """Return the gauge deviation (m,) at grid points, m; zero off the section."""
    assert parameters.gauge is not None
    on = (points >= 0) & (points < parameters.points)
    return np.where(on, parameters.gauge[np.clip(points, 0, parameters.points - 1)], 0.0)


def hat_functions(R: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the values (k, n) of the piecewise linear functions of R; beyond the outer knots they go on straight."""
    cell = np.clip(np.searchsorted(knots, R) - 1, 0, len(knots) - 2)
    share = (R - knots[cell]) / (knots[cell + 1] - knots[cell])
    values = np.zeros((len(knots), len(R)))
    at = np.arange(len(R))
    values[cell, at] = 1.0 - share
    values[cell + 1, at] = share
    return values
