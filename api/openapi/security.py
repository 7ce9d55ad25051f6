"""Access in the OpenAPI document: the key, and the scope that each operation needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any

from fastapi.routing import APIRoute

from api.access.open_paths import HEALTH
from api.access.scopes import Scope, scope_of

KEY = "key"
SCHEME = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key of this service (`treadwatch keys create`), or a token of the identity provider.",
}


def scopes_of(modules: Iterable[ModuleType]) -> dict[str, Scope]:
    """Return the scope of every operation by its name.

    Raises:
        LookupError: One has none.
    """
    found = {}
    for module in modules:
        for route in module.router.routes:
            if isinstance(route, APIRoute):
                scope = scope_of(route)
                if scope is None:
                    raise LookupError(f"{route.name} declares no scope")
                found[route.name] = scope
    return found


def describe_access(document: dict[str, Any], scopes: Mapping[str, Scope]) -> None:
    """Add the key to the document, and the scope to every operation; `/healthz` and `/readyz` need none.

    Args:
        scopes: Each under the name of its operation; `read` where nothing is said, as of `/metrics`.
    """
    document["components"]["securitySchemes"] = {KEY: SCHEME}
    for path, operations in document["paths"].items():
        for operation in operations.values():
            scope = scopes.get(operation["operationId"], Scope.READ)
            operation["security"] = [] if path in HEALTH else [{KEY: [scope.value]}]
