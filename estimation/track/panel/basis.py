"""Alignment and geometry together, from many passes over one place: the sums of a panel regression.

At one place, pass p of wheelset w has y = d + h_w(R) + noise (``docs/unknown-track.md``). With h_w piecewise linear
this is linear in d and h. Two more terms are, too: the stiffness term of R, and, where the gauge deviation e is given,
functions of R times e and e^2. A wheelset's h is known from measured profiles, too: contact geometry, inverted.

At every grid point at most two of the piecewise linear functions of R are not zero. Their high-pass is made by adding
the filter's weights at these alone, instead of filtering every function over the whole pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any, TypeVar

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile
from estimation.filters import high_pass
from estimation.track.gridded_pass import GriddedPass, SectionGrid
from estimation.track.parameters import TRACK
from estimation.track.passes import ProfileLife
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, as_slice
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class MeasuredCurve(FrozenArrays):
    """Lateral displacement relative to the track over rL - rR by measured profiles; zero at rL = rR."""

    name: str  # of what was measured, for reports
    difference: Annotated[FloatArray, "n"]  # rL - rR, m, increasing
    displacement: Annotated[FloatArray, "n"]  # y - d, m
    std: float  # m, of the displacement

    def at(self, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the displacement (k,), m, at some rL - rR (k,), m, and 1 where the profiles reach it, else 0 (k,)."""
        reached = (knots >= self.difference[0] + TRACK.table_edge) & (knots <= self.difference[-1] - TRACK.table_edge)
        return np.interp(knots, self.difference, self.displacement), reached.astype(np.float64)

    @property
    def spread(self) -> float:
        """Half of the range of the displacement, m: an error ``std`` of it is a stretch by their ratio."""
        return float(np.ptp(self.displacement)) / 2.0


def measured_curve(
    name: str,
    left: Profile,
    right: Profile,
    std: float,
    *,
    rail: str,
    inclination: float,
    gauge: float,
    at_rails: bool = True,
) -> MeasuredCurve:
    """Return the curve of the measured profiles of a wheelset on a track.

    ``std`` is that of the displacement, m; ``at_rails`` says that passes have it at rail level, as EN 15302, and not as
    that of the axle, which rolls. ContactError: the profiles do not meet the rails; ProfileError: no such rail.
    """
    rails = rail_profile(rail)
    wheelset = WheelsetOnTrack(left, right, rails, rails, inclination, gauge)
    steps = round(TRACK.basis_reach / TRACK.basis_step)
    x = TRACK.basis_step * np.arange(-steps, steps + 1)
    curve = radius_difference_curve(wheelset, x, method=ContactMethod.EN15302 if at_rails else ContactMethod.RIGID)
    x, R = curve.displacement, curve.difference
    risen = np.maximum.accumulate(R)  # h(R) is the inverse of what rises: a step of R is a flat of h
    first = np.concatenate([[True], np.diff(risen) > 0.0])
    difference, displacement = risen[first], x[first]
    return MeasuredCurve(name, difference, displacement - float(np.interp(0.0, difference, displacement)), std)


@dataclass(frozen=True, slots=True)
class PanelParameters:
    """Grid, filter and basis functions of the panel."""

    step: float = 1.0  # m
    length: float = 12_000.0  # m of the section
    cutoff_wavelength: float = 30.0  # m
    difference_cutoff_wavelength: float = 120.0  # m, of R before h is applied to it
    reach: float = 5.0e-3  # m of R that the basis functions span, both ways; beyond is flange contact, and h flat
    impact: float = 6.0e-3  # m of R, beyond which nothing is used
    basis_count: int = 41  # basis functions of h0
    gauge_basis_count: int = 15  # of h1, and of h2
    gauge_unit: float = 2e-3  # m
    groups: int = 12  # of the jackknife: blocks along the section in turn
    block: float = 250.0  # m
    roughness: float = 1e-3  # of h, relative to the data
    least_passes: int = 3  # at a grid point
    least_diversity: float = 0.05
    least_wheelsets: int = 2
    gauge_ridge: float = 1e-4  # of h1 and h2 per knot, relative to the data of a knot of h0
    stiffness_term_prior: float = 2e-7  # m2: variance of a pass over that of the coefficient of the stiffness term
    pass_std: float = 0.12e-3  # m of y - d - h(R) of a pass, as measured profiles are weighed against it
    correlated_samples: float = 20.0  # samples of a pass whose errors are one
    independent_parts: float = 4.0  # of a measured curve, whose errors are their own
    fixed_curve_weight: float = 100.0  # times the data of a knot: a curve that only the measurement determines
    slope_reach: float = 20.0  # m, of the filter to both sides
    ridge: float = 1e-4  # of its coefficients, relative to the data
    least_correlation: float = 0.3  # of h(z) and h(R) between the passes of a place: below, the instrument is weak
    systematic_share: float = 0.15  # of 1 / r2 - 1: std of the factor that blocks of data cannot show
    ratio_systematic_std: float = 0.02  # relative, of a model of small terms: blocks of data cannot show it
    least_explained: float = 0.67  # a smaller share says that something else is wrong
    damping: float = 0.6  # of a step: position and ratio would each make up for the other's error

    @property
    def knots(self) -> FloatArray:
        """Knots (basis_count,) of R, m."""
        return _knots(self.reach, self.basis_count)

    @property
    def gauge_knots(self) -> FloatArray:
        """Knots (gauge_basis_count,) of R, m, of h1 and h2."""
        return _knots(self.reach, self.gauge_basis_count)


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel regression: its parameters, the grid of the section, and what is known before it is solved."""

    parameters: PanelParameters
    grid: SectionGrid
    gauge: FloatArray | None = None  # (points,) m, deviation; None: none is modelled
    gauge_shifts: Mapping[ProfileLife, GaugeShift] = field(default_factory=dict)
    measured: Mapping[ProfileLife, MeasuredCurve] = field(default_factory=dict)
    weights: Mapping[ProfileLife, float] = field(default_factory=dict)  # of a pass; 1 where there is none

    @classmethod
    def of(cls, p: PanelParameters, measured: Mapping[ProfileLife, MeasuredCurve] | None = None) -> Panel:
        """Return the panel with the grid of some parameters."""
        grid = SectionGrid(p.length, p.step, p.cutoff_wavelength, p.difference_cutoff_wavelength, p.impact)
        return cls(p, grid, measured=measured or {})

    def weight_of(self, life: ProfileLife) -> float:
        """Return how much a pass of this wheelset counts."""
        return self.weights.get(life, 1.0)

    def with_gauge(self, gauge: FloatArray, gauge_shifts: Mapping[ProfileLife, GaugeShift] | None = None) -> Panel:
        """Return the panel with a gauge deviation (points,), m; its shifts stay as they are by default."""
        return replace(self, gauge=gauge, gauge_shifts=self.gauge_shifts if gauge_shifts is None else gauge_shifts)

    @property
    def unknowns(self) -> int:
        """Unknowns per wheelset: h0, then h1 and h2 where gauge is modelled, then the stiffness term."""
        p = self.parameters
        return p.basis_count + (0 if self.gauge is None else 2 * p.gauge_basis_count) + 1


def _knots(reach: float, count: int) -> FloatArray:
    return np.asarray(reach * np.sinh(np.linspace(-1.5, 1.5, count)) / np.sinh(1.5))


def unfiltered_residual(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return y - h(R) (m,) of a pass at all its grid points, m, before any filter."""
    shift = known_shift(item, panel)
    return np.asarray(item.displacement - shift - item.side * curve_displacement(item, curve, panel))


def pass_residual(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return the high-passed y - h(R) (m,) of a pass at all its grid points, m."""
    return high_pass(unfiltered_residual(item, curve, panel), panel.grid.kernel)


def known_shift(item: GriddedPass, panel: Panel) -> FloatArray:
    """Return what is known beforehand of what the gauge does to y (m,), m."""
    shift = panel.gauge_shifts.get(item.life)
    if shift is None:
        return np.zeros(len(item.points))
    return item.side * shift.at(item.difference, gauge_at(item.points, panel))


def curve_displacement(item: GriddedPass, curve: FloatArray, panel: Panel) -> FloatArray:
    """Return ``curve`` (k,) times the functions that a pass's displacement is a sum of (m,), m, before the filter."""
    p = panel.parameters
    R = np.clip(item.difference, -p.reach, p.reach)
    displacement = np.interp(R, p.knots, curve[: p.basis_count]) + curve[-1] * item.stiffness_term
    if panel.gauge is not None:
        first, second = gauge_curves(curve, panel)
        e = gauge_at(item.points, panel) / p.gauge_unit
        displacement += e * np.interp(R, p.gauge_knots, first) + e**2 * np.interp(R, p.gauge_knots, second)
    return np.asarray(displacement)


def gauge_curves(curve: FloatArray, panel: Panel) -> tuple[FloatArray, FloatArray]:
    """Return h1 and h2 at the gauge knots (gauge_basis_count,), m, of the coefficients (unknowns,) of a wheelset."""
    start, count = panel.parameters.basis_count, panel.parameters.gauge_basis_count
    return curve[start : start + count], curve[start + count : start + 2 * count]


def gauge_at(points: IntArray, panel: Panel) -> FloatArray:
    """Return the gauge deviation (m,) at grid points (m,), m; zero off the section."""
    assert panel.gauge is not None
    on = panel.grid.contains(points)
    return np.where(on, panel.gauge[np.clip(points, 0, panel.grid.points - 1)], 0.0)


def basis_functions(R: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the piecewise linear functions (k, n) of R (n,), m; beyond the knots (k,), m, they go on straight."""
    cell, share = knot_shares(R, knots)
    values = np.zeros((len(knots), len(R)))
    at = np.arange(len(R))
    values[cell, at] = 1.0 - share
    values[cell + 1, at] = share
    return values


def knot_shares(R: FloatArray, knots: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the number of the knot (k,) below R (n,), m, and the share of the next one: outside 0 to 1 beyond them."""
    cell = np.clip(np.searchsorted(knots, R) - 1, 0, len(knots) - 2)
    return cell, (R - knots[cell]) / (knots[cell + 1] - knots[cell])


Singles = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PassRows:
    """The rows of a regression that one pass makes, high-passed, at the grid points that can be used."""

    points: IntArray  # (m,)
    design: Singles  # (k, m)
    displacement: FloatArray  # (m,) y, m
    difference: FloatArray  # (m,) R, m


def pass_rows(item: GriddedPass, panel: Panel) -> PassRows:
    """Return the high-passed design matrix, y and R of a pass that is not empty, signs as the section has them."""
    used = as_slice(np.flatnonzero(item.inside))
    displacement = item.displacement - known_shift(item, panel)
    y, R = high_pass(np.stack([displacement, item.difference]), panel.grid.kernel)[:, used]
    design = item.side * _design(item, panel)[:, used]
    return PassRows(item.used_points, design, y, item.side * R)


def _design(item: GriddedPass, panel: Panel) -> Singles:
    """Return the high-passed functions (k, m) that a displacement is a sum of; single precision takes half the time."""
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
    return np.pad(sums, [(0, new if number == axis else 0) for number in range(sums.ndim)])


def _add(sums: PanelState, w: int, rows: PassRows, weight: float) -> None:
    at, y, R = rows.points, rows.displacement, rows.difference
    block = _block_of(at, sums.panel)
    ends = np.flatnonzero(np.diff(block)) + 1
    for start, end in pairwise((0, *ends.tolist(), len(block))):
        group = int(block[start]) % sums.panel.parameters.groups
        B_there, y_there = rows.design[:, start:end], y[start:end]
        sums.gram[group, w] += weight * (B_there @ B_there.T)
        sums.cross[group, w] += weight * (B_there @ y_there)
        sums.square[group] += weight * (y_there @ y_there)
    sums.basis_sums[w][:, as_slice(at)] += np.float32(weight) * rows.design
    sums.displacement[at] += weight * y
    sums.passes[at] += weight
    sums.count[at] += 1
    sums.difference[0, at] += weight * R
    sums.difference[1, at] += weight * R * R


def groups_of(at: IntArray, panel: Panel) -> IntArray:
    """Return the group (m,) of each grid point (m,): blocks along the section, assigned in turn."""
    return np.asarray(_block_of(at, panel) % panel.parameters.groups)


def _block_of(at: IntArray, panel: Panel) -> IntArray:
    return np.asarray((at * panel.grid.step // panel.parameters.block).astype(np.int64))
