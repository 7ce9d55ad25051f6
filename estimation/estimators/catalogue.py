"""The estimators there are. A new one is a module beside the others and a line here."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimation.errors import ParameterError
from estimation.estimators.block_filters import ExtendedKalman, ParticleFilter
from estimation.estimators.hidden_displacement import HiddenDisplacement
from estimation.estimators.interface import REACH, CurveEstimate, Estimator, EstimatorParameters
from estimation.estimators.paper_algorithm import PaperAlgorithm
from estimation.estimators.series import KnownIrregularity, SeriesFit
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinTable
from estimation.values.units import MILLIMETRE
from estimation.values.windows import Motion


@dataclass(frozen=True, slots=True)
class LinearConicity(SeriesFit):
    """Least squares of one straight line: its conicity at every amplitude inside the data."""

    name: str = "linear"
    title: str = "linear effective conicity"

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the constant and the line."""
        return np.column_stack([np.ones(len(x)), x / MILLIMETRE])


@dataclass(frozen=True, slots=True)
class CubicFit(SeriesFit):
    """Least squares of a piecewise cubic with pieces of ``piece`` m, where there are data."""

    ridge = 1e-9
    piece: float = 1e-3  # m
    name: str = "cubic"
    title: str = "piecewise cubic least squares"

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the B-splines of the pieces."""
        pieces = int(np.ceil(2 * REACH / self.piece))
        return b_splines(x, first=-0.5 * pieces * self.piece, piece=self.piece, pieces=pieces)


def b_splines(x: FloatArray, first: float, piece: float, pieces: int) -> FloatArray:
    """Return the uniform cubic B-splines (n, pieces + 3) at ``x`` (n,); beyond the pieces the outermost continue."""
    position = (x - first) / piece
    cell = np.clip(np.floor(position), 0, pieces - 1).astype(np.int64)
    u = position - cell
    weights = np.column_stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3])
    values = np.zeros((len(x), pieces + 3))
    np.put_along_axis(values, cell[:, None] + np.arange(4), weights / 6.0, axis=1)
    return values


@dataclass(frozen=True, slots=True)
class BinnedState:
    """A bin table and the parameters that it was made with."""

    bins: BinParameters
    geometry: GeometryParameters
    table: BinTable


@dataclass(frozen=True, slots=True)
class BinnedGeometry:
    """``estimation.tables.bin_table`` and ``estimation.geometry``, as the jobs use them."""

    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    name: str = "bins"
    title: str = "locally linear bins"

    def init(self, parameters: EstimatorParameters) -> BinnedState:
        """Return the empty bin table."""
        settings = BinParameters(
            source=parameters.source, band_limited=parameters.band_limited, vehicle=parameters.vehicle
        )
        shape = replace(self.geometry, uncertainty=parameters.uncertainty, curve=parameters.curve)
        return BinnedState(settings, shape, bin_table.init(settings))

    def update(self, state: BinnedState, motion: Motion, weight: float = 1.0) -> BinnedState:
        """Return the state with the bin table of ``motion`` added, ``weight`` times."""
        return replace(
            state, table=bin_table.weighted_sum([(1.0, state.table), (weight, bin_table.tabulate(motion, state.bins))])
        )

    def result(self, state: BinnedState) -> CurveEstimate:
        """Return the curve at the bin centres, and conicity, NP and zero crossing as the geometry publishes them."""
        found = estimate_geometry(state.table, state.bins, state.geometry)
        difference = found.rolling_radius_difference
        return CurveEstimate(
            displacement=found.bin_centres,
            difference=difference.value,
            difference_std=difference.std,
            amplitude=found.amplitude,
            conicity=found.conicity,
            nonlinearity=found.nonlinearity,
            zero_crossing=found.zero_crossing,
            samples=state.table.samples,
            stretches=state.table.windows,
            status=found.status,
            reason=found.reason,
        )


SHIPPED = "bins"  # the estimator of the jobs as shipped: its sums over each window are what the bin tables store


def estimators() -> tuple[Estimator[Any], ...]:
    """Return all estimators, the shipped one first."""
    return (
        BinnedGeometry(),
        LinearConicity(),
        PaperAlgorithm(),
        CubicFit(),
        ExtendedKalman(),
        ParticleFilter(),
        KnownIrregularity(),
        HiddenDisplacement(),
    )


def estimator_named(name: str) -> Estimator[Any]:
    """Return the estimator called ``name``."""
    known = {item.name: item for item in estimators()}
    if name not in known:
        raise ParameterError(f"no estimator {name!r}; there are {', '.join(known)}", field="estimator")
    return known[name]
