"""Everything an estimation job can be told, with shipped defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from estimation.alerts import JsonValue
from estimation.bins import BinParameters
from estimation.geometry import GeometryParameters
from estimation.signals import SignalParameters
from estimation.vehicle import VehicleParameters


@dataclass(frozen=True, slots=True)
class Gates:
    """When a window may be estimated at all."""

    least_coverage: float = 0.25
    most_clipped: float = 0.1  # clipped samples are left out; more than this, and the rest is not believed
    least_position_quality: float = 0.1


@dataclass(frozen=True, slots=True)
class EstimationSettings:
    """Settings of the jobs that estimate windows and geometries."""

    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    signals: SignalParameters = field(default_factory=SignalParameters)
    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    gates: Gates = field(default_factory=Gates)
    interval_km: float = 1_000.0  # a geometry for the trend per this distance
    half_life_km: float = 2_000.0  # forgetting of the current geometry
    batch: int = 64  # windows committed together

    @property
    def bins(self) -> BinParameters:
        """Bin tables of band-limited motion."""
        return BinParameters(source=self.signals.source, band_limited=True, vehicle=self.vehicle)

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return every setting, for the provenance of an estimate."""
        return asdict(self)
