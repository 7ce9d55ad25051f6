"""Where wheelsets run: mounted, taken off, exchanged."""

from __future__ import annotations

from dataclasses import replace

from fastapi import APIRouter, Depends, Request, Response

from api import cursors
from api.access.caller import CallerDep
from api.access.scopes import Scope, requires
from api.answers import DEFAULT_LIMIT, Cursor, IdempotencyKey, IfMatch, Limit, answer_page, operation
from api.parameters import Serial
from api.problems import described
from api.registry_changes import BodySource, RegistryRequest
from api.schemas import registry
from api.schemas.common import Page
from api.schemas.registry_changes import Dismounting, Exchange, ExchangeRecord, NewMounting
from api.services import ServicesDep, writer_slot
from estimation.errors import ConflictError
from estimation.values.quantities import utc_text
from estimation.values.registry import Mounting
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.registry_entry.contents import RegistryContents

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
_ACT = [Depends(requires(Scope.ACT)), Depends(writer_slot)]
_REFUSALS = described(404, 409, 412, 413, 415, 428)


@router.get("/{serial}/mountings", response_model=Page[registry.MountingPeriod], responses=described(400, 404))
def list_mountings(
    request: Request, services: ServicesDep, serial: Serial, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List where the wheelset ran, oldest first."""
    filters = {"wheelset": serial}
    after = cursors.decode_number(operation(request), filters, cursor)

    def key(record: Mounting) -> int:
        return record.from_ns

    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found = sorted(unit.registry.mountings(serial), key=key)
    rows = [record for record in found if after is None or record.from_ns > after]
    return answer_page(request, filters, limit, rows[: limit + 1], key, registry.mounting)


@router.post(
    "/{serial}/mountings",
    status_code=201,
    dependencies=_ACT,
    response_model=registry.MountingPeriod,
    responses=_REFUSALS,
)
def mount_wheelset(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    serial: Serial,
    body: NewMounting,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Record that the wheelset is mounted; windows of that time are assembled for it.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(request, services, caller, body, if_match, idempotency_key)
    change.visible(lambda unit: unit.registry.vehicle(body.vehicle))
    mounted = Mounting(
        serial,
        body.vehicle,
        body.axle,
        body.mounted_from,
        None,
        body.vehicle_odometer_km,
        body.wheelset_mileage_km,
        body.reversed,
    )
    source = BodySource({"from": "mounted_from", "wheelset": ""})

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.MountingPeriod:
        if any(one.from_ns == body.mounted_from for one in unit.registry.mountings(serial)):
            raise _conflict(serial, "is mounted from this time on file")
        change.enter(unit, decision, RegistryContents(mountings=(mounted,)), source)
        return registry.mounting(mounted)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


@router.post(
    "/{serial}/dismount",
    status_code=201,
    dependencies=_ACT,
    response_model=registry.MountingPeriod,
    responses=_REFUSALS,
)
def dismount_wheelset(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    serial: Serial,
    body: Dismounting,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Record that the wheelset was taken off; its open alerts are closed.

    `If-Match` carries the ETag of the wheelset.
    """
    change = RegistryRequest(request, services, caller, body, if_match, idempotency_key)

    def apply(unit: SqlUnitOfWork, decision: Decision) -> registry.MountingPeriod:
        ended = _ended(unit, serial, body.dismounted_at)
        change.enter(unit, decision, RegistryContents(mountings=(ended,)), BodySource({"to": "dismounted_at"}))
        return registry.mounting(ended)

    return change.change(lambda unit: registry.wheelset(unit.registry.wheelset(serial)), apply)


@router.post(
    "/{serial}/exchange",
    status_code=201,
    dependencies=_ACT,
    response_model=ExchangeRecord,
    responses=_REFUSALS,
)
def exchange_wheelset(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    serial: Serial,
    body: Exchange,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Record that the wheelset was taken off and another took its place, both or neither.

    `If-Match` carries the ETag of the wheelset that is taken off.
    """
    change = RegistryRequest(request, services, caller, body, if_match, idempotency_key)
    change.visible(lambda unit: unit.registry.wheelset(body.fitted))
    source = BodySource(
        {
            "to": "exchanged_at",
            "from": "exchanged_at",
            "wheelset_mileage_km": "fitted_mileage_km",
            "wheelset": "fitted",
        }
    )

    def apply(unit: SqlUnitOfWork, decision: Decision) -> ExchangeRecord:
        ended = _ended(unit, serial, body.exchanged_at)
        change.visible(lambda seen: seen.registry.vehicle(ended.vehicle))
        fitted = Mounting(
            body.fitted,
            ended.vehicle,
            ended.axle,
            body.exchanged_at,
            None,
            body.vehicle_odometer_km,
            body.fitted_mileage_km,
            body.reversed,
        )
        change.enter(unit, decision, RegistryContents(mountings=(ended, fitted)), source)
        return ExchangeRecord(removed=registry.mounting(ended), fitted=registry.mounting(fitted))

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
