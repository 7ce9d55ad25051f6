"""Where wheelsets run: mounted, taken off, exchanged."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from fastapi import APIRouter, Depends, Response

from api.access.scopes import Scope, requires
from api.asking import AskedListDep, ChangeDep
from api.parameters import Serial
from api.problems import described
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry
from api.schemas.common import Page
from api.schemas.registry_changes import Dismounting, Exchange, ExchangeRecord, NewMounting
from api.services import writer_slot
from estimation.errors import ConflictError
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
_ACT = [Depends(requires(Scope.ACT)), Depends(writer_slot)]
_post = partial(router.post, status_code=201, dependencies=_ACT, responses=described(404, 409, 412, 413, 415, 428))


@router.get("/{serial}/mountings", response_model=Page[registry.MountingPeriod], responses=described(400, 404))
def list_mountings(asked: AskedListDep, serial: Serial) -> Response:
    """List where the wheelset ran, oldest first."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.registry.mountings(serial)
    return asked.numbered({"wheelset": serial}, found, lambda record: record.from_ns, registry.MountingPeriod.made)


@_post("/{serial}/mountings", response_model=registry.MountingPeriod)
def mount_wheelset(asked: ChangeDep, serial: Serial, body: NewMounting) -> Response:
    """Record that the wheelset is mounted; windows of that time are assembled for it.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: unit.registry.vehicle(body.vehicle))
    readings = body.vehicle_odometer_km, body.wheelset_mileage_km
    mounted = Mounting(serial, body.vehicle, body.axle, body.mounted_from, None, *readings, body.reversed)
    source = BodySource({"from": "mounted_from", "wheelset": ""})

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.MountingPeriod:
        if any(one.from_ns == body.mounted_from for one in unit.registry.mountings(serial)):
            raise _conflict(serial, "is mounted from this time on file")
        change.enter(unit, decision, RegistryContents(mountings=(mounted,)), source)
        return registry.MountingPeriod.made(mounted)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


@_post("/{serial}/dismount", response_model=registry.MountingPeriod)
def dismount_wheelset(asked: ChangeDep, serial: Serial, body: Dismounting) -> Response:
    """Record that the wheelset was taken off; its open alerts are closed.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(asked, body)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.MountingPeriod:
        ended = _ended(unit, serial, body.dismounted_at)
        change.enter(unit, decision, RegistryContents(mountings=(ended,)), BodySource({"to": "dismounted_at"}))
        return registry.MountingPeriod.made(ended)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


@_post("/{serial}/exchange", response_model=ExchangeRecord)
def exchange_wheelset(asked: ChangeDep, serial: Serial, body: Exchange) -> Response:
    """Record that the wheelset was taken off and another took its place, both or neither.

    `If-Match` carries the ETag of the wheelset that is taken off.
    """
    change = RegistryRequest(asked, body)
    change.visible(lambda unit: unit.registry.wheelset(body.fitted))
    at = {"to": "exchanged_at", "from": "exchanged_at"}
    source = BodySource({**at, "wheelset_mileage_km": "fitted_mileage_km", "wheelset": "fitted"})

    def apply(unit: SqlUnitOfWork, decision: Decision) -> ExchangeRecord:
        ended = _ended(unit, serial, body.exchanged_at)
        change.visible(lambda seen: seen.registry.vehicle(ended.vehicle))
        readings = body.vehicle_odometer_km, body.fitted_mileage_km
        fitted = Mounting(body.fitted, ended.vehicle, ended.axle, body.exchanged_at, None, *readings, body.reversed)
        change.enter(unit, decision, RegistryContents(mountings=(ended, fitted)), source)
        return ExchangeRecord(removed=registry.MountingPeriod.made(ended), fitted=registry.MountingPeriod.made(fitted))

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


def _ended(unit: SqlUnitOfWork, serial: str, at_ns: int) -> Mounting:
    """Return the mounting that lasts, as it ends at a time."""
    lasting = unit.registry.wheelset(serial).mounting
    if lasting is None:
        raise _conflict(serial, "is mounted nowhere")
    if at_ns <= lasting.from_ns:
        raise _conflict(serial, f"is on vehicle {lasting.vehicle!r} only since {utc_text(lasting.from_ns)}")
    return replace(lasting, to_ns=at_ns)


def _conflict(serial: str, why: str) -> ConflictError:
    return ConflictError(f"wheelset {serial!r} {why}", kind="wheelset", key=serial)
