"""Vehicles, wheelsets and vehicle classes entered and changed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, Field

from api.access.gate import Scope, requires
from api.asking import (
    MOST_TEXT,
    TEXT,
    AskedChange,
    BodySource,
    Code,
    Key,
    NewDep,
    PutDep,
    RegistryChange,
    RegistryRequest,
    Serial,
)
from api.problems import ProblemError, described, invalid
from api.routes import vehicles
from api.schemas import common
from api.services import require_known, writer_slot
from estimation.errors import ConflictError, InputError, NotFoundError
from estimation.values.registry import SPEED_IN_FILES, VehicleRecord, WheelsetRecord
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.records import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.input_file import parse_toml
from ingest.registry_entry.contents import RegistryContents
from ingest.vehicle_class_schema import parse_vehicle_class


class VehicleChange(RegistryChange):
    """A vehicle as it is."""

    fleet: Key = Field(examples=["demo"])
    vehicle_class: Key = Field(description="Code of its class.", examples=["coach"])
    axles: int = Field(ge=1, le=8, examples=[4])
    max_speed_km_h: float = Field(ge=1.0, le=600.0, examples=[160.0])
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


@_post("/vehicles", tags=["vehicles"], dependencies=_ADMIN, response_model=common.Vehicle)
def add_vehicle(asked: NewDep, body: NewVehicle) -> Response:
    """Enter a vehicle; recordings that came under its name before are decoded."""
    return _entered(asked, body, lambda: _vehicle(body.code, body), _shown_vehicle(body.code), ("vehicle", body.code))


@_put("/vehicles/{code}", tags=["vehicles"], response_model=common.Vehicle)
def change_vehicle(asked: PutDep, code: Code, body: VehicleChange) -> Response:
    """Change a vehicle; its windows are made or estimated again where they rest on what has changed.

    `If-Match` carries its ETag.
    """
    return _entered(asked, body, lambda: _vehicle(code, body), _shown_vehicle(code))


@_post("/wheelsets", tags=["wheelsets"], dependencies=_ADMIN, response_model=common.Wheelset)
def add_wheelset(asked: NewDep, body: NewWheelset) -> Response:
    """Enter a wheelset, which is mounted nowhere yet."""
    serial = body.serial
    return _entered(asked, body, lambda: _wheelset(serial, body), _shown_wheelset(serial), ("wheelset", serial))


@_put("/wheelsets/{serial}", tags=["wheelsets"], response_model=common.Wheelset)
def change_wheelset(asked: PutDep, serial: Serial, body: WheelsetChange) -> Response:
    """Change a wheelset; with another nominal radius its windows are estimated again.

    `If-Match` carries its ETag.
    """
    return _entered(asked, body, lambda: _wheelset(serial, body), _shown_wheelset(serial))


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
    vehicle_class = _class(body.text)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> vehicles.VehicleClassRepresentation:
        change.enter(unit, decision, RegistryContents(classes=(vehicle_class,)), BodySource({"code": "text"}))
        stored = unit.registry.vehicle_class(vehicle_class.code)
        assert stored is not None
        return vehicles.vehicle_class(stored)

    return change.change(None, apply)


Show = Callable[[SqlUnitOfWork], BaseModel]


def _entered(
    asked: AskedChange,
    body: VehicleChange | WheelsetChange,
    contents: Callable[[], RegistryContents],
    show: Show,
    new: tuple[str, str] | None = None,
) -> Response:
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: require_known(unit, fleet=body.fleet))

    def apply(unit: SqlUnitOfWork, decision: Decision) -> BaseModel:
        if new is not None:
            _refuse_known(lambda: show(unit), *new)
        change.enter(unit, decision, contents(), BodySource())
        return show(unit)

    return change.change(show, apply, HTTPStatus.OK) if new is None else change.change(None, apply)


def _shown_vehicle(code: str) -> Show:
    return lambda unit: common.Vehicle.made(unit.registry.vehicle(code))


def _shown_wheelset(serial: str) -> Show:
    return lambda unit: common.wheelset(unit.registry.wheelset(serial))


def _vehicle(code: str, body: VehicleChange) -> RegistryContents:
    if len(body.axle_offsets_m) != body.axles:
        raise _wrong("axle_offsets_m", f"{len(body.axle_offsets_m)} offsets for {body.axles} axles")
    if len(set(body.axle_offsets_m)) < body.axles:
        raise _wrong("axle_offsets_m", "two axles are at one place")
    speed = SPEED_IN_FILES.read(body.max_speed_km_h)
    offsets = tuple(body.axle_offsets_m)
    return RegistryContents(vehicles=(VehicleRecord(code, body.fleet, body.vehicle_class, body.axles, speed, offsets),))


def _wheelset(serial: str, body: WheelsetChange) -> RegistryContents:
    record = WheelsetRecord(serial, body.fleet, body.wheel_profile, 1e-3 * body.nominal_radius_mm, None)
    return RegistryContents(wheelsets=(record,))


def _class(text: str) -> VehicleClass:
    try:
        return parse_vehicle_class(parse_toml(text, Path("text")))
    except InputError as error:
        raise _wrong("text", str(error)) from None


def _refuse_known(look_up: Callable[[], object], kind: str, key: str) -> None:
    """Refuse to enter what is on file: it is changed under its ETag."""
    try:
        look_up()
    except NotFoundError:
        return
    raise ConflictError(f"{kind} {key!r} is on file, or was and is voided", kind=kind, key=key)


def _wrong(field: str, detail: str) -> ProblemError:
    return invalid(f"#/{field}", detail, f"{field}: {detail}")
