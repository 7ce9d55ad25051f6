"""Every operation has one scope, and every change says how its object is found for a caller bound to fleets."""

from __future__ import annotations

import pytest
from fastapi import APIRouter, Depends, FastAPI
from fastapi.routing import APIRoute

from api import app
from api.access.gate import Scope, requires, scope_of
from api.services import FINDERS, finder_of


def routes() -> list[APIRoute]:
    return [route for router in app.RESOURCES for route in router.routes if isinstance(route, APIRoute)]


@pytest.mark.parametrize("route", routes(), ids=lambda route: route.name)
def test_every_operation_has_one_scope(route: APIRoute) -> None:
    """One line each: a new operation that changes something and declares none fails here."""
    scope = scope_of(route)
    assert scope is not None, f"{route.path_format}: dependencies=[Depends(requires(Scope....))]"
    if route.methods != {"GET"}:
        assert scope is not Scope.READ
        assert "{" not in route.path_format or finder_of(route.path_format)


def test_no_finder_is_left_over() -> None:
    assert {finder_of(r.path_format)[0] for r in routes() if r.methods != {"GET"} and "{" in r.path_format} == set(
        FINDERS
    ) - {"/v1/fleets/{code}"}


def test_a_change_without_a_scope_has_none() -> None:
    router = APIRouter()

    @router.post("/plain")
    def plain() -> None: ...

    @router.post("/two", dependencies=[Depends(requires(Scope.ACT)), Depends(requires(Scope.ADMIN))])
    def two() -> None: ...

    built = FastAPI()
    built.include_router(router)
    for route in router.routes:
        assert isinstance(route, APIRoute)
        assert scope_of(route) is None
