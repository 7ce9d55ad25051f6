"""Vehicle classes: every parameter with its standard deviation and unit, the sensors, and which version it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from pydantic import Field

from api.schemas.common import Links, Representation, finite
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import (
    SHIPPED_VERSION,
    Arrangement,
    BogieParameters,
    ClassOnFile,
    SensorLayout,
    VehicleClass,
)

_UNITS: Mapping[str, str] = {
    "longitudinal_creep_coefficient": "N",
    "lateral_creep_coefficient": "N",
    "lateral_spin_creep_coefficient": "N m",
    "spin_creep_coefficient": "N m2",
    "load": "N",
    "yaw_stiffness": "N m/rad",
    "yaw_damping": "N m s/rad",
    "lateral_stiffness": "N/m",
    "lateral_damping": "N s/m",
    "mass": "kg",
    "inertia": "kg m2",
    "half_contact_distance": "m",
    "nominal_radius": "m",
    "wheelbase": "m",
}
_RATE, _ANGULAR, _LINEAR = "rad/s", "rad/s2", "m/s2"


class Parameter(Representation):
    """A parameter of the class; `std` is what is not known of it."""

    name: str = Field(examples=["yaw_stiffness"])
    value: float = Field(examples=[2.5e6])
    std: float = Field(examples=[125e3])
    unit: str = Field(examples=["N m/rad"])


class Sensor(Representation):
    """One sensor of a node; null `limit` is none."""

    name: str = Field(examples=["lateral"])
    unit: str = Field(description="Of `limit`; of `noise_density` per root hertz.", examples=["m/s2"])
    noise_density: float = Field(examples=[0.001])
    scale_std_1: float = Field(description="Relative std of its scale.", examples=[0.01])
    limit: float | None = Field(examples=[50.0])


class Sensors(Representation):
    """The sensors of each node."""

    rate_hz: float = Field(examples=[250.0])
    measures_gravity: bool = Field(description="A lateral accelerometer that rolls measures part of gravity.")
    channels: list[Sensor]


class VehicleClassRepresentation(Representation):
    """What all vehicles of one type have in common."""

    code: str = Field(examples=["coach"])
    name: str = Field(examples=["Passenger coach"])
    source: str = Field(description="Where the numbers come from.", examples=["Manchester benchmarks, vehicle 1"])
    arrangement: Arrangement
    version: int | None = Field(description="As registered, from 1; null for a class of the package.", examples=[1])
    recorded_at: Timestamp | None = Field(description="When this version was registered.")
    digest: str = Field(description="Of the whole value; estimates name it.", examples=["0" * 64])
    wheelset: list[Parameter] = Field(description="One wheelset, its contact and its primary suspension.")
    bogie: list[Parameter] | None = Field(description="The frame, what it carries and the secondary suspension.")
    sensors: Sensors
    links: Links


def vehicle_class(record: ClassOnFile) -> VehicleClassRepresentation:
    """Return the representation of a version of a class."""
    found = record.vehicle_class
    own = f"/v1/vehicle-classes/{segment(found.code)}"
    version = None if record.version == SHIPPED_VERSION else record.version
    links = {"self": own}
    if version is not None:
        links["as_recorded"] = f"{own}?version={version}"
    return VehicleClassRepresentation(
        code=found.code,
        name=found.name,
        source=found.source,
        arrangement=found.arrangement,
        version=version,
        recorded_at=None if record.recorded_ns is None else to_rfc3339(record.recorded_ns),
        digest=record.digest,
        wheelset=_parameters(found, found.parameters),
        bogie=None if found.bogie is None else _parameters(found, found.bogie),
        sensors=_sensors(found.sensors),
        links=links,
    )


def _parameters(of_class: VehicleClass, values: VehicleParameters | BogieParameters) -> list[Parameter]:
    found = []
    for item in fields(values):
        value = float(getattr(values, item.name))
        std = of_class.std_of(item.name) * abs(value)
        found.append(Parameter(name=item.name, value=value, std=std, unit=_unit(item.name)))
    return found


def _unit(name: str) -> str:
    """Return the SI unit of a parameter by the name of its field."""
    return next(unit for end, unit in _UNITS.items() if name.endswith(end))


def _sensors(layout: SensorLayout) -> Sensors:
    units = {
        "lateral": _LINEAR,
        "yaw": _RATE if layout.yaw_is_gyroscope else _ANGULAR,
        "roll": _RATE if layout.roll_is_gyroscope else _ANGULAR,
        "mass_lateral": _LINEAR,
    }
    channels = [
        Sensor(
            name=name,
            unit=units[name],
            noise_density=one.noise_density,
            scale_std_1=one.scale_std,
            limit=finite(one.limit),
        )
        for name, one in layout.channels.items()
    ]
    return Sensors(rate_hz=layout.rate_hz, measures_gravity=layout.measures_gravity, channels=channels)
