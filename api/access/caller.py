"""Who asks: the owner of the key or token of a request, with its scopes and fleets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import Depends, Request

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})


@dataclass(frozen=True, slots=True)
class Caller:
    """The owner of a key or token.

    Parameters
    ----------
    name
        Of the owner, as it is recorded with what is done; None where access is open.
    scopes
        What may be done.
    fleets
        Codes of the fleets that are visible; None for all.
    """

    name: str | None
    scopes: frozenset[str]
    fleets: frozenset[str] | None


ANYONE = Caller(None, EVERYTHING, None)
"""The caller of a service whose access is open."""


async def caller_of(request: Request) -> Caller:
    """Return who asks."""
    return cast("Caller", request.scope.get("state", {}).get("caller", ANYONE))


CallerDep = Annotated[Caller, Depends(caller_of)]
