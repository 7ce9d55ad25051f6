"""A geometry from the summed bin tables of windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.vehicle_classes import Assumed
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.values.fields import JsonValue
from estimation.values.geometry import BinTable, WheelsetGeometry


@dataclass(frozen=True, slots=True)
class EstimatedWith:
    """What a geometry is estimated with."""

    settings: EstimationSettings
    assumed: Assumed
    uncertainty: ParameterUncertainty

    @property
    def bins(self) -> BinParameters:
        """Of the bin tables."""
        return bin_parameters(self.assumed.windows)

    @property
    def geometry(self) -> GeometryParameters:
        """With what is uncertain of the class, the sensors and the track."""
        return replace(self.settings.geometry, uncertainty=self.uncertainty)

    def estimated(self, table: BinTable) -> WheelsetGeometry:
        """Return the geometry of windows."""
        return estimate_geometry(table, self.bins, self.geometry)

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it, for the provenance: the class by code, version and digest, the radius, the settings."""
        on_file = self.assumed.on_file
        of_class: dict[str, JsonValue] = {
            "code": on_file.vehicle_class.code,
            "version": on_file.version,
            "digest": on_file.digest,
        }
        return {
            **replace(self.settings, geometry=self.geometry).as_json(),
            "vehicle_class": of_class,
            "vehicle": asdict(self.assumed.windows.vehicle),
        }


def no_geometry(settings: EstimationSettings, parameter_key: str) -> WheelsetGeometry:
    """Return the geometry of no window."""
    bins = BinParameters(source=settings.signals.source, band_limited=True)
    empty = estimate_geometry(bin_table.init(bins), bins, settings.geometry)
    return replace(empty, parameter_key=parameter_key)
