"""Scopes: what a caller may do. Every operation declares exactly one; a test lists them all."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from api.access.caller import CallerDep
from api.problems import ProblemError


class Scope(StrEnum):
    """What a key or a token allows; each stands for itself alone."""

    READ = "read"
    ACT = "act"
    INGEST = "ingest"
    ADMIN = "admin"


SCOPE_OF = "treadwatch_scope"
"""Attribute of a dependency under which the document and the tests find the scope of an operation."""


def requires(scope: Scope) -> Callable[[CallerDep], None]:
    """Return a dependency that refuses callers without a scope.

    Parameters
    ----------
    scope
        That the operation needs.

    Raises
    ------
    ProblemError
        In the dependency, 403: the caller does not have it; names the scope.
    """

    def check(caller: CallerDep) -> None:
        if scope not in caller.scopes:
            raise ProblemError(403, "forbidden", f"this needs the scope '{scope}'")

    setattr(check, SCOPE_OF, scope)
    return check
