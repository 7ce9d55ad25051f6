"""Alerts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api import cursors
from api.answers import (
    DEFAULT_LIMIT,
    Cursor,
    IfNoneMatch,
    Limit,
    answer,
    answer_payloads,
    operation,
    payload_of,
)
from api.known import require_known
from api.parameters import FleetFilter, Number, WheelsetFilter
from api.problems import described
from api.schemas import alert_rows, alerts
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.values.alerts import Alert, AlertScope, Condition, Severity

router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
Kind = Annotated[alerts.KnownKind | None, Query(description="Only of this kind.")]
InCondition = Annotated[Condition | None, Query(description="Only in this condition.")]
Scope = Annotated[AlertScope | None, Query(description="Only alerts of wheelsets, or only fleet alerts.")]
MemberOf = Annotated[
    int | None, Query(ge=1, le=2**63 - 1, description="Only members of the fleet alert with this `id`.", examples=[1])
]
OfSeverity = Annotated[Severity | None, Query(description="Only of this severity.")]
Sort = Annotated[
    alert_rows.AlertSort,
    Query(description="Oldest first (`id`), newest first (`-id`), or the worst first and of those the newest."),
]
OpenOnly = Annotated[bool, Query(alias="open", description="Only alerts that are not closed.")]


@router.get("", response_model=Page[alert_rows.AlertRow], responses=described(400, 404))
def list_alerts(
    request: Request,
    services: ServicesDep,
    fleet: FleetFilter = None,
    wheelset: WheelsetFilter = None,
    kind: Kind = None,
    condition: InCondition = None,
    severity: OfSeverity = None,
    scope: Scope = None,
    fleet_alert: MemberOf = None,
    open_only: OpenOnly = False,  # noqa: FBT002 - a query parameter
    sort: Sort = alert_rows.AlertSort.OLDEST,
    cursor: Cursor = None,
    limit: Limit = DEFAULT_LIMIT,
) -> Response:
    """List the alerts with where their wheelsets ran, by `sort`; fleet alerts and their members both."""
    filters = {
        "fleet": fleet,
        "wheelset": wheelset,
        "kind": kind,
        "condition": condition,
        "severity": severity,
        "scope": scope,
        "fleet_alert": fleet_alert,
        "open": open_only,
        "sort": None if sort is alert_rows.AlertSort.OLDEST else sort,
    }
    after = cursors.decode(operation(request), filters, cursor)
    with services.storage.read() as unit:
        page = partial(
            unit.alerts.page,
            fleet=fleet,
            wheelset=wheelset,
            kind=kind,
            condition=condition,
            open_only=open_only,
            scope=scope,
            fleet_alert_id=fleet_alert,
        )
        rows = _rows(page, sort, severity, after, limit + 1)
        if not rows:
            require_known(unit, fleet=fleet, wheelset=wheelset, fleet_alert=fleet_alert)
        places = unit.alerts.places([record.alert_id for record in rows])
    now_ns = services.clock.now_ns()
    by_severity = sort is alert_rows.AlertSort.WORST

    def row(record: Alert) -> alert_rows.AlertRow:
        return alert_rows.alert_row(record, now_ns, places)

    def payload(record: Alert) -> bytes:
        shown = (alerts.display_state(record, now_ns), places.get(record.alert_id))
        key = ("alert", record.alert_id, record.version, record.last_seen_ns, *shown)
        return services.cache.get_or_make(key, lambda: payload_of(row(record)))

    return answer_payloads(
        request,
        filters,
        limit,
        rows,
        lambda record: [record.severity.value, record.alert_id] if by_severity else record.alert_id,
        payload,
        row,
    )


def _rows(
    page: Callable[..., Sequence[Alert]],
    sort: alert_rows.AlertSort,
    severity: Severity | None,
    after: object,
    limit: int,
) -> Sequence[Alert]:
    """Return the alerts behind a place; the worst first, each severity is a list of its own, newest first."""
    if sort is not alert_rows.AlertSort.WORST:
        number = cursors.number_of(after)
        newest_first = sort is alert_rows.AlertSort.NEWEST
        return page(severity=severity, after_id=number, limit=limit, newest_first=newest_first)
    worst, number = _place(after)
    rows: list[Alert] = []
    for one in reversed(list(Severity)[: list(Severity).index(worst) + 1]):
        if severity in {None, one} and len(rows) < limit:
            rows += page(severity=one, after_id=number, limit=limit - len(rows), newest_first=True)
        number = None
    return rows


def _place(after: object) -> tuple[Severity, int | None]:
    """Return severity and number of the last alert of the page before; the worst, and none, at the beginning.

    Raises
    ------
    ProblemError
        400: it is no place of this list.
    """
    if after is None:
        return list(Severity)[-1], None
    match after:
        case [str() as severity, int() as number] if severity in list(Severity) and cursors.is_number(number):
            return Severity(severity), number
    raise cursors.refused("this is no cursor of this list")


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
