"""Fleets."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from api import cursors
from api.answers import DEFAULT_LIMIT, Cursor, IfNoneMatch, Limit, answer, answer_page, operation
from api.parameters import Code
from api.problems import described
from api.schemas import registry
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.errors import NotFoundError

router = APIRouter(prefix="/v1/fleets", tags=["fleets"])


@router.get("", response_model=Page[registry.Fleet], responses=described(400))
def list_fleets(
    request: Request, services: ServicesDep, cursor: Cursor = None, limit: Limit = DEFAULT_LIMIT
) -> Response:
    """List the fleets, by code."""
    after = cursors.decode_text(operation(request), {}, cursor)
    with services.storage.read() as unit:
        found = sorted(unit.registry.fleets(), key=lambda record: record.code)
    rows = [record for record in found if after is None or record.code > after]
    return answer_page(request, {}, limit, rows[: limit + 1], lambda record: record.code, registry.fleet)


@router.get("/{code}", response_model=registry.Fleet, responses=described(404))
def get_fleet(request: Request, services: ServicesDep, code: Code, _held: IfNoneMatch = None) -> Response:
    """Return one fleet."""
    with services.storage.read() as unit:
        found = [record for record in unit.registry.fleets() if record.code == code]
    if not found:
        raise NotFoundError("fleet", code)
    return answer(request, registry.fleet(found[0]))
