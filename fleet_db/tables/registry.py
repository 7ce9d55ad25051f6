"""Fleets, vehicles and their classes, wheelsets and what happens to them, and the history of the registry."""

from typing import Annotated

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, UniqueConstraint

from estimation.values.registry import Mounting, Reprofiling, SensorChange, VehicleRecord, WheelsetRecord
from fleet_db.records import RegistryEvent
from fleet_db.tables.base import Base, Code, Json, Name, Nanoseconds, Packed, Real, Serial, column


class WheelsetRow(Base, table="wheelsets", of=WheelsetRecord, without=("mounting", "reprofilings")):
    """One wheelset, wherever it is mounted."""

    constraints = (CheckConstraint("nominal_radius_m > 0", name="radius_positive"),)

    serial: str = column(String(64), primary_key=True)
    fleet: str = column(ForeignKey("fleets.code"), index=True)


class ReprofilingRow(Base, table="reprofilings", of=Reprofiling):
    """One visit to the lathe."""

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)


FleetKey = Annotated[str, column(String(64), primary_key=True)]


class FleetRow(Base, table="fleets"):
    """One fleet."""

    code: FleetKey
    name: Name


class VehicleClassRow(Base, table="vehicle_classes"):
    """One version of a class; never changed. ``document`` is the whole value."""

    constraints = (CheckConstraint("version > 0", name="version_counted"),)

    code: str = column(String(64), primary_key=True)
    version: int = column(primary_key=True)
    document: Json
    recorded_ns: Nanoseconds


class VehicleRow(Base, table="vehicles", of=VehicleRecord):
    """One vehicle; ``axle_offsets_m`` is a JSON list of one distance an axle."""

    constraints = (CheckConstraint("axles > 0", name="axles_positive"),)

    code: str = column(String(64), primary_key=True)
    fleet: str = column(ForeignKey("fleets.code"), index=True)
    axles: int


class MountingRow(Base, table="mountings", of=Mounting):
    """One mounting, ``[from_ns, to_ns)``; ``to_ns`` is null while it lasts.

    That neither a wheelset nor an axle is in two mountings at one time is checked by the store, under the lock of
    the registry: the range types that could express it as a constraint exist on PostgreSQL only.
    """

    constraints = (
        CheckConstraint("to_ns IS NULL OR to_ns > from_ns", name="ends_after_start"),
        CheckConstraint("axle > 0", name="axle_positive"),
        UniqueConstraint("vehicle", "axle", "from_ns"),
    )

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    from_ns: Nanoseconds = column(primary_key=True)
    vehicle: str = column(ForeignKey("vehicles.code"))
    axle: int


class SensorChangeRow(Base, table="sensor_changes", of=SensorChange):
    """Work on the sensors of one axle at a time of the vehicle's clock."""

    constraints = (CheckConstraint("axle > 0", name="axle_positive"),)

    vehicle: str = column(ForeignKey("vehicles.code"), primary_key=True)
    axle: int = column(primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)


class MeasuredProfilesRow(Base, table="measured_profiles"):
    """One measurement of both wheels of a wheelset. The profiles are in ``packed``."""

    constraints = (CheckConstraint("std_m > 0", name="std_positive"),)

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)
    mileage_km: Real
    std_m: Real
    packed: Packed


class RegistryEventRow(Base, table="registry_events", numbered=True, of=RegistryEvent):
    """One decision; never changed.

    ``record`` is what was there before, or what was restored; ``after`` what is there since.
    """

    constraints = (Index(None, "subject", "kind"),)

    id: Serial
    subject: Code
