"""Bin tables: the piecewise, locally linear least squares of a wheelset, on mergeable statistics.

Samples are assigned to bins of lateral displacement y - d (Eq. 19-21). Inside a bin, with u = (y - d - centre)/width,
the lateral equation has regressors [x1, x1 u, x2, x2 u], the yaw equation [(l W/2) psi, c, c u, c u^2]: S, D and A
are constant or linear across the bin, R is quadratic, so that the variation of R inside the bin cannot pose as A.

For ``z = X theta`` the sums ``X'X``, ``X'z``, ``z'z`` and the weight are sufficient for ``theta``. They add: a window
is reduced in one pass, windows merge in any grouping, older ones with a smaller weight, and the answer equals that of
the recursion sample by sample (Eq. 10-14 of the paper). A sample has ``p`` regressors and ``t`` targets: the first is
the measurement, the others are its derivatives by uncertain parameters (``estimation.vehicle.regressors``).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.compiled import compiled
from estimation.errors import ParameterError
from estimation.motion.integration import WindowParameters
from estimation.motion.parameters import MOTION
from estimation.motion.window_motion import window_motion
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.memory import MEMORY
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.units import STD_PER_MAD
from estimation.values.windows import Motion, Window
from estimation.vehicle.regressors import (
    LATERAL_TARGETS,
    REGRESSORS,
    SHARED_IN_BOGIE,
    YAW_TARGET_COLUMNS,
    YAW_TARGETS,
    Coefficients,
    Signals,
    coefficients,
    lateral_equation,
    radius_factor,
    signals_of,
    yaw_moments,
    yaw_regressors,
    yaw_targets,
)
from estimation.vehicle.vehicle_class import VehicleParameters, difference_noise


def packed_size(regressors: int, targets: int) -> int:
    """Return the length of the packed moments of one cell.

    They are the upper triangle of ``X'X`` row by row, ``X'Z`` row by row, and ``z'z`` of the first target.
    """
    return regressors * (regressors + 1) // 2 + regressors * targets + 1


@dataclass(frozen=True, slots=True)
class Solution(FrozenArrays):
    """Least-squares solution of each cell; NaN where the normal matrix is singular."""

    theta: Annotated[FloatArray, "c", "p", "t"]  # one column a target
    residual_variance: FloatArray  # (c,) of the first target
    inverse: Annotated[FloatArray, "c", "p", "p"]  # inverse of X'X (through the scaled eigenvectors)


def solve(packed: FloatArray, weight: FloatArray, regressors: int, targets: int) -> Solution:
    """Solve the normal equations of cells, packed (c, packed_size), after scaling each regressor to unit length."""
    gram, cross, square = unpack(packed, regressors, targets)
    inverse = inverses(gram)
    theta = np.einsum("cij,cjt->cit", inverse, cross)
    explained = np.einsum("ci,ci->c", theta[:, :, 0], cross[:, :, 0])
    residual_variance = np.maximum(square - explained, 0.0) / np.maximum(weight - regressors, 1.0)
    return Solution(theta, residual_variance, inverse)


def inverses(gram: FloatArray) -> FloatArray:
    """Return the inverses (c, p, p) of normal matrices, scaled to unit diagonals first; NaN where singular."""
    scale = np.sqrt(np.einsum("cii->ci", gram))
    safe = np.where(scale > 0, scale, np.inf)
    scaled = gram / (safe[:, :, None] * safe[:, None, :])
    scaled_inverse = np.full_like(scaled, np.nan)
    filled = np.all(scale > 0, axis=1)  # the others have directions that are not in the data
    values, vectors = np.linalg.eigh(scaled[filled])
    ok = values[:, 0] > MOTION.smallest_eigenvalue
    inverse_values = np.full_like(values, np.nan)
    inverse_values[ok] = 1.0 / values[ok]
    scaled_inverse[filled] = np.einsum("cij,cj,ckj->cik", vectors, inverse_values, vectors)
    return np.asarray(scaled_inverse / (safe[:, :, None] * safe[:, None, :]))


def unpack(packed: FloatArray, regressors: int, targets: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return X'X (c, p, p), X'Z (c, p, t) and z'z (c,) from packed moments (c, packed_size)."""
    p, triangle = regressors, regressors * (regressors + 1) // 2
    rows, columns = np.triu_indices(p)
    gram = np.empty((len(packed), p, p))
    gram[:, rows, columns] = packed[:, :triangle]
    gram[:, columns, rows] = packed[:, :triangle]
    return gram, packed[:, triangle : triangle + p * targets].reshape(len(packed), p, targets), packed[:, -1]


LATERAL_REGRESSORS = 4
LATERAL_COLUMNS = 11  # with the targets
NOISE = 6  # of the targets of Eq. 2
OUTSIDE = -1
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio
HALF = np.uint64(32)


@compiled(nogil=True)
def group(block: int, groups: int) -> int:
    """Return the group of a block: in turn, and each round begins at another group."""
    # were it in turn alone, a vehicle that passes at the same time every day would fill the same few groups for ever
    turn = np.uint64(block // groups) * GOLDEN >> HALF  # spreads any regular step evenly
    return int((block + np.int64(turn * np.uint64(groups) >> HALF)) % groups)


@compiled(nogil=True)
def assign(
    displacement: FloatArray, valid: BoolArray, block: IntArray, groups: int,
    first_edge: float, width: float, bins: int, cell: IntArray, u: FloatArray,
) -> int:  # fmt: skip
    """Write the cell of each sample, or ``OUTSIDE``, and where in its bin it is; return how many have a cell."""
    inside, last_block, first_cell = 0, -1, 0
    for i in range(len(displacement)):
        cell[i] = OUTSIDE
        position = (displacement[i] - first_edge) / width
        if valid[i] and block[i] >= 0 and 0.0 <= position < bins:
            if block[i] != last_block:
                last_block, first_cell = block[i], group(block[i], groups) * bins
            index = int(position)
            cell[i] = first_cell + index
            u[i] = position - index - 0.5
            inside += 1
    return inside


@compiled(nogil=True, error_model="numpy")
def radius_difference(signals: Signals, k: Coefficients, cell: IntArray, difference: FloatArray) -> None:
    """Write rL - rR by Eq. 2 with the other terms left out; NaN where a sample has no cell."""
    c = radius_factor(k)
    for i in range(len(cell)):
        difference[i] = np.nan
        if cell[i] != OUTSIDE:
            difference[i] = yaw_moments(signals, k, i)[0] / c


@compiled(nogil=True)
def add_products(row: FloatArray, regressors: int, sums: FloatArray, at: int) -> None:
    """Add to ``sums[at]`` (p + 1, m) the products of p regressors with what follows in the row (m,), and z'z."""
    for a in range(regressors):
        x = row[a]
        for j in range(a, len(row)):
            sums[at, a, j] += x * row[j]
    sums[at, regressors, 0] += row[regressors] * row[regressors]


@compiled(nogil=True, error_model="numpy")
def add_samples(
    signals: Signals, k: Coefficients, noise: float, cell: IntArray, u: FloatArray, slot: IntArray,
    weight: FloatArray, lateral: FloatArray, yaw: FloatArray,
) -> None:  # fmt: skip
    """Add every sample to the sums of its cell, which are in slot ``slot[cell]``; ``noise`` is the variance of R."""
    equation, row, yaw_row = np.empty(9), np.empty(LATERAL_COLUMNS), np.empty(yaw.shape[2])
    regressors = yaw.shape[2] - YAW_TARGET_COLUMNS
    for i in range(len(cell)):
        if cell[i] == OUTSIDE:
            continue
        at, v = slot[cell[i]], u[i]
        weight[at] += 1.0
        lateral_equation(signals, k, i, equation)
        row[0], row[1], row[2], row[3] = equation[0], equation[0] * v, equation[1], equation[1] * v
        for j in range(2, len(equation)):
            row[j + 2] = equation[j]
        add_products(row, LATERAL_REGRESSORS, lateral, at)
        yaw_regressors(signals, k, i, yaw_row)
        yaw_targets(signals, k, i, yaw_row, regressors - 1)
        c = yaw_row[regressors - 1]
        yaw_row[regressors - 3], yaw_row[regressors - 2], yaw_row[regressors - 1] = c, c * v, c * v * v
        yaw_row[regressors + NOISE] += c * noise
        add_products(yaw_row, regressors, yaw, at)


def pack(sums: FloatArray) -> FloatArray:
    """Return the packed moments (c, packed_size) of the sums (c, p + 1, m) that samples were added to."""
    p = sums.shape[1] - 1
    rows, columns = np.triu_indices(p)
    cross = sums[:, :p, p:].reshape(len(sums), p * (sums.shape[2] - p))
    return np.concatenate([sums[:, rows, columns], cross, sums[:, p, :1]], axis=1)


class TableSum:
    """What has been added so far, in the order in which it was, to a table without samples or a sum that goes on."""

    def __init__(self, start: BinTable) -> None:
        self.start = start
        self._sums = [array.copy() for array in (start.weight, start.lateral, start.yaw)]
        self._samples, self._windows = start.samples, start.windows

    def add(self, table: BinTable | FilledCells, weight: float = 1.0) -> None:
        """Add a table, whole or its filled cells, times a weight; samples and windows are counted without weights."""
        if table.parameter_key != self.start.parameter_key:
            both = f"{self.start.parameter_key} and {table.parameter_key}"
            raise ValueError(f"bin tables of parameters {both} do not merge")
        for whole, added in zip(self._sums, (table.weight, table.lateral, table.yaw), strict=True):
            share = added if weight == 1.0 else weight * added
            if isinstance(table, FilledCells):
                whole.reshape(-1, *whole.shape[2:])[table.cells] += share
            else:
                np.add(whole, share, out=whole)
        self._samples += table.samples
        self._windows += table.windows

    def table(self) -> BinTable:
        """Return the sum."""
        weight, lateral, yaw = self._sums
        samples, windows = self._samples, self._windows
        return replace(self.start, weight=weight, lateral=lateral, yaw=yaw, samples=samples, windows=windows)


TABLE_VERSION = 6


@dataclass(frozen=True, slots=True)
class BinParameters:
    """Everything that shapes the statistics of a bin table."""

    width: float = 0.25e-3  # m
    reach: float = 7.0e-3  # m; bins cover -reach..reach
    groups: int = 16  # of the jackknife
    source: str = "ideal"  # what the motion came from, signal filters included
    band_limited: bool = False  # offsets carry no meaning
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    wheelbase: float | None = None  # m, of the bogie that the yaw spring is tied to; None without one
    difference_noise: float = 0.0  # m2 (m/s)3: variance of R by the noise of the sensors times the cube of the speed
    arrangement: str = ""  # of axles and sensors, which shape the motion too, as text

    def __post_init__(self) -> None:
        if not 0 < self.width < self.reach:
            raise ParameterError(f"bin width {self.width} m must be positive and below reach", field="width")
        if self.groups < 4:  # noqa: PLR2004 - a jackknife over fewer has no spread
            raise ParameterError(f"{self.groups} groups; at least 4 are needed", field="groups")

    @property
    def edges(self) -> FloatArray:
        """Bin edges (b + 1,), m; a bin is centred on zero displacement."""
        half = int(np.ceil(self.reach / self.width - 0.5))
        return np.asarray((np.arange(-half, half + 2) - 0.5) * self.width, dtype=np.float64)

    @property
    def yaw_regressors(self) -> int:
        """Number of regressors of the yaw equation."""
        return REGRESSORS if self.wheelbase is None else REGRESSORS - 1 + SHARED_IN_BOGIE

    @property
    def key(self) -> str:
        """Digest of the parameters; tables with different keys never merge."""
        return _key(self)


@lru_cache(maxsize=MEMORY.wheelset_keys)
def _key(parameters: BinParameters) -> str:
    text = json.dumps({"version": TABLE_VERSION, **asdict(parameters)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def init(parameters: BinParameters) -> BinTable:
    """Return the empty table."""
    edges = parameters.edges
    shape = (parameters.groups, len(edges) - 1)
    return BinTable(
        parameter_key=parameters.key,
        edges=edges,
        weight=np.zeros(shape),
        lateral=np.zeros((*shape, packed_size(REGRESSORS, len(LATERAL_TARGETS)))),
        yaw=np.zeros((*shape, packed_size(parameters.yaw_regressors, len(YAW_TARGETS)))),
        samples=0,
        windows=0,
    )


def group_of(block: IntArray, groups: int) -> IntArray:
    """Return the group of each block, as :func:`group` does."""
    block = np.asarray(block, np.int64)
    turn = (block // groups).astype(np.uint64) * GOLDEN >> HALF
    return np.asarray((block + (turn * np.uint64(groups) >> HALF).astype(np.int64)) % groups)


def tabulate(motion: Motion, parameters: BinParameters) -> BinTable:
    """Reduce the motion of a window to its bin table; blocks are assigned to the groups by :func:`group_of`."""
    return fill_cells(motion, parameters).table()


def fill_cells(motion: Motion, parameters: BinParameters) -> FilledCells:
    """Return what :func:`tabulate` does without the cells that have no sample."""
    edges, cell, u = parameters.edges, np.empty(len(motion), np.int64), np.empty(len(motion))
    place = (parameters.groups, float(edges[0]), parameters.width, len(edges) - 1)
    samples = assign(motion.displacement, motion.valid, motion.block, *place, cell, u)
    signals, difference = signals_of(motion), np.empty(len(motion))
    k = coefficients(motion, parameters.vehicle, parameters.difference_noise, parameters.wheelbase or 1.0)
    radius_difference(signals, k, cell, difference)
    inside = cell != OUTSIDE
    noise = fast_noise(difference, inside)
    filled = np.flatnonzero(np.bincount(cell[inside]))
    slot = np.zeros(parameters.groups * (len(edges) - 1), np.int64)
    slot[filled] = np.arange(len(filled))
    weight = np.zeros(len(filled))
    lateral, yaw = (
        np.zeros((len(filled), regressors + 1, regressors + targets))
        for regressors, targets in ((REGRESSORS, len(LATERAL_TARGETS)), (parameters.yaw_regressors, len(YAW_TARGETS)))
    )
    add_samples(signals, k, noise, cell, u, slot, weight, lateral, yaw)
    return FilledCells(
        parameter_key=parameters.key,
        edges=edges,
        groups=parameters.groups,
        cells=filled,
        weight=weight,
        lateral=pack(lateral),
        yaw=pack(yaw),
        samples=samples,
        windows=1,
    )


def fast_noise(difference: FloatArray, valid: BoolArray) -> float:
    """Return the variance, m2, of what varies faster in rL - rR than a wheelset can: vibration and sensor noise."""
    # the median of what a running mean over some hundredths of a second leaves, so that contact jumps do not count
    known = valid & np.isfinite(difference)
    if not known.any():
        return 0.0
    filled = np.where(known, difference, 0.0)
    fast = filled - uniform_filter1d(filled, MOTION.fast_mean_samples)
    return (float(np.median(np.abs(fast[known]))) * STD_PER_MAD) ** 2


def merge_all(tables: Iterable[BinTable | FilledCells], parameters: BinParameters) -> BinTable:
    """Merge in the order given, without weights."""
    merged = TableSum(init(parameters))
    for table in tables:
        merged.add(table)
    return merged.table()


def cells_of_window(
    window: Window,
    track: TrackAlignment | None,
    parameters: WindowParameters,
    correction: Correction | None = None,
    misplaced: Reason | None = None,
    *,
    mounted_reversed: bool = False,
    layout: TrackLayout | None = None,
) -> FilledCells | Reason:
    """Return the cells with samples of the bin table of ``window`` on ``track``, or why the window is refused."""
    moved = window_motion(
        window, track, parameters, correction, misplaced, mounted_reversed=mounted_reversed, layout=layout
    )
    if isinstance(moved, Reason):
        return moved
    filled = fill_cells(moved, bin_parameters(parameters))
    return filled if filled.samples else Reason(ReasonCode.OUTSIDE_BINS, "no sample is inside the bins")


def bin_parameters(parameters: WindowParameters) -> BinParameters:
    """Return the parameters of the bin tables that :func:`cells_of_window` makes: of band-limited motion."""
    vehicle_class = parameters.vehicle_class
    return BinParameters(
        source=parameters.signals.source,
        band_limited=True,
        vehicle=parameters.vehicle,
        wheelbase=None if vehicle_class.bogie is None else vehicle_class.bogie.wheelbase,
        arrangement=f"{vehicle_class.arrangement} {vehicle_class.bogie} {vehicle_class.sensors}",
        difference_noise=difference_noise(vehicle_class, parameters.signals.cutoff_wavelength),
    )


def weighted_sum(tables: Iterable[tuple[float, BinTable]]) -> BinTable:
    """Return the sum of tables times their weights, in the order given."""
    total: TableSum | None = None
    for weight, table in tables:
        total = total or TableSum(table.without_samples)
        total.add(table, weight)
    if total is None:
        raise ValueError("no table to sum")
    return total.table()
