"""Alerts."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api import cursors
from api.answers import answer, answer_payloads, payload_of, wants_table
from api.asking import AskedDep, AskedListDep
from api.known import require_known
from api.parameters import FleetFilter, Number, WheelsetFilter
from api.problems import described
from api.schemas import alerts
from api.schemas.common import Page
from api.services import ServicesDep
from estimation.values.alerts import AlertScope, Condition, Severity
from fleet_db.stores.alert_queries import AlertChoice, AlertOutline
from fleet_db.stores.alerts import AlertStore

router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
Kind = Annotated[alerts.KnownKind | None, Query(description="Only of this kind.")]
InCondition = Annotated[Condition | None, Query(description="Only in this condition.")]
Scope = Annotated[AlertScope | None, Query(description="Only alerts of wheelsets, of the fleet, or of track sections.")]
MemberOf = Annotated[
    int | None, Query(ge=1, le=2**63 - 1, description="Only members of the fleet alert with this `id`.", examples=[1])
]
OfSeverity = Annotated[Severity | None, Query(description="Only of this severity.")]
Sort = Annotated[
    alerts.AlertSort,
    Query(description="Oldest first (`id`), newest first (`-id`), or the worst first and of those the newest."),
]
OpenOnly = Annotated[bool, Query(alias="open", description="Only alerts that are not closed.")]


@router.get("", response_model=Page[alerts.AlertRow], responses=described(400, 404))
def list_alerts(
    asked: AskedListDep,
    fleet: FleetFilter = None,
    wheelset: WheelsetFilter = None,
    kind: Kind = None,
    condition: InCondition = None,
    severity: OfSeverity = None,
    scope: Scope = None,
    fleet_alert: MemberOf = None,
    open_only: OpenOnly = False,  # noqa: FBT002 - a query parameter
    sort: Sort = alerts.AlertSort.OLDEST,
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
        "sort": None if sort is alerts.AlertSort.OLDEST else sort,
    }
    after = asked.after(filters)
    choice = AlertChoice(fleet, wheelset, kind, condition, severity, scope, fleet_alert, open_only=open_only)
    now_ns = asked.services.clock.now_ns()
    with asked.read() as unit:
        found = _found(unit.alerts, choice, sort, after, asked.limit + 1)
        if not found:
            require_known(unit, fleet=fleet, wheelset=wheelset, fleet_alert=fleet_alert)
        places = {one.alert_id: (one.vehicle, one.axle) for one in found}

        def made(numbers: Sequence[int]) -> Mapping[int, alerts.AlertRow]:
            records = unit.alerts.some(numbers)
            return {number: alerts.alert_row(record, now_ns, places[number]) for number, record in records.items()}

        def payloads(numbers: Sequence[int]) -> Mapping[int, bytes]:
            return {number: payload_of(row) for number, row in made(numbers).items()}

        keys = {one.alert_id: _key(one, now_ns) for one in found[: asked.limit]}
        rows = made(list(keys)) if wants_table(asked.request) else {}
        texts = {} if rows else asked.services.cache.get_or_make_all(keys, payloads)
    by_severity = sort is alerts.AlertSort.WORST
    return answer_payloads(
        asked.request,
        filters,
        asked.limit,
        found,
        lambda one: [one.severity.value, one.alert_id] if by_severity else one.alert_id,
        lambda one: texts[one.alert_id],
        lambda one: rows[one.alert_id],
    )


def _key(one: AlertOutline, now_ns: int) -> Hashable:
    """Return what changes whenever the row of an alert does."""
    shown = alerts.display_state(one, now_ns)
    return ("alert", one.alert_id, one.version, one.last_seen_ns, shown, one.vehicle, one.axle)


def _found(
    store: AlertStore, choice: AlertChoice, sort: alerts.AlertSort, after: object, limit: int
) -> Sequence[AlertOutline]:
    """Return the alerts behind a place; the worst first, each severity is a list of its own, newest first."""
    if sort is not alerts.AlertSort.WORST:
        number = cursors.number_of(after)
        return store.outlines(choice, number, limit, newest_first=sort is alerts.AlertSort.NEWEST)
    worst, number = _place(after)
    found: list[AlertOutline] = []
    for one in reversed(list(Severity)[: list(Severity).index(worst) + 1]):
        if choice.severity in {None, one} and len(found) < limit:
            of_one = replace(choice, severity=one)
            found += store.outlines(of_one, number, limit - len(found), newest_first=True)
        number = None
    return found


def _place(after: object) -> tuple[Severity, int | None]:
    """Return severity and number of the last alert of the page before; the worst, and none, at the beginning."""
    if after is None:
        return list(Severity)[-1], None
    match after:
        case [str() as severity, int() as number] if severity in list(Severity) and cursors.is_number(number):
            return Severity(severity), number
    raise cursors.refused("this is no cursor of this list")


@router.get("/{alert_id}", response_model=alerts.Alert, responses=described(404))
def get_alert(asked: AskedDep, alert_id: Number) -> Response:
    """Return one alert with its evidence; its ETag is what changes to it ask for."""
    with asked.read() as unit:
        found = unit.alerts.get(alert_id)
    return asked.answer(alerts.alert(found, asked.services.clock.now_ns()))


@router.get("/{alert_id}/events", response_model=alerts.Events, responses=described(404))
def list_alert_events(request: Request, services: ServicesDep, alert_id: Number) -> Response:
    """List everything that happened to one alert, oldest first."""
    with services.storage.read() as unit:
        unit.alerts.get(alert_id)
        found = unit.alerts.events(alert_id)
    return answer(request, alerts.Events(items=[alerts.event(record) for record in found]))
