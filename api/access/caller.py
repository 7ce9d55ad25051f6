"""Who asks, and what they may do: the owner of the key or token of a request, with its scopes and fleets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPMethod
from typing import Annotated, cast

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from starlette import types

from api.problems import ProblemError, invalid

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})
NOBODY_NAMED = "anyone"  # who makes a key where access is open
_PLACE = "treadwatch.caller"


@dataclass(frozen=True, slots=True)
class Caller:
    """The owner of a key or token.

    Args:
        name: Of the owner, as it is recorded with what is done; None where access is open.
        fleets: Codes of the fleets that are visible; None for all.
        identity: Of the key or token's subject, such as ``key 3fq2xh7a``: what limits and Idempotency-Keys belong to;
            None where access is open.
    """

    name: str | None
    scopes: frozenset[str]
    fleets: frozenset[str] | None
    identity: str | None = None

    @property
    def key_prefix(self) -> str | None:
        """Prefix of the key; None for a token and where access is open."""
        kind, _, rest = (self.identity or "").partition(" ")
        return rest if kind == "key" else None

    def acts_as(self, by: str | None, unnamed: str | None = None) -> str:
        """Return who is recorded as the actor: the owner of the key; where access is open, ``by`` or ``unnamed``."""
        if self.name is None and (by or unnamed) is not None:
            return by or str(unnamed)
        if self.name is None or by not in {None, self.name}:
            wrong = (
                "is required where access is open" if self.name is None else f"is not the key's owner, {self.name!r}"
            )
            raise invalid("#/by", wrong)
        return self.name


ANYONE = Caller(None, EVERYTHING, None)  # the caller of a service whose access is open


def name_caller(scope: types.Scope, caller: Caller) -> None:
    """Let a request be that of a caller; to be called once it is known."""
    scope[_PLACE] = caller


def known_caller(scope: types.Scope) -> Caller | None:
    """Return who asks; None where nobody is known yet, as of a request that is refused."""
    return cast("Caller | None", scope.get(_PLACE))


async def _caller_of(request: Request) -> Caller:
    found = known_caller(request.scope)
    if found is None:
        raise LookupError("the request did not pass api.access.gate")
    return found


CallerDep = Annotated[Caller, Depends(_caller_of)]


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
        _refuse_without(caller, scope)
        if all_fleets and caller.fleets is not None:
            raise ProblemError(403, "forbidden", "this needs a key of all fleets")

    setattr(check, SCOPE_OF, scope)
    return check


def _refuse_without(caller: Caller, scope: Scope) -> None:
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
    _refuse_without(caller, scope)
