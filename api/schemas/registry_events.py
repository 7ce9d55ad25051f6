"""What was decided on records of the registry, and the records before and after."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

from pydantic import Field

from api.schemas import registry, tracks, vehicle_classes
from api.schemas.common import Representation
from api.times import Timestamp, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import TreadwatchError
from estimation.values.registry import Mounting, Reprofiling, SensorChange, SensorWork, VehicleRecord
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.class_on_file import ClassOnFile, class_of_document
from fleet_db.packed_values import unpack_wheel_pair
from fleet_db.registry_events import RecordAction, RecordKind, RegistryEvent
from fleet_db.stores.sensor_changes import sensor_change_of

MM = 1000.0


class SensorChangeRecord(Representation):
    """The sensors of an axle were exchanged or calibrated."""

    vehicle: str = Field(examples=["V-101"])
    axle: int = Field(examples=[2])
    worked_at: Timestamp
    work: SensorWork
    removed: str = Field(description="Serial number of what was taken off.", examples=["N-0815"])
    fitted: str = Field(description="Serial number of what is there since.", examples=["N-0816"])
    note: str = Field(examples=["cable chafed"])


class WheelsetValues(Representation):
    """What a wheelset is, without its life."""

    serial: str = Field(examples=["WS-0001"])
    fleet: str = Field(examples=["demo"])
    wheel_profile: str = Field(examples=["P8"])
    nominal_radius_mm: float = Field(examples=[460.0])


Record = (
    registry.MountingPeriod
    | registry.ReprofilingRecord
    | registry.MeasuredProfilesRecord
    | WheelsetValues
    | registry.Vehicle
    | vehicle_classes.VehicleClassRepresentation
    | tracks.TrackSection
    | SensorChangeRecord
)


class RegistryDecision(Representation):
    """One decision on a record: entered, changed, voided or restored."""

    id: int = Field(description="In the order of the decisions.", examples=[17])
    kind: RecordKind
    key: str = Field(description="Serial or code.", examples=["WS-0001"])
    at: Timestamp | None = Field(description="Time of a dated record.")
    action: RecordAction
    by: str = Field(description="Who; empty where a registry file was loaded with recordings.", examples=["j.smith"])
    reason: str = Field(examples=["of another wheelset"])
    recorded_at: Timestamp | None = Field(description="Our time; null where it is not known.")
    before: Record | None = Field(description="The record before; null where it is new or was restored.")
    after: Record | None = Field(description="The record since; null where it was voided, or is not known.")


def sensor_change(record: SensorChange) -> SensorChangeRecord:
    """Return the representation of work on sensors."""
    return SensorChangeRecord(
        vehicle=record.vehicle,
        axle=record.axle,
        worked_at=to_rfc3339(record.at_ns),
        work=record.work,
        removed=record.removed,
        fitted=record.fitted,
        note=record.note,
    )


def decision(event: RegistryEvent) -> RegistryDecision:
    """Return the representation of a decision."""
    restored = event.action is RecordAction.RESTORED
    return RegistryDecision(
        id=event.id,
        kind=event.kind,
        key=event.subject,
        at=None if event.at_ns is None else to_rfc3339(event.at_ns),
        action=event.action,
        by=event.actor,
        reason=event.reason,
        recorded_at=None if event.recorded_ns is None else to_rfc3339(event.recorded_ns),
        before=None if restored else _record(event.kind, event.record),
        after=_record(event.kind, event.record if restored else event.after),
    )


def _record(kind: RecordKind, values: Mapping[str, Any] | None) -> Record | None:
    """Return a record as the history keeps it; None where that cannot be read any more."""
    if not values:
        return None
    try:
        return _represented(kind, dict(values))
    except (TreadwatchError, KeyError, TypeError, ValueError):
        return None


def _represented(kind: RecordKind, values: dict[str, Any]) -> Record:  # noqa: PLR0911 - one line a kind
    match kind:
        case RecordKind.MOUNTING:
            return registry.mounting(Mounting(**values))
        case RecordKind.REPROFILING:
            return registry.reprofiling(Reprofiling(**values))
        case RecordKind.MEASUREMENT:
            return _measurement(values)
        case RecordKind.WHEELSET:
            return WheelsetValues(
                serial=values["serial"],
                fleet=values["fleet"],
                wheel_profile=values["wheel_profile"],
                nominal_radius_mm=values["nominal_radius_m"] * MM,
            )
        case RecordKind.VEHICLE:
            return registry.vehicle(VehicleRecord(**(values | {"axle_offsets_m": tuple(values["axle_offsets_m"])})))
        case RecordKind.VEHICLE_CLASS:
            return vehicle_classes.vehicle_class(ClassOnFile(class_of_document(values)))
        case RecordKind.SECTION:
            return tracks.section(TrackSectionRecord(**values))
        case RecordKind.SENSOR_CHANGE:
            return sensor_change(sensor_change_of(values))


def _measurement(values: dict[str, Any]) -> registry.MeasuredProfilesRecord:
    left, right = unpack_wheel_pair(base64.b64decode(values["packed"]), where="history of the registry")
    measured = MeasuredProfiles(values["wheelset"], values["at_ns"], values["mileage_km"], left, right, values["std_m"])
    return registry.measured_profiles(measured)
