"""Fleets, vehicles and their classes, wheelsets and what happens to them, and the history of the registry."""

from __future__ import annotations

from typing import Annotated

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.registry import SensorWork
from fleet_db.records import RecordAction, RecordKind
from fleet_db.tables.base import Base, Code, Json, Name, Nanoseconds, Packed, Real, Serial, one_of


class WheelsetRow(Base, table="wheelsets"):
    """One wheelset, wherever it is mounted."""

    __table_args__ = (CheckConstraint("nominal_radius_m > 0", name="radius_positive"),)

    serial: Mapped[str] = mapped_column(String(64), primary_key=True)
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"), index=True)
    wheel_profile: Mapped[Name]
    nominal_radius_m: Mapped[Real]


class ReprofilingRow(Base, table="reprofilings"):
    """One visit to the lathe."""

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    mileage_km: Mapped[Real]
    note: Mapped[Name]


FleetKey = Annotated[str, mapped_column(String(64), primary_key=True)]


class FleetRow(Base, table="fleets"):
    """One fleet."""

    code: Mapped[FleetKey]
    name: Mapped[Name]


class VehicleClassRow(Base, table="vehicle_classes"):
    """One version of a class; never changed. ``document`` is the whole value."""

    __table_args__ = (CheckConstraint("version > 0", name="version_counted"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    document: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]


class VehicleRow(Base, table="vehicles"):
    """One vehicle; ``axle_offsets_m`` is a JSON list of one distance an axle."""

    __table_args__ = (CheckConstraint("axles > 0", name="axles_positive"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    fleet: Mapped[str] = mapped_column(ForeignKey("fleets.code"), index=True)
    vehicle_class: Mapped[Name]
    axles: Mapped[int]
    max_speed_m_s: Mapped[Real]
    axle_offsets_m: Mapped[Json]


class MountingRow(Base, table="mountings"):
    """One mounting, ``[from_ns, to_ns)``; ``to_ns`` is null while it lasts.

    That neither a wheelset nor an axle is in two mountings at one time is checked by the store, under the lock of
    the registry: the range types that could express it as a constraint exist on PostgreSQL only.
    """

    __table_args__ = (
        CheckConstraint("to_ns IS NULL OR to_ns > from_ns", name="ends_after_start"),
        CheckConstraint("axle > 0", name="axle_positive"),
        UniqueConstraint("vehicle", "axle", "from_ns"),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    from_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    to_ns: Mapped[Nanoseconds | None]
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    axle: Mapped[int]
    vehicle_odometer_km: Mapped[Real]
    wheelset_mileage_km: Mapped[Real]
    reversed: Mapped[bool]


class SensorChangeRow(Base, table="sensor_changes"):
    """Work on the sensors of one axle at a time of the vehicle's clock."""

    __table_args__ = (CheckConstraint("axle > 0", name="axle_positive"), one_of("work", SensorWork))

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    axle: Mapped[int] = mapped_column(primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    work: Mapped[str] = mapped_column(String(16))
    removed: Mapped[Name]
    fitted: Mapped[Name]
    note: Mapped[Name]


class MeasuredProfilesRow(Base, table="measured_profiles"):
    """One measurement of both wheels of a wheelset. The profiles are in ``packed``."""

    __table_args__ = (CheckConstraint("std_m > 0", name="std_positive"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    at_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    mileage_km: Mapped[Real]
    std_m: Mapped[Real]
    packed: Mapped[Packed]


class RegistryEventRow(Base, table="registry_events", numbered=True):
    """One decision; never changed.

    ``record`` is what was there before, or what was restored; ``after`` what is there since.
    """

    __table_args__ = (
        one_of("kind", RecordKind),
        one_of("action", RecordAction),
        Index(None, "subject", "kind"),
    )

    id: Mapped[Serial]
    kind: Mapped[str] = mapped_column(String(16))
    subject: Mapped[Code]
    at_ns: Mapped[Nanoseconds | None]
    action: Mapped[str] = mapped_column(String(16))
    actor: Mapped[Name]
    reason: Mapped[Name]
    record: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds | None]
    after: Mapped[Json | None]
