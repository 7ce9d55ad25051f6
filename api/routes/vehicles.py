"""Vehicles."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.asking import AskedDep, AskedListDep
from api.known import require_known
from api.parameters import Code, FleetFilter
from api.problems import described
from api.schemas import dampers, registry, suspension
from api.schemas.common import Page
from estimation.trend.suspension import SuspensionParameters, suspension_changes

router = APIRouter(prefix="/v1/vehicles", tags=["vehicles"])


@router.get("", response_model=Page[registry.Vehicle], responses=described(400, 404))
def list_vehicles(asked: AskedListDep, fleet: FleetFilter = None) -> Response:
    """List the vehicles, by code."""
    filters = {"fleet": fleet}
    after = asked.after_text(filters)
    with asked.read() as unit:
        rows = unit.registry.vehicles_page(fleet, after, asked.limit + 1)
        if not rows:
            require_known(unit, fleet=fleet)
    return asked.page(filters, rows, lambda record: record.code, registry.vehicle)


@router.get("/{code}", response_model=registry.Vehicle, responses=described(404))
def get_vehicle(asked: AskedDep, code: Code) -> Response:
    """Return one vehicle."""
    with asked.read() as unit:
        found = unit.registry.vehicle(code)
    return asked.answer(registry.vehicle(found))


@router.get("/{code}/suspension", response_model=suspension.Suspension, responses=described(404))
def get_suspension(asked: AskedDep, code: Code) -> Response:
    """Return what the passes of a vehicle show of its yaw stiffness, over time."""
    usual = SuspensionParameters()
    with asked.read() as unit:
        unit.registry.vehicle(code)
        findings = unit.suspensions.list(code)
        newest = unit.suspensions.newest(usual.recent + usual.most_past)
    change = suspension_changes(newest, usual).get(code)
    return asked.answer(suspension.suspension(code, findings, change))


@router.get("/{code}/dampers", response_model=dampers.Dampers, responses=described(404))
def get_dampers(asked: AskedDep, code: Code) -> Response:
    """Return the state of the lateral dampers of a vehicle, one for each running gear."""
    with asked.read() as unit:
        unit.registry.vehicle(code)
        found = unit.dampers.of_vehicle(code)
    return asked.answer(dampers.dampers(code, found))
