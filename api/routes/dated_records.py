"""Dated records: where wheelsets run, their visits to the lathe, profiles as measured, and work on sensors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Depends, Response
from pydantic import Field

from api.access.gate import Scope, requires
from api.asking import (
    MOST_TEXT,
    AskedListDep,
    BodySource,
    ChangeDep,
    Code,
    Key,
    Kilometres,
    Note,
    RegistryChange,
    RegistryRequest,
    Serial,
)
from api.problems import described, invalid, pointer
from api.schemas import common
from api.schemas.common import Body, Derived, MountingPeriod, Page, Representation
from api.services import writer_slot
from api.times import Moment
from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.errors import ConflictError, ProfileError
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting, Reprofiling, SensorChange, SensorWork
from fleet_db.records import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.profiles.files import wheel_profile_of
from ingest.registry_entry.contents import RegistryContents


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

    removed: MountingPeriod = Field(description="The wheelset that was removed, and until when it ran there.")
    fitted: MountingPeriod = Field(description="The wheelset that was fitted, and since when.")


class NewReprofiling(RegistryChange):
    """A visit to the lathe, as it is reported."""

    reprofiled_at: Moment = Field(examples=["2026-03-01T06:00:00Z"])
    mileage_km: Kilometres = Field(description="Of the wheelset since new.", examples=[151200.0])
    note: str = Field(default="", max_length=2000, pattern=r"^[^\x00]*$", examples=["Depot North, lathe 2"])


class ProfileFile(Body):
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
    right: ProfileFile = Field(description="The wheelset's own right wheel.")
    std_mm: float = Field(
        default=0.1,
        gt=0.0,
        le=10.0,
        description="Std of the lateral displacement that follows from them at a rolling radius difference.",
        examples=[0.1],
    )


class NewSensorChange(RegistryChange):
    """The sensors of an axle were exchanged or calibrated."""

    axle: int = Field(ge=1, le=8, examples=[2])
    worked_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    work: Literal["swap", "calibration"] = Field(examples=["swap"])
    removed: Note = Field(default="", description="Serial number of what was taken off.", examples=["N-0815"])
    fitted: Note = Field(default="", description="Serial number of what is there since.", examples=["N-0816"])
    note: Note = Field(default="", examples=["cable chafed"])


class SensorChangeRecord(Derived, of=SensorChange):
    """The sensors of an axle were exchanged or calibrated."""


router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
_ACT = [Depends(requires(Scope.ACT)), Depends(writer_slot)]
_CHANGE: dict[str, Any] = {
    "status_code": 201,
    "dependencies": _ACT,
    "responses": described(404, 409, 412, 413, 415, 428),
}


@router.get("/{serial}/mountings", response_model=Page[common.MountingPeriod], responses=described(400, 404))
def list_mountings(asked: AskedListDep, serial: Serial) -> Response:
    """List where the wheelset ran, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        mountings = unit.registry.mountings(serial)
    return asked.numbered({"wheelset": serial}, mountings, lambda record: record.from_ns, common.MountingPeriod.made)


@router.post("/{serial}/mountings", response_model=common.MountingPeriod, **_CHANGE)
def mount_wheelset(asked: ChangeDep, serial: Serial, body: NewMounting) -> Response:
    """Record that the wheelset is mounted; windows of that time are assembled for it.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: unit.registry.vehicle(body.vehicle))
    readings = body.vehicle_odometer_km, body.wheelset_mileage_km
    mounted = Mounting(serial, body.vehicle, body.axle, body.mounted_from, None, *readings, body.reversed)
    source = BodySource({"from": "mounted_from", "wheelset": ""})

    def apply(unit: SqlUnitOfWork, decision: Decision) -> common.MountingPeriod:
        if any(mounting.from_ns == body.mounted_from for mounting in unit.registry.mountings(serial)):
            raise _conflict(serial, "is mounted from this time on file")
        change.enter(unit, decision, RegistryContents(mountings=(mounted,)), source)
        return common.MountingPeriod.made(mounted)

    return change.change(lambda unit: common.wheelset(unit.registry.wheelset(serial)), apply)


@router.post("/{serial}/dismount", response_model=common.MountingPeriod, **_CHANGE)
def dismount_wheelset(asked: ChangeDep, serial: Serial, body: Dismounting) -> Response:
    """Record that the wheelset was taken off; its open alerts are closed.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(asked, body)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> common.MountingPeriod:
        ended = _ended(unit, serial, body.dismounted_at)
        change.enter(unit, decision, RegistryContents(mountings=(ended,)), BodySource({"to": "dismounted_at"}))
        return common.MountingPeriod.made(ended)

    return change.change(lambda unit: common.wheelset(unit.registry.wheelset(serial)), apply)


@router.post("/{serial}/exchange", response_model=ExchangeRecord, **_CHANGE)
def exchange_wheelset(asked: ChangeDep, serial: Serial, body: Exchange) -> Response:
    """Record that the wheelset was taken off and another took its place, both or neither.

    `If-Match` carries the ETag of the wheelset that is taken off.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: unit.registry.wheelset(body.fitted))
    times = {"to": "exchanged_at", "from": "exchanged_at"}
    source = BodySource({**times, "wheelset_mileage_km": "fitted_mileage_km", "wheelset": "fitted"})

    def apply(unit: SqlUnitOfWork, decision: Decision) -> ExchangeRecord:
        ended = _ended(unit, serial, body.exchanged_at)
        change.visible(lambda seen: seen.registry.vehicle(ended.vehicle))
        readings = body.vehicle_odometer_km, body.fitted_mileage_km
        fitted = Mounting(body.fitted, ended.vehicle, ended.axle, body.exchanged_at, None, *readings, body.reversed)
        change.enter(unit, decision, RegistryContents(mountings=(ended, fitted)), source)
        return ExchangeRecord(removed=common.MountingPeriod.made(ended), fitted=common.MountingPeriod.made(fitted))

    return change.change(lambda unit: common.wheelset(unit.registry.wheelset(serial)), apply)


def _ended(unit: SqlUnitOfWork, serial: str, at_ns: int) -> Mounting:
    lasting = unit.registry.wheelset(serial).mounting
    if lasting is None:
        raise _conflict(serial, "is mounted nowhere")
    if at_ns <= lasting.from_ns:
        raise _conflict(serial, f"is on vehicle {lasting.vehicle!r} only since {utc_text(lasting.from_ns)}")
    return replace(lasting, to_ns=at_ns)


def _conflict(serial: str, why: str) -> ConflictError:
    return ConflictError(f"wheelset {serial!r} {why}", kind="wheelset", key=serial)


@router.get("/{serial}/reprofilings", response_model=Page[common.ReprofilingRecord], responses=described(400, 404))
def list_reprofilings(asked: AskedListDep, serial: Serial) -> Response:
    """List the wheelset's visits to the lathe, oldest first."""
    with asked.read() as unit:
        visits = unit.registry.wheelset(serial).reprofilings
    return asked.numbered({"wheelset": serial}, visits, lambda record: record.at_ns, common.ReprofilingRecord.made)


@router.post("/{serial}/reprofilings", response_model=common.ReprofilingRecord, **_CHANGE)
def add_reprofiling(asked: ChangeDep, serial: Serial, body: NewReprofiling) -> Response:
    """Record a visit to the lathe; later windows belong to a new baseline, and the next evaluation closes old alerts.

    `If-Match` carries the ETag of the wheelset. A visit that contradicts what is on file is refused with the records
    that it contradicts: one in the future, before the first mounting, or with a mileage that runs backwards.
    """
    change = RegistryRequest(asked, body)
    record = Reprofiling(serial, body.reprofiled_at, body.mileage_km, body.note)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> common.ReprofilingRecord:
        if any(reprofiling.at_ns == record.at_ns for reprofiling in unit.registry.wheelset(serial).reprofilings):
            reason = "a reprofiling of this wheelset was recorded at the same time; void it to enter another"
            raise ConflictError(reason, kind="wheelset", key=serial)
        change.enter(unit, decision, RegistryContents(reprofilings=(record,)), BodySource({"at": "reprofiled_at"}))
        return common.ReprofilingRecord.made(record)

    return change.change(lambda unit: common.wheelset(unit.registry.wheelset(serial)), apply)


@router.get(
    "/{serial}/measured-profiles", response_model=Page[common.MeasuredProfilesRecord], responses=described(400, 404)
)
def list_measured_profiles(asked: AskedListDep, serial: Serial) -> Response:
    """List when the profiles of the wheelset's wheels were measured, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        measured = unit.registry.measured_profiles(serial)
    return asked.numbered({"wheelset": serial}, measured, lambda record: record.at_ns, common.measured_profiles)


@router.post("/{serial}/measured-profiles", response_model=common.MeasuredProfilesRecord, **_CHANGE)
def add_measured_profiles(asked: ChangeDep, serial: Serial, body: NewMeasuredProfiles) -> Response:
    """Record the profiles of both wheels: the files of the gauge as text in JSON, both in one call.

    `If-Match` carries the ETag of the wheelset. Half a wheel, a rail, and what is no profile are refused.
    """
    change = RegistryRequest(asked, body)
    left, right = _wheel(body.left, "left"), _wheel(body.right, "right")
    record = MeasuredProfiles(serial, body.measured_at, body.mileage_km, left, right, 1e-3 * body.std_mm)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> common.MeasuredProfilesRecord:
        if any(measured.at_ns == record.at_ns for measured in unit.registry.measured_profiles(serial)):
            reason = "profiles of this wheelset were measured at the same time on file; void them to enter others"
            raise ConflictError(reason, kind="wheelset", key=serial)
        change.enter(unit, decision, RegistryContents(measured_profiles=(record,)), BodySource({"at": "measured_at"}))
        return common.measured_profiles(record)

    return change.change(lambda unit: common.wheelset(unit.registry.wheelset(serial)), apply)


def _wheel(file: ProfileFile, side: Literal["left", "right"]) -> Profile:
    try:
        return wheel_profile_of(file.text, Path(file.file_name))
    except ProfileError as error:
        raise invalid(pointer([side, "text"]), str(error), f"{side}: {error}") from error


vehicles_router = APIRouter(prefix="/v1/vehicles", tags=["vehicles"])


@vehicles_router.get("/{code}/sensor-changes", response_model=Page[SensorChangeRecord], responses=described(400, 404))
def list_sensor_changes(asked: AskedListDep, code: Code) -> Response:
    """List when sensors of the vehicle were exchanged or calibrated, oldest first."""
    with asked.read() as unit:
        unit.registry.vehicle(code)
        changes = unit.sensor_changes.list(code)
    return asked.numbered({"vehicle": code}, changes, lambda record: record.at_ns, SensorChangeRecord.made)


@vehicles_router.post("/{code}/sensor-changes", response_model=SensorChangeRecord, **_CHANGE)
def add_sensor_change(asked: ChangeDep, code: Code, body: NewSensorChange) -> Response:
    """Record that the sensors of an axle were exchanged or calibrated: alerts on the sensor before are closed.

    `If-Match` carries the ETag of the vehicle.
    """
    change = RegistryRequest(asked, body)
    record = SensorChange(code, body.axle, body.worked_at, SensorWork(body.work), body.removed, body.fitted, body.note)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> SensorChangeRecord:
        if unit.sensor_changes.stored(code, record.at_ns) is not None:
            reason = f"work on the sensors of vehicle {code!r} was recorded at the same time; give another time"
            raise ConflictError(reason, kind="vehicle", key=code)
        change.enter(unit, decision, RegistryContents(sensor_changes=(record,)), BodySource({"at": "worked_at"}))
        return SensorChangeRecord.made(record)

    return change.change(lambda unit: common.Vehicle.made(unit.registry.vehicle(code)), apply)
