"""Doors: what of the service answers without a key, and what may be shut by configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from starlette.types import Scope

from api.access.caller import Caller
from api.access.hosts import READING
from api.problems import ProblemError

Door = Literal["key", "open", "off"]
HEALTH = frozenset({"/healthz", "/readyz"})
PAGE = frozenset({"/", "/favicon.ico"})
"""The page itself holds nothing of a fleet: it asks for a key and reads with it."""
PAGE_FILES = "/assets/"
DOCUMENTS = frozenset({"/openapi.json", "/docs"})
DOCUMENT_FILES = "/docs/"
METRICS = "/metrics"


@dataclass(frozen=True, slots=True)
class Opened:
    """What a deployment sets of its doors: ``key`` needs a key, ``open`` needs none, ``off`` is shut."""

    metrics: Door = "key"
    docs: Door = "key"


@dataclass(frozen=True, slots=True)
class _Passage:
    """How a path is passed; ``of_all_fleets`` asks for a reading key that is bound to none."""

    open: bool = False
    shut: bool = False
    of_all_fleets: bool = False

    def check(self, caller: Caller) -> None:
        """Refuse a caller who may not pass.

        Raises:
            ProblemError: 403.
        """
        if self.of_all_fleets and ("read" not in caller.scopes or caller.fleets is not None):
            raise ProblemError(403, "forbidden", "this needs a key of all fleets with the scope 'read'")


def door_of(opened: Opened, scope: Scope) -> _Passage:
    """Return how the path of a request is passed; with a key where nothing else is said."""
    path: str = scope["path"]
    if path in HEALTH or path in PAGE or path.startswith(PAGE_FILES):
        return _Passage(open=True)  # also where the method is not allowed, which is then the answer
    if scope["method"] not in READING:
        return _Passage()
    if path == METRICS:
        return _Passage(open=opened.metrics == "open", shut=opened.metrics == "off", of_all_fleets=True)
    if path in DOCUMENTS or path.startswith(DOCUMENT_FILES):
        return _Passage(open=opened.docs == "open", shut=opened.docs == "off")
    return _Passage()
