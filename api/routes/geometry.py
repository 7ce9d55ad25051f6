"""What is estimated of a wheelset: its bin table and its trend; and the windows behind them."""

from __future__ import annotations

from functools import partial
from typing import Any

from fastapi import APIRouter, Request, Response

from api import cursors
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IfNoneMatch,
    Limit,
    answer,
    answer_page,
    answer_payload,
    operation,
    table_payload,
)
from api.contract import CSV, Accepted
from api.parameters import AsOf, MeasuredFrom, MeasuredTo, Serial, not_in_the_future, not_purged, require_order
from api.problems import described
from api.schemas import adhesion, geometry, rails, trend, windows
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.errors import NotFoundError
from fleet_db.keeping.purge import purged_before
from fleet_db.keeping.retention import Kept
from fleet_db.storage import SqlUnitOfWork

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])
_TABLE: dict[int | str, dict[str, Any]] = {200: {"content": {CSV: {"schema": {"type": "string"}}}}}


@router.get("/{serial}/geometry", response_model=geometry.Geometry, responses={**described(404, 410), **_TABLE})
def get_geometry(
    request: Request,
    services: ServicesDep,
    accepted: Accepted,
    serial: Serial,
    as_of: AsOf = None,
    _held: IfNoneMatch = None,
) -> Response:
    """Return the wheelset's bin table and the conicity that follows; as `text/csv`, the bin table alone."""
    not_in_the_future(as_of, services.clock.now_ns())
    with services.storage.read() as unit:
        if as_of is None:
            key = ("geometry", serial, accepted, unit.geometries.version(serial))
            payload = services.cache.get_or_make(key, partial(_geometry, unit, serial, accepted))
        else:
            payload = _geometry(unit, serial, accepted, as_of)
    return answer_payload(request, payload, accepted)


def _geometry(unit: SqlUnitOfWork, serial: str, media_type: str, as_of_ns: int | None = None) -> bytes:
    _answerable(unit, serial, as_of_ns)
    found = unit.geometries.current(serial, as_of_ns)
    if found is None:
        unit.registry.wheelset(serial)
        raise NotFoundError("geometry yet of wheelset", serial)
    body = geometry.geometry(found)
    return table_payload(body, media_type, geometry.table(body))


@router.get("/{serial}/trend", response_model=trend.Trend, responses={**described(404, 410), **_TABLE})
def get_trend(
    request: Request,
    services: ServicesDep,
    accepted: Accepted,
    serial: Serial,
    as_of: AsOf = None,
    _held: IfNoneMatch = None,
) -> Response:
    """Return the wheelset's trend since its last reprofiling; as `text/csv`, its points alone."""
    not_in_the_future(as_of, services.clock.now_ns())
    with services.storage.read() as unit:
        if as_of is None:
            key = ("trend", serial, accepted, unit.trends.version(serial))
            payload = services.cache.get_or_make(key, partial(_trend, unit, serial, accepted))
        else:
            payload = _trend(unit, serial, accepted, as_of)
    return answer_payload(request, payload, accepted)


def _trend(unit: SqlUnitOfWork, serial: str, media_type: str, as_of_ns: int | None = None) -> bytes:
    _answerable(unit, serial, as_of_ns)
    found = unit.trends.latest(serial, as_of_ns)
    if found is None:
        unit.registry.wheelset(serial)
        raise NotFoundError("trend yet of wheelset", serial)
    current = unit.geometries.current(serial, as_of_ns)
    body = trend.trend(found, current)
    return table_payload(body, media_type, trend.table(body))


def _answerable(unit: SqlUnitOfWork, serial: str, as_of_ns: int | None) -> None:
    """Refuse a time of which not everything is kept; of the present everything is."""
    if as_of_ns is not None:
        unit.registry.wheelset(serial)
        not_purged(as_of_ns, purged_before(unit.connection, Kept.SUPERSEDED_ESTIMATES))


@router.get("/{serial}/rails", response_model=rails.WheelsetRails, responses=described(404))
def get_wheelset_rails(request: Request, services: ServicesDep, serial: Serial, _held: IfNoneMatch = None) -> Response:
    """Return the conicity of the wheels without the rails they ran on, beside that of the geometry."""
    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found, current = unit.rails.of_wheelset(serial), unit.geometries.current(serial)
    if found is None:
        raise NotFoundError("rails yet of wheelset", serial)
    return answer(request, rails.wheelset_rails(found, current))


@router.get("/{serial}/windows", response_model=Page[windows.Window], responses=described(400, 404))
def list_windows(
    request: Request,
    services: ServicesDep,
    serial: Serial,
    measured_from: MeasuredFrom = None,
    measured_to: MeasuredTo = None,
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the wheelset's windows that begin in `[from, to)`, oldest first, with their quality and state."""
    require_order(measured_from, measured_to)
    filters = {"wheelset": serial, "from": measured_from, "to": measured_to}
    after = cursors.decode_number(operation(request), filters, cursor)
    if after is None and measured_from is not None:
        after = measured_from - 1
    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.windows.page(serial, after, limit + 1)
    rows = [record for record in found if measured_to is None or record.start_ns < measured_to]
    return answer_page(request, filters, limit, rows, lambda record: record.start_ns, windows.window)


@router.get("/{serial}/creep-forces", response_model=Page[adhesion.WindowCreep], responses=described(400, 404))
def list_creep_forces(
    request: Request,
    services: ServicesDep,
    serial: Serial,
    measured_from: MeasuredFrom = None,
    measured_to: MeasuredTo = None,
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the creep forces of the wheelset's windows that begin in `[from, to)`, oldest first."""
    require_order(measured_from, measured_to)
    filters = {"wheelset": serial, "from": measured_from, "to": measured_to}
    after = cursors.decode_number(operation(request), filters, cursor)
    if after is None and measured_from is not None:
        after = measured_from - 1
    with services.storage.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.adhesion.of_wheelset(serial, after, limit + 1)
    rows = [one for one in found if measured_to is None or one.start_ns < measured_to]
    return answer_page(request, filters, limit, rows, lambda one: one.start_ns, adhesion.window_creep)
