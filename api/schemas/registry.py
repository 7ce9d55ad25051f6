"""Fleets, vehicles, wheelsets and their dated records."""

from __future__ import annotations

from urllib.parse import quote

from pydantic import Field

from api.schemas.common import Links, Representation
from api.times import Timestamp, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord


class Fleet(Representation):
    """Who operates what."""

    code: str = Field(examples=["demo"])
    name: str = Field(examples=["Demonstration fleet"])
    links: Links


class Vehicle(Representation):
    """A vehicle and what its alert rules depend on."""

    code: str = Field(examples=["V-101"])
    fleet: str = Field(examples=["demo"])
    vehicle_class: str = Field(
        description="Code of its class; while that is not on file the vehicle is not estimated.", examples=["coach"]
    )
    axles: int = Field(examples=[4])
    max_speed_m_s: float = Field(examples=[44.4])
    axle_offsets_m: list[float] = Field(examples=[[2.0, 4.5, 16.0, 18.5]])
    links: Links


class MountingPeriod(Representation):
    """Where a wheelset ran, `[mounted_from, mounted_to)`; null `mounted_to` means until now."""

    wheelset: str = Field(examples=["WS-0001"])
    vehicle: str = Field(examples=["V-101"])
    axle: int = Field(examples=[1])
    mounted_from: Timestamp
    mounted_to: Timestamp | None
    vehicle_odometer_km: float
    wheelset_mileage_km: float
    reversed: bool = Field(description="The left wheel runs on the right-hand side.")


class ReprofilingRecord(Representation):
    """A visit to the lathe; every later window belongs to a new baseline."""

    wheelset: str = Field(examples=["WS-0001"])
    reprofiled_at: Timestamp
    mileage_km: float = Field(examples=[151200.0])
    note: str


class MeasuredProfilesRecord(Representation):
    """A measurement of the profiles of both wheels; `left` is the wheelset's own left wheel."""

    wheelset: str = Field(examples=["WS-0001"])
    measured_at: Timestamp
    mileage_km: float = Field(examples=[151200.0])
    left: str = Field(description="Name of the profile.", examples=["WS-0001-left"])
    right: str = Field(description="Name of the profile.", examples=["WS-0001-right"])
    std_mm: float = Field(
        description="How well the lateral displacement at a rolling radius difference follows from them.",
        examples=[0.1],
    )
    links: Links


class Wheelset(Representation):
    """A wheelset by serial: where it runs now, and its visits to the lathe."""

    serial: str = Field(examples=["WS-0001"])
    fleet: str = Field(examples=["demo"])
    wheel_profile: str = Field(examples=["P8"])
    nominal_radius_mm: float = Field(examples=[460.0])
    mounting: MountingPeriod | None
    reprofilings: list[ReprofilingRecord]
    links: Links


def segment(text: str) -> str:
    """Return a key as one segment of a path."""
    return quote(text, safe="")


def fleet(record: FleetRecord) -> Fleet:
    """Return the representation of a fleet."""
    key = segment(record.code)
    links = {
        "self": f"/v1/fleets/{key}",
        "vehicles": f"/v1/vehicles?fleet={key}",
        "wheelsets": f"/v1/wheelsets?fleet={key}",
        "alerts": f"/v1/alerts?fleet={key}",
    }
    return Fleet(code=record.code, name=record.name, links=links)


def vehicle(record: VehicleRecord) -> Vehicle:
    """Return the representation of a vehicle."""
    key = segment(record.code)
    return Vehicle(
        code=record.code,
        fleet=record.fleet,
        vehicle_class=record.vehicle_class,
        axles=record.axles,
        max_speed_m_s=record.max_speed_m_s,
        axle_offsets_m=list(record.axle_offsets_m),
        links={
            "self": f"/v1/vehicles/{key}",
            "fleet": f"/v1/fleets/{segment(record.fleet)}",
            "vehicle_class": f"/v1/vehicle-classes/{segment(record.vehicle_class)}",
            "wheelsets": f"/v1/wheelsets?vehicle={key}",
            "suspension": f"/v1/vehicles/{key}/suspension",
        },
    )


def mounting(record: Mounting) -> MountingPeriod:
    """Return the representation of a mounting."""
    return MountingPeriod(
        wheelset=record.wheelset,
        vehicle=record.vehicle,
        axle=record.axle,
        mounted_from=to_rfc3339(record.from_ns),
        mounted_to=None if record.to_ns is None else to_rfc3339(record.to_ns),
        vehicle_odometer_km=record.vehicle_odometer_km,
        wheelset_mileage_km=record.wheelset_mileage_km,
        reversed=record.reversed,
    )


def reprofiling(record: Reprofiling) -> ReprofilingRecord:
    """Return the representation of a visit to the lathe."""
    return ReprofilingRecord(
        wheelset=record.wheelset,
        reprofiled_at=to_rfc3339(record.at_ns),
        mileage_km=record.mileage_km,
        note=record.note,
    )


def measured_profiles(record: MeasuredProfiles) -> MeasuredProfilesRecord:
    """Return the representation of a measurement of both wheels."""
    own = f"/v1/wheelsets/{segment(record.wheelset)}"
    return MeasuredProfilesRecord(
        wheelset=record.wheelset,
        measured_at=to_rfc3339(record.at_ns),
        mileage_km=record.mileage_km,
        left=record.left.name,
        right=record.right.name,
        std_mm=record.std * 1000.0,
        links={
            "wheelset": own,
            "comparison": f"{own}/measured-profiles/{segment(to_rfc3339(record.at_ns))}/comparison",
        },
    )


def wheelset(record: WheelsetRecord) -> Wheelset:
    """Return the representation of a wheelset, with paths to everything known of it."""
    own = f"/v1/wheelsets/{segment(record.serial)}"
    links = {name: f"{own}/{name}" for name in ("geometry", "trend", "contact", "windows", "mountings", "reprofilings")}
    links |= {"measured_profiles": f"{own}/measured-profiles", "intervals": f"{own}/intervals"}
    links["data_quality"] = f"{own}/data-quality"
    links |= {"state": f"{own}/state", "creep_forces": f"{own}/creep-forces"}
    links = {"self": own, "fleet": f"/v1/fleets/{segment(record.fleet)}", **links}
    links["alerts"] = f"/v1/alerts?wheelset={segment(record.serial)}"
    if record.mounting is not None:
        links["vehicle"] = f"/v1/vehicles/{segment(record.mounting.vehicle)}"
    return Wheelset(
        serial=record.serial,
        fleet=record.fleet,
        wheel_profile=record.wheel_profile,
        nominal_radius_mm=record.nominal_radius_m * 1000.0,
        mounting=None if record.mounting is None else mounting(record.mounting),
        reprofilings=[reprofiling(one) for one in record.reprofilings],
        links=links,
    )
