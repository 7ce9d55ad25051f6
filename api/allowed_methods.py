"""Which methods a resource has, over all routes of its path; the framework names those of the first route only."""

from __future__ import annotations

import re
from collections.abc import Iterable
from http import HTTPMethod

from starlette.routing import compile_path


def allowed_methods(operations: Iterable[tuple[str, str]], path: str, named: str) -> str:
    """Return the value of ``Allow`` (RFC 9110, 10.2.1) for a path; HEAD goes with GET."""
    methods: dict[str, set[str]] = {}
    for template, method in operations:
        methods.setdefault(template, set()).add(method)
    fitting = [template for template in methods if _fits(template, path)]
    if fitting:
        found = methods[min(fitting, key=lambda template: template.count("{"))]
    else:
        found = {name.strip() for name in named.split(",") if name.strip()}
    if HTTPMethod.GET in found:
        found = {*found, HTTPMethod.HEAD.value}
    return ", ".join(sorted(found))


def _fits(template: str, path: str) -> bool:
    pattern: re.Pattern[str] = compile_path(template)[0]
    return pattern.match(path) is not None
