"""Scopes: what a caller may do. Every operation has exactly one; a test lists them all."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from http import HTTPMethod

from fastapi import Request
from fastapi.routing import APIRoute

from api.access.caller import Caller, CallerDep
from api.problems import ProblemError


class Scope(StrEnum):
    """What a key or a token allows; each stands for itself alone."""

    READ = "read"
    ACT = "act"
    INGEST = "ingest"
    ADMIN = "admin"


SCOPE_OF = "treadwatch_scope"
"""Attribute of a dependency under which the document and the tests find the scope of an operation."""
_READING = frozenset({HTTPMethod.GET.value, HTTPMethod.HEAD.value})


def requires(scope: Scope, *, all_fleets: bool = False) -> Callable[[CallerDep], None]:
    """Return a dependency that refuses callers without a scope."""

    def check(caller: CallerDep) -> None:
        refuse_without(caller, scope)
        if all_fleets and caller.fleets is not None:
            raise ProblemError(403, "forbidden", "this needs a key of all fleets")

    setattr(check, SCOPE_OF, scope)
    return check


def refuse_without(caller: Caller, scope: Scope) -> None:
    """Refuse a caller without a scope."""
    if scope not in caller.scopes:
        raise ProblemError(403, "forbidden", f"this needs the scope '{scope}'")


def scope_of(route: APIRoute) -> Scope | None:
    """Return the scope of an operation: the one that it declares, `read` where it only reads; None is a mistake."""
    declared = {
        scope for depends in route.dependencies if (scope := getattr(depends.dependency, SCOPE_OF, None)) is not None
    }
    if len(declared) == 1:
        return Scope(declared.pop())
    return Scope.READ if not declared and (route.methods or set()) <= _READING else None


async def authorise(request: Request, caller: CallerDep) -> None:
    """Refuse callers who lack the scope of the operation; for every route of the API."""
    route: APIRoute = request.scope["route"]
    scope = scope_of(route)
    if scope is None:
        raise LookupError(f"{route.path_format} declares no scope: dependencies=[Depends(requires(Scope....))]")
    refuse_without(caller, scope)
