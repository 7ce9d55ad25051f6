"""Bin tables: the piecewise, locally linear least squares of a wheelset, on mergeable statistics.

Samples are assigned to bins of lateral displacement y - d (Eq. 19-21). Inside a bin, with u = (y - d - centre)/width,
the lateral equation has regressors [x1, x1 u, x2, x2 u], the yaw equation [(l W/2) psi, c, c u, c u^2]: S, D and A
are constant or linear across the bin, R is quadratic, so that the variation of R inside the bin cannot pose as A.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.errors import ParameterError
from estimation.motion.parameters import WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.tables import least_squares
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Motion, Window
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.regressors import (
    LATERAL_TARGETS,
    REGRESSORS,
    SHARED_IN_BOGIE,
    YAW_TARGETS,
    coefficients,
    signals_of,
)
from estimation.vehicle.vehicle_class import difference_noise


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
KEYS = 256  # wheelsets whose keys are kept


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


@lru_cache(maxsize=KEYS)
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
        lateral=np.zeros((*shape, least_squares.packed_size(REGRESSORS, len(LATERAL_TARGETS)))),
        yaw=np.zeros((*shape, least_squares.packed_size(parameters.yaw_regressors, len(YAW_TARGETS)))),
        samples=0,
        windows=0,
    )


def group_of(block: IntArray, groups: int) -> IntArray:
    """Return the group of each block: in turn, and each round begins at another group.

    Were it in turn alone, a vehicle that passes at the same time every day would fill the same few groups for ever.
    """
    block = np.asarray(block, np.int64)
    turn = (block // groups).astype(np.uint64) * least_squares.GOLDEN >> least_squares.HALF
    return np.asarray((block + (turn * np.uint64(groups) >> least_squares.HALF).astype(np.int64)) % groups)


def tabulate(motion: Motion, parameters: BinParameters) -> BinTable:
    """Reduce the motion of a window to its bin table; blocks are assigned to the groups by :func:`group_of`."""
    return fill_cells(motion, parameters).table()


def fill_cells(motion: Motion, parameters: BinParameters) -> FilledCells:
    """Return what :func:`tabulate` does without the cells that have no sample."""
    edges, cell, u = parameters.edges, np.empty(len(motion), np.int64), np.empty(len(motion))
    place = (parameters.groups, float(edges[0]), parameters.width, len(edges) - 1)
    samples = least_squares.assign(motion.displacement, motion.valid, motion.block, *place, cell, u)
    signals, difference = signals_of(motion), np.empty(len(motion))
    k = coefficients(motion, parameters.vehicle, parameters.difference_noise, parameters.wheelbase or 1.0)
    least_squares.radius_difference(signals, k, cell, difference)
    inside = cell != least_squares.OUTSIDE
    noise = fast_noise(difference, inside)
    filled = np.flatnonzero(np.bincount(cell[inside]))
    slot = np.zeros(parameters.groups * (len(edges) - 1), np.int64)
    slot[filled] = np.arange(len(filled))
    weight = np.zeros(len(filled))
    lateral, yaw = (
        np.zeros((len(filled), regressors + 1, regressors + targets))
        for regressors, targets in ((REGRESSORS, len(LATERAL_TARGETS)), (parameters.yaw_regressors, len(YAW_TARGETS)))
    )
    least_squares.add_samples(signals, k, noise, cell, u, slot, weight, lateral, yaw)
    return FilledCells(
        parameter_key=parameters.key,
        edges=edges,
        groups=parameters.groups,
        cells=filled,
        weight=weight,
        lateral=_packed(lateral),
        yaw=_packed(yaw),
        samples=samples,
        windows=1,
    )


def _packed(sums: FloatArray) -> FloatArray:
    regressors = sums.shape[1] - 1
    packed = np.empty((len(sums), least_squares.packed_size(regressors, sums.shape[2] - regressors)))
    least_squares.pack(sums, packed)
    return packed


def fast_noise(difference: FloatArray, valid: BoolArray) -> float:
    """Return the variance, m2, of what varies faster in rL - rR than a wheelset can: vibration and sensor noise.

    The median of what a running mean over some hundredths of a second leaves, so that contact jumps do not count.
    """
    known = valid & np.isfinite(difference)
    if not known.any():
        return 0.0
    filled = np.where(known, difference, 0.0)
    fast = filled - uniform_filter1d(filled, FAST_SAMPLES)
    return (float(np.median(np.abs(fast[known]))) * MEDIAN_TO_STD) ** 2


FAST_SAMPLES = 17  # at 250 Hz: faster than some 10 Hz
MEDIAN_TO_STD = 1.4826  # of the absolute value of a normal variable


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
