"""Wheelsets."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from api.answers import IfNoneMatch, answer
from api.parameters import Serial
from api.problems import described
from api.schemas import registry
from api.services import ServicesDep

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}", response_model=registry.Wheelset, responses=described(404))
def get_wheelset(request: Request, services: ServicesDep, serial: Serial, _held: IfNoneMatch = None) -> Response:
    """Return one wheelset, with links to its bin table, its trend and its alerts."""
    with services.storage.read() as unit:
        found = unit.registry.wheelset(serial)
    return answer(request, registry.wheelset(found))
