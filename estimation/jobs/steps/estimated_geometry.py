"""A geometry from the summed bin tables of windows, or from their motion where another estimator is set."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace

from estimation.estimators.catalogue import SHIPPED, estimator_named
from estimation.estimators.interface import EstimatorParameters
from estimation.estimators.wheelset_geometry import PublishedBins, geometry_from_motion
from estimation.geometry.estimate import contradictions, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.vehicle_classes import Assumed
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.values.geometry import BinTable, WheelsetGeometry
from estimation.values.json_value import JsonValue
from estimation.values.motion import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters

WeightedMotions = Iterable[tuple[float, Motion]]


@dataclass(frozen=True, slots=True)
class EstimatedWith:
    """What a geometry is estimated with."""

    settings: EstimationSettings
    assumed: Assumed
    uncertainty: ParameterUncertainty

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it, for the provenance: the class by code, version and digest, the radius, the settings."""
        on_file, geometry = self.assumed.on_file, replace(self.settings.geometry, uncertainty=self.uncertainty)
        of_class: dict[str, JsonValue] = {
            "code": on_file.vehicle_class.code,
            "version": on_file.version,
            "digest": on_file.digest,
        }
        return {
            **replace(self.settings, geometry=geometry).as_json(),
            "vehicle_class": of_class,
            "vehicle": asdict(self.assumed.windows.vehicle),
        }


def estimated_geometry(
    table: BinTable, used: EstimatedWith, motions: Callable[[], WeightedMotions]
) -> WheelsetGeometry:
    """Return the geometry of windows.

    Parameters
    ----------
    table
        Their summed bin tables.
    used
        What it is estimated with.
    motions
        Returns weight and motion of the windows, oldest first, where the estimator needs them.
    """
    bins, settings = bin_parameters(used.assumed.windows), used.settings
    if settings.estimator == SHIPPED:
        return estimate_geometry(table, bins, replace(settings.geometry, uncertainty=used.uncertainty))
    published = PublishedBins(bins.edges, settings.geometry_key(bins.key))
    other = _from_motions(motions(), settings, used.assumed.windows.vehicle, used.uncertainty, published)
    # whatever the estimator, the data follow the class or not
    for found in contradictions(table, bins, used.uncertainty):
        other = other.against(found)
    return other


def no_geometry(settings: EstimationSettings, parameter_key: str) -> WheelsetGeometry:
    """Return the geometry of no window.

    Parameters
    ----------
    settings
        Of the estimation.
    parameter_key
        Key of the geometry that it follows.
    """
    bins = BinParameters(source=settings.signals.source, band_limited=True)
    table_key = parameter_key.partition(" ")[0]
    if settings.estimator != SHIPPED:
        published = PublishedBins(bins.edges, settings.geometry_key(table_key))
        return _from_motions((), settings, bins.vehicle, settings.geometry.uncertainty, published)
    empty = estimate_geometry(bin_table.init(bins), bins, settings.geometry)
    return replace(empty, parameter_key=table_key)


def _from_motions(
    motions: WeightedMotions,
    settings: EstimationSettings,
    vehicle: VehicleParameters,
    uncertainty: ParameterUncertainty,
    published: PublishedBins,
) -> WheelsetGeometry:
    """Return the geometry that the estimator of the settings finds in motions, each with its weight."""
    parameters = EstimatorParameters(
        vehicle, uncertainty, settings.geometry.curve, settings.signals.source, band_limited=True
    )
    return geometry_from_motion(estimator_named(settings.estimator), parameters, motions, published)
