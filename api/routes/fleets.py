"""Fleets."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.asking import AskedDep, AskedListDep
from api.parameters import Code
from api.problems import described
from api.schemas import registry
from api.schemas.common import Page
from estimation.errors import NotFoundError

router = APIRouter(prefix="/v1/fleets", tags=["fleets"])


@router.get("", response_model=Page[registry.Fleet], responses=described(400))
def list_fleets(asked: AskedListDep) -> Response:
    """List the fleets, by code."""
    with asked.read() as unit:
        found = unit.registry.fleets()
    return asked.named(found, lambda record: record.code, registry.fleet)


@router.get("/{code}", response_model=registry.Fleet, responses=described(404))
def get_fleet(asked: AskedDep, code: Code) -> Response:
    """Return one fleet."""
    with asked.read() as unit:
        found = [record for record in unit.registry.fleets() if record.code == code]
    if not found:
        raise NotFoundError("fleet", code)
    return asked.answer(registry.fleet(found[0]))
