"""Fleets, vehicles, wheelsets and their dated records."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Derived, Links, segment
from api.times import to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord


class Fleet(
    Derived,
    of=FleetRecord,
    links={
        "self": "/v1/fleets/{code}",
        "vehicles": "/v1/vehicles?fleet={code}",
        "wheelsets": "/v1/wheelsets?fleet={code}",
        "alerts": "/v1/alerts?fleet={code}",
    },
):
    """Who operates what."""


class Vehicle(
    Derived,
    of=VehicleRecord,
    links={
        "self": "/v1/vehicles/{code}",
        "fleet": "/v1/fleets/{fleet}",
        "vehicle_class": "/v1/vehicle-classes/{vehicle_class}",
        "wheelsets": "/v1/wheelsets?vehicle={code}",
        "suspension": "/v1/vehicles/{code}/suspension",
    },
):
    """A vehicle and what its alert rules depend on."""


class MountingPeriod(Derived, of=Mounting):
    """Where a wheelset ran, `[mounted_from, mounted_to)`; null `mounted_to` means until now."""


class ReprofilingRecord(Derived, of=Reprofiling):
    """A visit to the lathe; every later window belongs to a new baseline."""


class MeasuredProfilesRecord(
    Derived, of=MeasuredProfiles, columns="wheelset measured_at mileage_km left right std_mm links"
):
    """A measurement of the profiles of both wheels; `left` is the wheelset's own left wheel."""

    left: str = Field(description="Name of the profile.", examples=["WS-0001-left"])
    right: str = Field(description="Name of the profile.", examples=["WS-0001-right"])
    links: Links


class Wheelset(Derived, of=WheelsetRecord):
    """A wheelset by serial: where it runs now, and its visits to the lathe."""

    serial: str
    links: Links


def measured_profiles(record: MeasuredProfiles) -> MeasuredProfilesRecord:
    """Return the representation of a measurement of both wheels."""
    own = f"/v1/wheelsets/{segment(record.wheelset)}"
    return MeasuredProfilesRecord.made(
        record,
        left=record.left.name,
        right=record.right.name,
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
    return Wheelset.made(record, links=links)
