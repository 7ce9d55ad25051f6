"""Settings of the estimation jobs, with shipped defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from estimation.geometry.estimate import GeometryParameters
from estimation.motion.gates import Gates, WindowParameters
from estimation.motion.parameters import SignalParameters
from estimation.tables.bin_table import BinParameters
from estimation.tables.window import bin_parameters
from estimation.values.json_value import JsonValue
from estimation.vehicle.equations_of_motion import VehicleParameters


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
    def windows(self) -> WindowParameters:
        """What turns windows into motion."""
        return WindowParameters(self.vehicle, self.signals, self.gates)

    @property
    def bins(self) -> BinParameters:
        """Bin tables of band-limited motion."""
        return bin_parameters(self.windows)

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return every setting, for the provenance of an estimate."""
        return asdict(self)
