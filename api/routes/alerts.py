"""Alerts and their feed, and what people do to them: acknowledge, shelve, unshelve, link to their work."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api import cursors
from api.access.gate import CallerDep, Scope, require_still_good, requires, still_good
from api.answers import (
    DEFAULT_LIMIT,
    Limit,
    answer,
    answer_items,
    link,
    next_path,
    payload_of,
    require_match,
    wants_table,
)
from api.asking import AskedChange, AskedDep, AskedListDep, ChangeDep, FleetFilter, Number, WheelsetFilter
from api.feed.pages import FeedFilter, FeedFilterDep, FeedPage, opened, read_kept, read_page
from api.feed.watch import CATCH_UP, EVENT_STREAM, EventStream, FeedStream, FeedWatch, WaitingPlaces, Waits
from api.middleware import turn_of
from api.problems import described
from api.schemas import alerts
from api.schemas.common import Body, Page
from api.services import Services, ServicesDep, require_fleets, require_known, writer_slot
from estimation.alerts import life_cycle
from estimation.values.alerts import Alert, AlertScope, Condition, Severity, Transition
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.alerts import AlertChoice, AlertOutline, AlertStore

router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
Kind = Annotated[alerts.KnownKind | None, Query(description="Only of this kind.")]
InCondition = Annotated[Condition | None, Query(description="Only in this condition.")]
OfScope = Annotated[
    AlertScope | None, Query(description="Only alerts of wheelsets, of the fleet, or of track sections.")
]
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
    scope: OfScope = None,
    fleet_alert: MemberOf = None,
    open_only: OpenOnly = False,  # noqa: FBT002 - a query parameter
    sort: Sort = alerts.AlertSort.OLDEST,
) -> Response:
    """List the alerts with where their wheelsets ran, by `sort`; fleet alerts and their members both."""
    choice = AlertChoice(fleet, wheelset, kind, condition, severity, scope, fleet_alert, open_only=open_only)
    ordered = None if sort is alerts.AlertSort.OLDEST else sort
    filters = asdict(choice) | {"fleet_alert": fleet_alert, "open": open_only, "sort": ordered}
    del filters["fleet_alert_id"], filters["open_only"]
    now_ns = asked.services.clock.now_ns()
    with asked.read() as unit:
        outlines = _outlines(unit.alerts, choice, sort, asked.after(filters), asked.limit + 1)
        if not outlines:
            require_known(unit, fleet=fleet, wheelset=wheelset, fleet_alert=fleet_alert)
        places = {outline.alert_id: {"vehicle": outline.vehicle, "axle": outline.axle} for outline in outlines}

        def made(numbers: Sequence[int]) -> Mapping[int, alerts.AlertRow]:
            records = unit.alerts.some(numbers).items()
            return {key: alerts.alert(record, now_ns, alerts.AlertRow, **places[key]) for key, record in records}

        def payloads(numbers: Sequence[int]) -> Mapping[int, bytes]:
            return {number: payload_of(row) for number, row in made(numbers).items()}

        keys = {outline.alert_id: _key(outline, now_ns) for outline in outlines[: asked.limit]}
        rows = made(list(keys)) if wants_table(asked.request) else {}
        texts = {} if rows else asked.services.cache.get_or_make_all(keys, payloads)
    worst = sort is alerts.AlertSort.WORST
    return asked.payloads(
        filters,
        outlines,
        lambda outline: [outline.severity.value, outline.alert_id] if worst else outline.alert_id,
        lambda outline: texts[outline.alert_id],
        lambda outline: rows[outline.alert_id],
    )


def _key(outline: AlertOutline, now_ns: int) -> Hashable:
    place = (outline.vehicle, outline.axle)
    return (
        "alert",
        outline.alert_id,
        outline.version,
        outline.last_seen_ns,
        alerts.display_state(outline, now_ns),
        *place,
    )


def _outlines(
    store: AlertStore, choice: AlertChoice, sort: alerts.AlertSort, after: object, limit: int
) -> Sequence[AlertOutline]:
    """Return the alerts behind a place; the worst first, each severity is a list of its own, newest first."""
    if sort is not alerts.AlertSort.WORST:
        number = cursors.number_of(after)
        return store.outlines(choice, number, limit, newest_first=sort is alerts.AlertSort.NEWEST)
    worst, number = _place(after)
    outlines: list[AlertOutline] = []
    for severity in reversed(list(Severity)[: list(Severity).index(worst) + 1]):
        if choice.severity in {None, severity} and len(outlines) < limit:
            of_severity = replace(choice, severity=severity)
            outlines += store.outlines(of_severity, number, limit - len(outlines), newest_first=True)
        number = None
    return outlines


def _place(after: object) -> tuple[Severity, int | None]:
    if after is None:
        return list(Severity)[-1], None
    match after:
        case [str() as severity, int() as number] if severity in list(Severity) and cursors.is_number(number):
            return Severity(severity), number
    raise cursors.refused()


@router.get("/{alert_id}", response_model=alerts.Alert, responses=described(404))
def get_alert(asked: AskedDep, alert_id: Number) -> Response:
    """Return one alert with its evidence; its ETag is what changes to it ask for."""
    return asked.one(lambda unit: alerts.alert(unit.alerts.get(alert_id), asked.services.clock.now_ns()))


@router.get("/{alert_id}/events", response_model=alerts.Events, responses=described(404))
def list_alert_events(request: Request, services: ServicesDep, alert_id: Number) -> Response:
    """List everything that happened to one alert, oldest first."""
    with services.storage.read() as unit:
        unit.alerts.get(alert_id)
        events = unit.alerts.events(alert_id)
    return answer(request, alerts.Events(items=[alerts.event(event) for event in events]))


actions_router = APIRouter(
    prefix="/v1/alerts", tags=["alerts"], dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)]
)
MAINTENANCE_SYSTEM = "maintenance system"  # who links to work of its own where access is open and nobody is named
_REFUSALS = described(404, 409, 412, 413, 415, 428)


def _change(
    asked: AskedChange, alert_id: int, body: Body, actor: str, note: str, act: Callable[[Alert, int], Transition | None]
) -> Response:

    def apply(unit: SqlUnitOfWork, now_ns: int) -> alerts.Alert:
        current = unit.alerts.get(alert_id)
        require_match(asked.if_match, alerts.alert(current, now_ns))
        transition = act(current, now_ns)
        if transition is not None:
            current = unit.alerts.save(transition.alert, transition.events, now_ns, actor, note)
        return alerts.alert(current, now_ns)

    return asked.once(body, apply)


@actions_router.post("/{alert_id}/acknowledge", response_model=alerts.Alert, responses=_REFUSALS)
def acknowledge_alert(asked: ChangeDep, alert_id: Number, body: alerts.Acknowledgement) -> Response:
    """Acknowledge the alert; the acknowledgement ends when the alert clears or becomes more severe."""
    actor = asked.caller.acts_as(body.by)
    return _change(
        asked, alert_id, body, actor, body.note, lambda alert, now_ns: life_cycle.acknowledge(alert, actor, now_ns)
    )


@actions_router.post("/{alert_id}/shelve", response_model=alerts.Alert, responses=_REFUSALS)
def shelve_alert(asked: ChangeDep, alert_id: Number, body: alerts.Shelving) -> Response:
    """Put the alert out of sight until a time; it comes back by itself."""

    def act(alert: Alert, now_ns: int) -> Transition | None:
        return life_cycle.shelve(alert, body.until, body.reason, now_ns)

    return _change(asked, alert_id, body, asked.caller.acts_as(body.by), body.reason, act)


@actions_router.post("/{alert_id}/unshelve", response_model=alerts.Alert, responses=_REFUSALS)
def unshelve_alert(asked: ChangeDep, alert_id: Number, body: alerts.Unshelving) -> Response:
    """Bring a shelved alert back before its time; one that is not shelved is refused (409)."""
    return _change(asked, alert_id, body, asked.caller.acts_as(body.by), body.note, life_cycle.unshelve)


@actions_router.post("/{alert_id}/external-refs", response_model=alerts.Alert, responses=_REFUSALS)
def add_external_ref(asked: ChangeDep, alert_id: Number, body: alerts.ExternalReference) -> Response:
    """Write back the identity that a maintenance system gave to its work on the alert."""
    actor = asked.caller.acts_as(body.by, MAINTENANCE_SYSTEM)
    return _change(asked, alert_id, body, actor, body.ref, lambda alert, _: life_cycle.link(alert, body.ref))


feed_router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
LONGEST_WAIT_S = 60.0
STREAM_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
After = Annotated[
    str | None,
    Query(
        description="`next_cursor` of the last poll with the same filter, or the last event id of a stream; left out, "
        "from the beginning; `latest`, only what happens from now on."
    ),
]
WaitS = Annotated[
    float,
    Query(
        ge=0.0, le=LONGEST_WAIT_S, description="Where nothing is new, wait so many seconds for something, then answer."
    ),
]
LastEventId = Annotated[
    str | None, Header(alias="Last-Event-ID", description="Id of the last event that was received; wins over `after`.")
]
STREAMED = {
    "description": "Events as they happen (server-sent events): `id` is the cursor behind an event, `data` an `Event`. "
    "Blocks without `data` are signs of life, with the cursor where it has changed.",
    "content": {
        EVENT_STREAM: {
            "schema": {"description": "A stream of server-sent events (WHATWG HTML)."},
            "example": 'retry: 2000\n\nid: WyJ...\ndata: {"event":"raised",...}\n\n',
        }
    },
}


@feed_router.get("/feed", response_model=alerts.Feed, responses=described(400, 404, 409))
async def poll_alert_feed(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    narrowed: FeedFilterDep,
    after: After = None,
    limit: Limit = DEFAULT_LIMIT,
    wait_s: WaitS = 0.0,
) -> Response:
    """Return what happened to alerts, in commit order; keep `next_cursor` and poll with it, nothing is missed.

    A fleet alert stands for members that were raised with it; what happens to those is in their own `events`. A cursor
    from before the database was restored is refused (409) where its history has changed, with where to go on.
    """
    where = partial(opened, services.storage, narrowed, request.scope["path"])
    kept = partial(read_kept, limit=limit, cache=services.cache)
    page = await run_in_threadpool(where, after, kept)
    if not page.items:
        await run_in_threadpool(require_fleets, services.storage, narrowed.fleets)
    if wait_s and not page.items:
        places: WaitingPlaces = request.app.state.waiting_places
        with places.held(Waits.LONG_POLL, caller), turn_of(request.scope).given_back():
            empty = await run_in_threadpool(where, page.end.cursor, partial(read_page, limit=1))
            await _news(request.app.state.feed_watch, services, narrowed, empty, wait_s)
        await require_still_good(request.scope)
        after = page.end.cursor
        page = await run_in_threadpool(where, after, kept)
    path = next_path(request, "after", page.end.cursor)
    if wants_table(request):
        events = (await run_in_threadpool(where, after, partial(read_page, limit=len(page.items)))).events
        shown = [alerts.event(event) for event, _ in events]
        return answer(request, alerts.Feed(items=shown, next_cursor=page.end.cursor, next=path), headers=link(path))
    return answer_items(request, page.items, page.end.cursor, path)


@feed_router.get(
    "/feed/stream",
    response_class=EventStream,
    status_code=200,  # FastAPI does not find it in a class of our own
    responses={**described(400, 404, 409), 200: STREAMED},
)
async def stream_alert_feed(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    narrowed: FeedFilterDep,
    after: After = None,
    last_event_id: LastEventId = None,
) -> Response:
    """Stream what happens to alerts, in commit order, from a cursor on; connect again with the last event id.

    The ids are cursors of the feed: a client may change between stream and poll. A stream ends after a quarter of an
    hour and when the service ends.
    """
    path = request.scope["path"]
    begin = after if last_event_id is None else last_event_id
    page = await run_in_threadpool(opened, services.storage, narrowed, path, begin, partial(read_page, limit=CATCH_UP))
    if not page.events:
        await run_in_threadpool(require_fleets, services.storage, narrowed.fleets)
    stream = FeedStream(request.app.state.feed_watch, narrowed, services.storage, partial(still_good, request.scope))
    places: WaitingPlaces = request.app.state.waiting_places
    held = (places.held(Waits.STREAM, caller), turn_of(request.scope).given_back())
    return EventStream(stream.parts(page), STREAM_HEADERS, held)


async def _news(watch: FeedWatch, services: Services, narrowed: FeedFilter, page: FeedPage, wait_s: float) -> None:
    until, histories = time.monotonic() + wait_s, watch.histories
    async with watch.following(narrowed, services.storage, page) as channel:
        while (left_s := until - time.monotonic()) > 0 and not watch.ended and histories == watch.histories:
            if channel.after(page.end.sequence) != []:
                return
            await watch.wait(left_s)
