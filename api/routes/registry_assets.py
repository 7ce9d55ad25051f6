"""Vehicles, wheelsets and vehicle classes entered and changed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, NoReturn

from fastapi import APIRouter, Depends, Response
from pydantic import Field

from api.access.caller import Scope, requires
from api.asking import NewDep, PutDep
from api.parameters import Code, Serial
from api.problems import ProblemError, ProblemItem, described
from api.registry_changes import (
    MOST_TEXT,
    TEXT,
    BodySource,
    Key,
    RegistryChange,
    RegistryRequest,
)
from api.routes import vehicles
from api.schemas import registry
from api.services import writer_slot
from estimation.errors import ConflictError, InputError, NotFoundError
from estimation.values.registry import (
    SPEED_IN_FILES,
    VehicleRecord,
    WheelsetRecord,
)
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.input_file import parse_toml
from ingest.registry_entry.contents import RegistryContents
from ingest.vehicle_class_file import parse_vehicle_class


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


router = APIRouter(prefix="/v1")
_ADMIN = [Depends(requires(Scope.ADMIN)), Depends(writer_slot)]
_ADMIN_OF_ALL = [Depends(requires(Scope.ADMIN, all_fleets=True)), Depends(writer_slot)]
_post = partial(router.post, status_code=201, responses=described(404, 409, 413, 415))
_put = partial(router.put, dependencies=_ADMIN, responses=described(404, 409, 412, 413, 415, 428))
_VEHICLE_FIELDS = {"max_speed_km_h": "max_speed_m_s"}


@_post("/vehicles", tags=["vehicles"], dependencies=_ADMIN, response_model=registry.Vehicle)
def add_vehicle(asked: NewDep, body: NewVehicle) -> Response:
    """Enter a vehicle; recordings that came under its name before are decoded."""
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: _fleet(unit, body.fleet))

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.Vehicle:
        _refuse_known(unit.registry.vehicle, "vehicle", body.code)
        return _entered_vehicle(change, unit, decision, _vehicle(body.code, body))

    return change.change(None, apply)


@_put("/vehicles/{code}", tags=["vehicles"], response_model=registry.Vehicle)
def change_vehicle(asked: PutDep, code: Code, body: VehicleChange) -> Response:
    """Change a vehicle; its windows are made or estimated again where they rest on what has changed.

    `If-Match` carries its ETag.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: _fleet(unit, body.fleet))

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.Vehicle:
        return _entered_vehicle(change, unit, decision, _vehicle(code, body))

    return change.change(lambda unit: registry.vehicle(unit.registry.vehicle(code)), apply, HTTPStatus.OK)


@_post("/wheelsets", tags=["wheelsets"], dependencies=_ADMIN, response_model=registry.Wheelset)
def add_wheelset(asked: NewDep, body: NewWheelset) -> Response:
    """Enter a wheelset, which is mounted nowhere yet."""
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: _fleet(unit, body.fleet))

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.Wheelset:
        _refuse_known(unit.registry.wheelset, "wheelset", body.serial)
        return _entered_wheelset(change, unit, decision, _wheelset(body.serial, body))

    return change.change(None, apply)


@_put("/wheelsets/{serial}", tags=["wheelsets"], response_model=registry.Wheelset)
def change_wheelset(asked: PutDep, serial: Serial, body: WheelsetChange) -> Response:
    """Change a wheelset; with another nominal radius its windows are estimated again.

    `If-Match` carries its ETag.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: _fleet(unit, body.fleet))

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.Wheelset:
        return _entered_wheelset(change, unit, decision, _wheelset(serial, body))

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply, HTTPStatus.OK)


@_post(
    "/vehicle-classes",
    tags=["vehicles"],
    dependencies=_ADMIN_OF_ALL,
    response_model=vehicles.VehicleClassRepresentation,
)
def add_vehicle_class(asked: NewDep, body: VehicleClassFile) -> Response:
    """Register a vehicle class, or a new version of it; its vehicles are estimated again where it differs.

    The content of the newest version again changes nothing.
    """
    change = RegistryRequest(asked, body)
    found = _class(body.text)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> vehicles.VehicleClassRepresentation:
        change.enter(unit, decision, RegistryContents(classes=(found,)), BodySource({"code": "text"}))
        stored = unit.registry.vehicle_class(found.code)
        assert stored is not None
        return vehicles.vehicle_class(stored)

    return change.change(None, apply)


def _entered_vehicle(
    change: RegistryRequest, unit: SqlUnitOfWork, decision: Decision, record: VehicleRecord
) -> registry.Vehicle:
    change.enter(unit, decision, RegistryContents(vehicles=(record,)), BodySource(_VEHICLE_FIELDS))
    return registry.vehicle(unit.registry.vehicle(record.code))


def _entered_wheelset(
    change: RegistryRequest, unit: SqlUnitOfWork, decision: Decision, record: WheelsetRecord
) -> registry.Wheelset:
    change.enter(unit, decision, RegistryContents(wheelsets=(record,)), BodySource())
    return registry.wheelset(unit.registry.wheelset(record.serial))


def _vehicle(code: str, body: VehicleChange) -> VehicleRecord:
    """Return the vehicle; its speed is one that a registry file can give, in km/h, to the last bit."""
    if len(body.axle_offsets_m) != body.axles:
        _wrong("axle_offsets_m", f"{len(body.axle_offsets_m)} offsets for {body.axles} axles")
    if len(set(body.axle_offsets_m)) < body.axles:
        _wrong("axle_offsets_m", "two axles are at one place")
    speed = SPEED_IN_FILES.read(SPEED_IN_FILES.write(body.max_speed_m_s))
    return VehicleRecord(code, body.fleet, body.vehicle_class, body.axles, speed, tuple(body.axle_offsets_m))


def _wheelset(serial: str, body: WheelsetChange) -> WheelsetRecord:
    return WheelsetRecord(serial, body.fleet, body.wheel_profile, 1e-3 * body.nominal_radius_mm, None)


def _class(text: str) -> VehicleClass:
    try:
        return parse_vehicle_class(parse_toml(text, Path("text")))
    except InputError as error:
        _wrong("text", str(error))


def _wrong(field: str, detail: str) -> NoReturn:
    item = ProblemItem(part="body", pointer=f"#/{field}", detail=detail)
    raise ProblemError(422, "invalid-request", f"{field}: {detail}", [item])


def _fleet(unit: SqlUnitOfWork, code: str) -> None:
    if all(one.code != code for one in unit.registry.fleets()):
        raise NotFoundError("fleet", code)


def _refuse_known(look_up: Callable[[str], object], kind: str, key: str) -> None:
    """Refuse to enter what is on file: it is changed under its ETag."""
    try:
        look_up(key)
    except NotFoundError:
        return
    raise ConflictError(f"{kind} {key!r} is on file, or was and is voided", kind=kind, key=key)
