"""Records of the registry as they are entered, changed, voided and restored."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from api.parameters import CODE
from api.schemas import registry, tracks, vehicle_classes
from api.schemas.common import Representation, Request
from api.schemas.derived import Derived
from api.schemas.registry import MountingPeriod
from api.times import Moment, Timestamp, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import TreadwatchError
from estimation.values.registry import Mounting, Reprofiling, SensorChange, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.vehicle_class import ClassOnFile, class_of_document
from fleet_db.packed_values import unpack_wheel_pair
from fleet_db.registry_events import RecordAction, RecordKind, RegistryEvent
from fleet_db.stores.sensor_changes import sensor_change_of
from ingest.input_file import MEBIBYTE

TEXT = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
MOST_KM = 1e8
MOST_TEXT = MEBIBYTE  # of one file; a request has at most as much

Confirmable = Literal["odometer_backwards", "odometer_jump", "unknown_profile", "unusual_gauge", "unusual_radius"]
Key = Annotated[str, Field(pattern=CODE)]
Note = Annotated[str, Field(max_length=2000, pattern=TEXT)]
Kilometres = Annotated[float, Field(ge=0.0, le=MOST_KM)]


class RegistryChange(Request):
    """What every change of the registry may say."""

    why: Note = Field(default="", description="Kept with the record in its history.", examples=["work order 4711"])
    by: Key | None = Field(
        default=None, description="Who; read only where access control is off.", examples=["j.smith"]
    )
    confirm: list[Confirmable] = Field(
        default=[], description="Doubts of a refusal that are unfounded: it is so all the same.", examples=[[]]
    )


class NewMounting(RegistryChange):
    """A wheelset is mounted."""

    vehicle: Key = Field(examples=["V-101"])
    axle: int = Field(ge=1, le=8, examples=[2])
    mounted_from: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    vehicle_odometer_km: Kilometres = Field(description="Of the vehicle then.", examples=[812300.0])
    wheelset_mileage_km: Kilometres = Field(description="Of the wheelset since new, then.", examples=[151200.0])
    reversed: bool = Field(default=False, description="The left wheel runs on the right-hand side.")


class Dismounting(RegistryChange):
    """A wheelset is taken off its vehicle."""

    dismounted_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])


class Exchange(RegistryChange):
    """A wheelset is taken off and another takes its place, in one step."""

    exchanged_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    fitted: Key = Field(description="Serial of the wheelset that takes the place.", examples=["WS-0002"])
    vehicle_odometer_km: Kilometres = Field(description="Of the vehicle then.", examples=[812300.0])
    fitted_mileage_km: Kilometres = Field(description="Of the fitted wheelset since new.", examples=[0.0])
    reversed: bool = Field(default=False, description="The left wheel of the fitted one runs on the right-hand side.")


class ExchangeRecord(Representation):
    """The mounting that has ended, and the one that has begun."""

    removed: MountingPeriod
    fitted: MountingPeriod


class NewReprofiling(RegistryChange):
    """A visit to the lathe, as it is reported."""

    reprofiled_at: Moment = Field(examples=["2026-03-01T06:00:00Z"])
    mileage_km: Kilometres = Field(description="Of the wheelset since new.", examples=[151200.0])
    note: str = Field(default="", max_length=2000, pattern=r"^[^\x00]*$", examples=["Depot North, lathe 2"])


class ProfileFile(Request):
    """A file of a profile gauge, as text."""

    file_name: str = Field(
        min_length=1,
        max_length=255,
        pattern=r"^[^\x00-\x1f\x7f/\\]+$",
        description="Its suffix decides the format: MiniProf `.whl`, `.mpt`, SIMPACK `.prw`; others are two columns.",
        examples=["WS-0001-left.whl"],
    )
    text: str = Field(
        max_length=MOST_TEXT, description="Content of the file.", examples=["ColumnDef=X,Y\n\n-60.0 20.0"]
    )


class NewMeasuredProfiles(RegistryChange):
    """The profiles of both wheels, as a gauge measured them."""

    measured_at: Moment = Field(examples=["2026-03-01T06:00:00Z"])
    mileage_km: Kilometres = Field(description="Of the wheelset since new.", examples=[151200.0])
    left: ProfileFile = Field(description="Of the wheelset's own left wheel, also where it runs reversed.")
    right: ProfileFile
    std_mm: float = Field(
        default=0.1,
        gt=0.0,
        le=10.0,
        description="Std of the lateral displacement that follows from them at a rolling radius difference.",
        examples=[0.1],
    )


class VehicleChange(RegistryChange):
    """A vehicle as it is."""

    fleet: Key = Field(examples=["demo"])
    vehicle_class: Key = Field(description="Code of its class.", examples=["coach"])
    axles: int = Field(ge=1, le=8, examples=[4])
    max_speed_m_s: float = Field(ge=0.25, le=170.0, examples=[44.4])
    axle_offsets_m: list[Annotated[float, Field(ge=-1000.0, le=1000.0)]] = Field(
        min_length=1,
        max_length=8,
        description="Distance of each axle behind the position reference.",
        examples=[[2.0, 4.5, 16.0, 18.5]],
    )


class NewVehicle(VehicleChange):
    """A vehicle that is new."""

    code: Key = Field(description="As recordings are named.", examples=["V-101"])


class WheelsetChange(RegistryChange):
    """A wheelset as it is."""

    fleet: Key = Field(examples=["demo"])
    wheel_profile: Annotated[str, Field(min_length=1, max_length=200, pattern=TEXT)] = Field(
        description="Its design profile.", examples=["P8"]
    )
    nominal_radius_mm: float = Field(ge=100.0, le=1000.0, description="Not the diameter.", examples=[460.0])


class NewWheelset(WheelsetChange):
    """A wheelset that is new."""

    serial: Key = Field(examples=["WS-0001"])


class VehicleClassFile(RegistryChange):
    """A vehicle class, as a class file describes it."""

    text: str = Field(
        max_length=MOST_TEXT,
        description="Content of a vehicle class file (TOML): `treadwatch vehicle show coach` prints one to copy from.",
        examples=['format = "treadwatch-vehicle-class-1"'],
    )


class NewSensorChange(RegistryChange):
    """The sensors of an axle were exchanged or calibrated."""

    axle: int = Field(ge=1, le=8, examples=[2])
    worked_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    work: Literal["swap", "calibration"] = Field(examples=["swap"])
    removed: Note = Field(default="", description="Serial number of what was taken off.", examples=["N-0815"])
    fitted: Note = Field(default="", description="Serial number of what is there since.", examples=["N-0816"])
    note: Note = Field(default="", examples=["cable chafed"])


RecordKindName = Literal[
    "mounting", "reprofiling", "measurement", "wheelset", "section", "vehicle", "vehicle_class", "sensor_change"
]


class RecordDecision(Request):
    """Which record is voided or restored, and why."""

    kind: RecordKindName = Field(description="What kind of record.", examples=["reprofiling"])
    key: Key = Field(description="Serial of the wheelset; code of the vehicle, class or section.", examples=["WS-0001"])
    at: Moment | None = Field(
        default=None,
        description="Time of a mounting (`mounted_from`), reprofiling, measurement or sensor change.",
        examples=["2026-03-01T06:00:00Z"],
    )
    reason: str = Field(
        min_length=1, max_length=2000, pattern=TEXT, description="Kept for ever.", examples=["of another wheelset"]
    )
    by: Key | None = Field(
        default=None, description="Who; read only where access control is off.", examples=["j.smith"]
    )


class SensorChangeRecord(Derived, of=SensorChange):
    """The sensors of an axle were exchanged or calibrated."""


class WheelsetValues(Derived, of=WheelsetRecord, without=("mounting", "reprofilings")):
    """What a wheelset is, without its life."""


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
            return registry.MountingPeriod.made(Mounting(**values))
        case RecordKind.REPROFILING:
            return registry.ReprofilingRecord.made(Reprofiling(**values))
        case RecordKind.MEASUREMENT:
            return _measurement(values)
        case RecordKind.WHEELSET:
            names = ("serial", "fleet", "wheel_profile", "nominal_radius_m")
            return WheelsetValues.made(WheelsetRecord(**{name: values[name] for name in names}, mounting=None))
        case RecordKind.VEHICLE:
            return registry.vehicle(VehicleRecord(**(values | {"axle_offsets_m": tuple(values["axle_offsets_m"])})))
        case RecordKind.VEHICLE_CLASS:
            return vehicle_classes.vehicle_class(ClassOnFile(class_of_document(values)))
        case RecordKind.SECTION:
            return tracks.section(TrackSectionRecord(**values))
        case RecordKind.SENSOR_CHANGE:
            return SensorChangeRecord.made(sensor_change_of(values))


def _measurement(values: dict[str, Any]) -> registry.MeasuredProfilesRecord:
    left, right = unpack_wheel_pair(base64.b64decode(values["packed"]), where="history of the registry")
    measured = MeasuredProfiles(values["wheelset"], values["at_ns"], values["mileage_km"], left, right, values["std_m"])
    return registry.measured_profiles(measured)
