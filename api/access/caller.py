"""Who asks: the owner of the key or token of a request, with its scopes and fleets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import Depends, Request
from starlette.types import Scope

from api.problems import ProblemError, ProblemItem

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})
NOBODY_NAMED = "anyone"
"""Who makes a key where access is open."""
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
        """Return who is recorded as the actor: the owner of the key; where access is open, whom the body names.

        Args:
            unnamed: Who it is where access is open and the body names nobody; None refuses that.
        """
        if self.name is None and (by or unnamed) is not None:
            return by or str(unnamed)
        if self.name is None or by not in {None, self.name}:
            wrong = (
                "is required where access is open" if self.name is None else f"is not the key's owner, {self.name!r}"
            )
            item = ProblemItem(part="body", pointer="#/by", detail=wrong)
            raise ProblemError(422, "invalid-request", f"body #/by: {wrong}", [item])
        return self.name


ANYONE = Caller(None, EVERYTHING, None)
"""The caller of a service whose access is open."""


def name_caller(scope: Scope, caller: Caller) -> None:
    """Let a request be that of a caller; to be called once it is known."""
    scope[_PLACE] = caller


def known_caller(scope: Scope) -> Caller | None:
    """Return who asks; None where nobody is known yet, as of a request that is refused."""
    return cast("Caller | None", scope.get(_PLACE))


async def caller_of(request: Request) -> Caller:
    """Return who asks."""
    found = known_caller(request.scope)
    if found is None:
        raise LookupError("the request did not pass api.access.gate")
    return found


CallerDep = Annotated[Caller, Depends(caller_of)]
