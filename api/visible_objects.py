"""What a request names must be there, and visible to who asks.

Filters that name something that is not there are refused, for an empty list would look like good news. Writing
transactions see all fleets, for numbers and locks count everything: so a caller who is bound to fleets reads first what
the path of a change names, in a transaction that shows those fleets only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from api.access.caller import CallerDep
from api.services import ServicesDep
from estimation.errors import NotFoundError
from fleet_db.storage import SqlUnitOfWork


def require_known(
    unit: SqlUnitOfWork,
    *,
    fleet: str | None = None,
    vehicle: str | None = None,
    wheelset: str | None = None,
    vehicle_class: str | None = None,
    fleet_alert: int | None = None,
) -> None:
    """Refuse filters that name nothing; to be asked where a page is empty, for one with rows shows that they do."""
    if fleet is not None and all(one.code != fleet for one in unit.registry.fleets()):
        raise NotFoundError("fleet", fleet)
    if vehicle is not None:
        unit.registry.vehicle(vehicle)
    if wheelset is not None:
        unit.registry.wheelset(wheelset)
    if vehicle_class is not None and unit.registry.vehicle_class(vehicle_class) is None:
        raise NotFoundError("vehicle class", vehicle_class)
    if fleet_alert is not None and unit.alerts.get(fleet_alert).wheelset is not None:
        raise NotFoundError("fleet alert", str(fleet_alert))


Find = Callable[[SqlUnitOfWork, str], object]
_READING = frozenset({"GET", "HEAD"})


def _numbered(look_up: Callable[[SqlUnitOfWork, int], object]) -> Find:
    def find(unit: SqlUnitOfWork, text: str) -> object:
        return look_up(unit, int(text)) if text.isdecimal() and int(text) < 2**63 else None  # the route refuses others

    return find


def _recording(unit: SqlUnitOfWork, digest: str) -> None:
    if unit.chunks.get(digest) is None:
        raise NotFoundError("recording", digest)


SHARED: Find = lambda _unit, _name: None  # noqa: E731 - a name for what needs no look
FINDERS: Mapping[str, Find] = {
    "/v1/alerts/{alert_id}": _numbered(lambda unit, number: unit.alerts.get(number)),
    "/v1/fleets/{code}": lambda unit, code: require_known(unit, fleet=code),
    "/v1/vehicles/{code}": lambda unit, code: unit.registry.vehicle(code),
    "/v1/wheelsets/{serial}": lambda unit, serial: unit.registry.wheelset(serial),
    "/v1/jobs/{name}": SHARED,
    "/v1/keys/{prefix}": SHARED,
    "/v1/recordings/{digest}": _recording,
    "/v1/chunks/{sha256}": SHARED,  # it need not be there yet; the route looks at its vehicle
    "/v1/webhooks/{webhook_id}": _numbered(lambda unit, number: unit.webhooks.get(number)),
}
"""How the first object in a path is found, by the template of the path up to it."""


async def visible(request: Request, services: ServicesDep, caller: CallerDep) -> None:
    """Refuse a change to something that its caller does not see, as if it did not exist."""
    route: APIRoute = request.scope["route"]
    if caller.fleets is None or request.method in _READING or not request.path_params:
        return
    template, find = finder_of(route.path_format)
    name = template.rsplit("{", maxsplit=1)[-1].rstrip("}")

    def look() -> None:
        with services.storage.read() as unit:
            find(unit, request.path_params[name])

    await run_in_threadpool(look)


def finder_of(path: str) -> tuple[str, Find]:
    """Return the template of the first object in a path, and how it is found."""
    template = path[: path.index("}") + 1]
    if template not in FINDERS:
        raise LookupError(f"api/visible_objects.py does not say how {template} is found")
    return template, FINDERS[template]
