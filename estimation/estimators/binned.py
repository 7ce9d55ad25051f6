"""The product's estimator: locally linear least squares in bins of y - d, on mergeable statistics."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from estimation import bins, geometry
from estimation.bins import BinParameters
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.geometry import GeometryParameters
from estimation.motion import Motion
from estimation.types import BinTable


@dataclass(frozen=True, slots=True)
class BinnedState:
    """A bin table and what it was made with."""

    bins: BinParameters
    geometry: GeometryParameters
    table: BinTable


@dataclass(frozen=True, slots=True)
class BinnedGeometry:
    """``estimation.bins`` and ``estimation.geometry``, as the jobs use them."""

    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    name: str = "bins"
    title: str = "locally linear bins"

    def init(self, parameters: EstimatorParameters) -> BinnedState:
        """Return the state that has seen nothing."""
        settings = BinParameters(
            source=parameters.source, band_limited=parameters.band_limited, vehicle=parameters.vehicle
        )
        shape = replace(self.geometry, uncertainty=parameters.uncertainty, curve=parameters.curve)
        return BinnedState(settings, shape, bins.init(settings))

    def update(self, state: BinnedState, motion: Motion) -> BinnedState:
        """Return the state that has seen ``motion`` as well."""
        return replace(state, table=bins.merge(state.table, bins.tabulate(motion, state.bins)))

    def merge(self, first: BinnedState, second: BinnedState) -> BinnedState:
        """Return the state that has seen what both have seen; ValueError where their parameters differ."""
        return replace(first, table=bins.merge(first.table, second.table))

    def result(self, state: BinnedState) -> CurveEstimate:
        """Return what is published of the curve."""
        found = geometry.estimate(state.table, state.bins, state.geometry)
        difference = found.rolling_radius_difference
        return CurveEstimate(
            displacement=0.5 * (found.bin_edges[:-1] + found.bin_edges[1:]),
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
