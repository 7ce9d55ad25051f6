"""Wheelsets, where they ran, their visits to the lathe, and when their profiles were measured."""

from __future__ import annotations

from http import HTTPStatus

from fastapi import APIRouter, Depends, Request, Response

from api import cursors
from api.access.scopes import Scope, requires
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Limit,
    answer,
    answer_page,
    operation,
    require_match,
)
from api.idempotency import idempotent_post
from api.parameters import Serial
from api.problems import described
from api.schemas import registry
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import ConflictError
from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}", response_model=registry.Wheelset, responses=described(404))
def get_wheelset(request: Request, services: ServicesDep, serial: Serial, _held: IfNoneMatch = None) -> Response:
    """Return one wheelset, with links to its bin table, its trend and its alerts."""
    with services.storage.read() as unit:
        found = unit.registry.wheelset(serial)
    return answer(request, registry.wheelset(found))


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


@router.get("/{serial}/reprofilings", response_model=Page[registry.ReprofilingRecord], responses=described(400, 404))
def list_reprofilings(
    request: Request, services: ServicesDep, serial: Serial, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List the wheelset's visits to the lathe, oldest first."""
    filters = {"wheelset": serial}
    after = cursors.decode_number(operation(request), filters, cursor)

    def key(record: Reprofiling) -> int:
        return record.at_ns

    with services.storage.read() as unit:
        found = sorted(unit.registry.wheelset(serial).reprofilings, key=key)
    rows = [record for record in found if after is None or record.at_ns > after]
    return answer_page(request, filters, limit, rows[: limit + 1], key, registry.reprofiling)


@router.get(
    "/{serial}/measured-profiles",
    response_model=Page[registry.MeasuredProfilesRecord],
    responses=described(400, 404),
)
def list_measured_profiles(
    request: Request, services: ServicesDep, serial: Serial, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List when the profiles of the wheelset's wheels were measured, oldest first."""
    filters = {"wheelset": serial}
    after = cursors.decode_number(operation(request), filters, cursor)

    def key(record: MeasuredProfiles) -> int:
        return record.at_ns

    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.registry.measured_profiles(serial)
    rows = [record for record in found if after is None or record.at_ns > after]
    return answer_page(request, filters, limit, rows[: limit + 1], key, registry.measured_profiles)


def _added_alone(before: WheelsetRecord, after: WheelsetRecord) -> None:
    """Refuse where another visit to the lathe was recorded in between, or this one replaces one at the same time."""
    if len(after.reprofilings) != len(before.reprofilings) + 1:
        raise ConflictError("a reprofiling of this wheelset was recorded at the same time", kind="wheelset")


@router.post(
    "/{serial}/reprofilings",
    status_code=HTTPStatus.CREATED,
    dependencies=[Depends(requires(Scope.ACT))],
    response_model=registry.ReprofilingRecord,
    responses=described(404, 409, 412, 413, 415, 428),
)
def add_reprofiling(
    request: Request,
    services: ServicesDep,
    serial: Serial,
    body: registry.NewReprofiling,
    if_match: IfMatch = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Record a visit to the lathe; later windows belong to a new baseline, and the next evaluation closes old alerts.

    `If-Match` carries the ETag of the wheelset.
    """
    post = idempotent_post(request, idempotency_key, body)
    with services.storage.write() as unit:
        earlier = post.earlier(request, unit)
        if earlier is not None:
            return earlier
        before = unit.registry.wheelset(serial)
        require_match(if_match, registry.wheelset(before))
        record = Reprofiling(serial, body.reprofiled_at, body.mileage_km, body.note)
        unit.registry.add_reprofiling(record)
        _added_alone(before, unit.registry.wheelset(serial))
        added = registry.reprofiling(record)
        post.remember(unit, HTTPStatus.CREATED, added, services.clock.now_ns())
    return answer(request, added, status=HTTPStatus.CREATED)
