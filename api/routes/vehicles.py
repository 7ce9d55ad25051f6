"""Vehicles."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from api import cursors
from api.answers import DEFAULT_LIMIT, Cursor, IfNoneMatch, Limit, answer, answer_page, operation
from api.known import require_known
from api.parameters import Code, FleetFilter
from api.problems import described
from api.schemas import dampers, registry, suspension
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.trend.suspension import SuspensionParameters, suspension_changes

router = APIRouter(prefix="/v1/vehicles", tags=["vehicles"])


@router.get("", response_model=Page[registry.Vehicle], responses=described(400, 404))
def list_vehicles(
    request: Request,
    services: ServicesDep,
    fleet: FleetFilter = None,
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the vehicles, by code."""
    filters = {"fleet": fleet}
    after = cursors.decode_text(operation(request), filters, cursor)
    with services.storage.read() as unit:
        rows = unit.registry.vehicles_page(fleet, after, limit + 1)
        if not rows:
            require_known(unit, fleet=fleet)
    return answer_page(request, filters, limit, rows, lambda record: record.code, registry.vehicle)


@router.get("/{code}", response_model=registry.Vehicle, responses=described(404))
def get_vehicle(request: Request, services: ServicesDep, code: Code, _held: IfNoneMatch = None) -> Response:
    """Return one vehicle."""
    with services.storage.read() as unit:
        found = unit.registry.vehicle(code)
    return answer(request, registry.vehicle(found))


@router.get("/{code}/suspension", response_model=suspension.Suspension, responses=described(404))
def get_suspension(request: Request, services: ServicesDep, code: Code, _held: IfNoneMatch = None) -> Response:
    """Return what the passes of a vehicle show of its yaw stiffness, over time."""
    usual = SuspensionParameters()
    with services.storage.read() as unit:
        unit.registry.vehicle(code)
        findings = unit.suspensions.list(code)
        newest = unit.suspensions.newest(usual.recent + usual.most_past)
    change = suspension_changes(newest, usual).get(code)
    return answer(request, suspension.suspension(code, findings, change))


@router.get("/{code}/dampers", response_model=dampers.Dampers, responses=described(404))
def get_dampers(request: Request, services: ServicesDep, code: Code, _held: IfNoneMatch = None) -> Response:
    """Return the state of the lateral dampers of a vehicle, one for each running gear."""
    with services.storage.read() as unit:
        unit.registry.vehicle(code)
        found = unit.dampers.of_vehicle(code)
    return answer(request, dampers.dampers(code, found))
