"""Alerts."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api import cursors
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IfNoneMatch,
    Limit,
    answer,
    answer_page,
    operation,
)
from api.known import require_known
from api.parameters import FleetFilter, Number, WheelsetFilter
from api.problems import described
from api.schemas import alerts
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.values.alerts import AlertScope, Condition

router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
Kind = Annotated[alerts.KnownKind | None, Query(description="Only of this kind.")]
InCondition = Annotated[Condition | None, Query(description="Only in this condition.")]
Scope = Annotated[AlertScope | None, Query(description="Only alerts of wheelsets, or only fleet alerts.")]
MemberOf = Annotated[
    int | None, Query(ge=1, le=2**63 - 1, description="Only members of the fleet alert with this `id`.", examples=[1])
]
OpenOnly = Annotated[bool, Query(alias="open", description="Only alerts that are not closed.")]


@router.get("", response_model=Page[alerts.Alert], responses=described(400, 404))
def list_alerts(
    request: Request,
    services: ServicesDep,
    fleet: FleetFilter = None,
    wheelset: WheelsetFilter = None,
    kind: Kind = None,
    condition: InCondition = None,
    scope: Scope = None,
    fleet_alert: MemberOf = None,
    open_only: OpenOnly = False,  # noqa: FBT002 - a query parameter
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the alerts, oldest first; fleet alerts and their members both."""
    filters = {
        "fleet": fleet,
        "wheelset": wheelset,
        "kind": kind,
        "condition": condition,
        "scope": scope,
        "fleet_alert": fleet_alert,
        "open": open_only,
    }
    after = cursors.decode_number(operation(request), filters, cursor)
    with services.storage.read() as unit:
        rows = unit.alerts.page(
            fleet=fleet,
            wheelset=wheelset,
            kind=kind,
            condition=condition,
            open_only=open_only,
            after_id=after,
            limit=limit + 1,
            scope=scope,
            fleet_alert_id=fleet_alert,
        )
        if not rows:
            require_known(unit, fleet=fleet, wheelset=wheelset, fleet_alert=fleet_alert)
    now_ns = services.clock.now_ns()
    return answer_page(
        request, filters, limit, rows, lambda record: record.alert_id, lambda record: alerts.alert(record, now_ns)
    )


@router.get("/{alert_id}", response_model=alerts.Alert, responses=described(404))
def get_alert(request: Request, services: ServicesDep, alert_id: Number, _held: IfNoneMatch = None) -> Response:
    """Return one alert with its evidence; its ETag is what changes to it ask for."""
    with services.storage.read() as unit:
        found = unit.alerts.get(alert_id)
    return answer(request, alerts.alert(found, services.clock.now_ns()))


@router.get("/{alert_id}/events", response_model=alerts.Events, responses=described(404))
def list_alert_events(request: Request, services: ServicesDep, alert_id: Number) -> Response:
    """List everything that happened to one alert, oldest first."""
    with services.storage.read() as unit:
        unit.alerts.get(alert_id)
        found = unit.alerts.events(alert_id)
    return answer(request, alerts.Events(items=[alerts.event(record) for record in found]))
