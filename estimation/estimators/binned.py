"""The product's estimator: locally linear least squares in bins of y - d, on mergeable statistics."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.geometry import BinTable
from estimation.values.motion import Motion


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
        return replace(state, table=bin_table.merge(bin_table.tabulate(motion, state.bins), state.table, weight))

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
