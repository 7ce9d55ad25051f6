"""Fleets, their vehicles and the classes of these; what is known of suspension and dampers of a vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from fastapi import APIRouter, Response
from pydantic import Field

from api.asking import AskedDep, AskedListDep, Code, FleetFilter, Version
from api.problems import described
from api.schemas import common
from api.schemas.common import Derived, Links, Page, Representation, finite, segment
from api.services import require_known
from api.times import Timestamp, to_rfc3339
from estimation.trend.suspension import SuspensionParameters, suspension_changes
from estimation.values.opinions import GearDamper
from estimation.values.trend import SuspensionChange, SuspensionFinding
from estimation.vehicle.vehicle_class import (
    SHIPPED_VERSION,
    Arrangement,
    BogieParameters,
    ClassOnFile,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
)
from fleet_db.rows import present
from ingest.vehicle_class_schema import shipped_class, shipped_classes

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
    value: float = Field(description="Value, in `unit`.", examples=[2.5e6])
    std: float = Field(description="Standard deviation: how well the value is known.", examples=[125e3])
    unit: str = Field(description="Unit of the values beside it.", examples=["N m/rad"])


class Sensor(Representation):
    """One sensor of a node; null `limit` is none."""

    name: str = Field(examples=["lateral"])
    unit: str = Field(description="Of `limit`; of `noise_density` per root hertz.", examples=["m/s2"])
    noise_density: float = Field(description="Noise density, in `unit` per root hertz.", examples=[0.001])
    scale_std_1: float = Field(description="Relative std of its scale.", examples=[0.01])
    limit: float | None = Field(description="Range in which it measures; null is none.", examples=[50.0])


class Sensors(Representation):
    """The sensors of each node."""

    rate_hz: float = Field(description="Samples per second.", examples=[250.0])
    measures_gravity: bool = Field(description="A lateral accelerometer that rolls measures part of gravity.")
    channels: list[Sensor] = Field(description="The sensors, one by one.")


class VehicleClassRepresentation(Representation):
    """What all vehicles of one type have in common."""

    code: str = Field(examples=["coach"])
    name: str = Field(examples=["Passenger coach"])
    source: str = Field(description="Where the numbers come from.", examples=["Manchester benchmarks, vehicle 1"])
    arrangement: Arrangement = Field(description="How the axles are arranged: as single wheelsets or in bogies.")
    version: int | None = Field(description="As registered, from 1; null for a class of the package.", examples=[1])
    recorded_at: Timestamp | None = Field(description="When this version was registered.")
    digest: str = Field(description="Of the whole value; estimates name it.", examples=["0" * 64])
    wheelset: list[Parameter] = Field(description="One wheelset, its contact and its primary suspension.")
    bogie: list[Parameter] | None = Field(description="The frame, what it carries and the secondary suspension.")
    sensors: Sensors
    links: Links


def vehicle_class(record: ClassOnFile) -> VehicleClassRepresentation:
    """Return the representation of a version of a class."""
    of_class = record.vehicle_class
    path = f"/v1/vehicle-classes/{segment(of_class.code)}"
    version = None if record.version == SHIPPED_VERSION else record.version
    links = {"self": path}
    if version is not None:
        links["as_recorded"] = f"{path}?version={version}"
    return VehicleClassRepresentation(
        **{name: getattr(of_class, name) for name in ("code", "name", "source", "arrangement")},
        version=version,
        recorded_at=None if record.recorded_ns is None else to_rfc3339(record.recorded_ns),
        digest=record.digest,
        wheelset=_parameters(of_class, of_class.parameters),
        bogie=None if of_class.bogie is None else _parameters(of_class, of_class.bogie),
        sensors=_sensors(of_class.sensors),
        links=links,
    )


def _parameters(of_class: VehicleClass, values: VehicleParameters | BogieParameters) -> list[Parameter]:
    parameters = []
    for field in fields(values):
        value = float(getattr(values, field.name))
        std = of_class.std_of(field.name) * abs(value)
        unit = next(unit for end, unit in _UNITS.items() if field.name.endswith(end))
        parameters.append(Parameter(name=field.name, value=value, std=std, unit=unit))
    return parameters


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
            noise_density=channel.noise_density,
            scale_std_1=channel.scale_std,
            limit=finite(channel.limit),
        )
        for name, channel in layout.channels.items()
    ]
    return Sensors(rate_hz=layout.rate_hz, measures_gravity=layout.measures_gravity, channels=channels)


class DamperState(Derived, of=GearDamper, without=("vehicle", "windows")):
    """The lateral damper of a running gear: between frame and body of a bogie, or above a single wheelset."""


class Dampers(Representation):
    """All lateral dampers of a vehicle that were looked at, by axle."""

    vehicle: str = Field(examples=["V-0001"])
    dampers: list[DamperState] = Field(description="Empty before a window has been looked at.")
    links: Links


class SuspensionResult(
    Derived, of=SuspensionFinding, without=("vehicle", "ratio", "ratio_std"), also=("stiffness_ratio",)
):
    """Yaw stiffness over longitudinal creep coefficient of the vehicle, from its passes of one section."""


class SuspensionShift(
    Derived,
    of=SuspensionChange,
    without=("vehicle", "change", "std", "step_probability", "since_ns"),
    also=("estimate",),
):
    """By how much the ratio has changed against the vehicle's own past and the other vehicles."""


class Suspension(Representation):
    """All findings of a vehicle, oldest first, and the change; null while too little is known."""

    vehicle: str
    findings: list[SuspensionResult] = Field(description="What was found, oldest first.")
    change: SuspensionShift | None = Field(
        description="The change against the vehicle's own past; null while too little is known."
    )
    links: Links


fleets_router = APIRouter(prefix="/v1/fleets", tags=["fleets"])


@fleets_router.get("", response_model=Page[common.Fleet], responses=described(400))
def list_fleets(asked: AskedListDep) -> Response:
    """List the fleets, by code."""
    with asked.read() as unit:
        fleets = unit.registry.fleets()
    return asked.named(fleets, lambda record: record.code, common.Fleet.made)


@fleets_router.get("/{code}", response_model=common.Fleet, responses=described(404))
def get_fleet(asked: AskedDep, code: Code) -> Response:
    """Return one fleet."""
    with asked.read() as unit:
        fleet = next((record for record in unit.registry.fleets() if record.code == code), None)
    return asked.answer(common.Fleet.made(present(fleet, "fleet", code)))


router = APIRouter(prefix="/v1", tags=["vehicles"])


@router.get("/vehicles", response_model=Page[common.Vehicle], responses=described(400, 404))
def list_vehicles(asked: AskedListDep, fleet: FleetFilter = None) -> Response:
    """List the vehicles, by code."""
    filters = {"fleet": fleet}
    after = asked.after_text(filters)
    with asked.read() as unit:
        rows = unit.registry.vehicles_page(fleet, after, asked.limit + 1)
        if not rows:
            require_known(unit, fleet=fleet)
    return asked.page(filters, rows, lambda record: record.code, common.Vehicle.made)


@router.get("/vehicles/{code}", response_model=common.Vehicle, responses=described(404))
def get_vehicle(asked: AskedDep, code: Code) -> Response:
    """Return one vehicle."""
    return asked.one(lambda unit: common.Vehicle.made(unit.registry.vehicle(code)))


@router.get("/vehicles/{code}/suspension", response_model=Suspension, responses=described(404))
def get_suspension(asked: AskedDep, code: Code) -> Response:
    """Return what the passes of a vehicle show of its yaw stiffness, over time."""
    usual = SuspensionParameters()
    with asked.read() as unit:
        unit.registry.vehicle(code)
        findings = unit.suspensions.list(code)
        newest = unit.suspensions.newest(usual.recent + usual.most_past)
    change = suspension_changes(newest, usual).get(code)
    path = f"/v1/vehicles/{segment(code)}"
    return asked.answer(
        Suspension(
            vehicle=code,
            findings=[SuspensionResult.made(finding) for finding in findings],
            change=None if change is None else SuspensionShift.made(change),
            links={"self": f"{path}/suspension", "vehicle": path},
        )
    )


@router.get("/vehicles/{code}/dampers", response_model=Dampers, responses=described(404))
def get_dampers(asked: AskedDep, code: Code) -> Response:
    """Return the state of the lateral dampers of a vehicle, one for each running gear."""
    with asked.read() as unit:
        unit.registry.vehicle(code)
        dampers = [DamperState.made(damper) for damper in unit.dampers.of_vehicles([code])]
    path = f"/v1/vehicles/{segment(code)}"
    links = {"self": f"{path}/dampers", "vehicle": path}
    return asked.answer(Dampers(vehicle=code, dampers=dampers, links=links))


@router.get("/vehicle-classes", response_model=Page[VehicleClassRepresentation], responses=described(400))
def list_vehicle_classes(asked: AskedListDep) -> Response:
    """List the newest version of each vehicle class, by code; those of the package too, unless registered again."""
    with asked.read() as unit:
        registered = {record.vehicle_class.code: record for record in unit.registry.vehicle_classes()}
    classes = {code: ClassOnFile(shipped_class(code)) for code in shipped_classes()} | registered
    return asked.named(classes.values(), lambda record: record.vehicle_class.code, vehicle_class)


@router.get("/vehicle-classes/{code}", response_model=VehicleClassRepresentation, responses=described(404))
def get_vehicle_class(asked: AskedDep, code: Code, version: Version = None) -> Response:
    """Return one vehicle class: each parameter with its standard deviation."""
    what = code if version is None else f"{code} version {version}"
    return asked.one(
        lambda unit: vehicle_class(present(unit.registry.vehicle_class(code, version), "vehicle class", what))
    )
