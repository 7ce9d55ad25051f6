"""Wheelsets."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.asking import AskedDep
from api.parameters import Serial
from api.problems import described
from api.schemas import registry

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}", response_model=registry.Wheelset, responses=described(404))
def get_wheelset(asked: AskedDep, serial: Serial) -> Response:
    """Return one wheelset, with links to its bin table, its trend and its alerts."""
    with asked.read() as unit:
        found = unit.registry.wheelset(serial)
    return asked.answer(registry.wheelset(found))
