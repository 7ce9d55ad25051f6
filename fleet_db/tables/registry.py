"""Fleets, vehicles and their classes, wheelsets and what happens to them, and the history of the registry."""

from typing import Annotated

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, UniqueConstraint

from estimation.values.registry import SensorWork
from fleet_db.records import RecordAction, RecordKind
from fleet_db.tables.base import Base, Code, Json, Name, Nanoseconds, Packed, Real, Serial, column, one_of


class WheelsetRow(Base, table="wheelsets"):
    """One wheelset, wherever it is mounted."""

    constraints = (CheckConstraint("nominal_radius_m > 0", name="radius_positive"),)

    serial: str = column(String(64), primary_key=True)
    fleet: str = column(ForeignKey("fleets.code"), index=True)
    wheel_profile: Name
    nominal_radius_m: Real


class ReprofilingRow(Base, table="reprofilings"):
    """One visit to the lathe."""

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)
    mileage_km: Real
    note: Name


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


class VehicleRow(Base, table="vehicles"):
    """One vehicle; ``axle_offsets_m`` is a JSON list of one distance an axle."""

    constraints = (CheckConstraint("axles > 0", name="axles_positive"),)

    code: str = column(String(64), primary_key=True)
    fleet: str = column(ForeignKey("fleets.code"), index=True)
    vehicle_class: Name
    axles: int
    max_speed_m_s: Real
    axle_offsets_m: Json


class MountingRow(Base, table="mountings"):
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
    to_ns: Nanoseconds | None
    vehicle: str = column(ForeignKey("vehicles.code"))
    axle: int
    vehicle_odometer_km: Real
    wheelset_mileage_km: Real
    reversed: bool


class SensorChangeRow(Base, table="sensor_changes"):
    """Work on the sensors of one axle at a time of the vehicle's clock."""

    constraints = (CheckConstraint("axle > 0", name="axle_positive"), one_of("work", SensorWork))

    vehicle: str = column(ForeignKey("vehicles.code"), primary_key=True)
    axle: int = column(primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)
    work: str = column(String(16))
    removed: Name
    fitted: Name
    note: Name


class MeasuredProfilesRow(Base, table="measured_profiles"):
    """One measurement of both wheels of a wheelset. The profiles are in ``packed``."""

    constraints = (CheckConstraint("std_m > 0", name="std_positive"),)

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Nanoseconds = column(primary_key=True)
    mileage_km: Real
    std_m: Real
    packed: Packed


class RegistryEventRow(Base, table="registry_events", numbered=True):
    """One decision; never changed.

    ``record`` is what was there before, or what was restored; ``after`` what is there since.
    """

    constraints = (
        one_of("kind", RecordKind),
        one_of("action", RecordAction),
        Index(None, "subject", "kind"),
    )

    id: Serial
    kind: str = column(String(16))
    subject: Code
    at_ns: Nanoseconds | None
    action: str = column(String(16))
    actor: Name
    reason: Name
    record: Json
    recorded_ns: Nanoseconds | None
    after: Json | None
