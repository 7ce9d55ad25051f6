"""The feed of alerts: polled, polled with a wait, or streamed."""

from __future__ import annotations

import time
from functools import partial
from typing import Annotated, cast

import orjson
from fastapi import APIRouter, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.caller import CallerDep
from api.answers import DEFAULT_LIMIT, Limit, answer, answer_bytes, next_path, payload_of, wants_table
from api.feed.filters import FeedFilter, FeedFilterDep
from api.feed.pages import FeedPage, opened
from api.feed.places import WaitingPlaces, Waits
from api.feed.streams import CATCH_UP, EVENT_STREAM, EventStream, FeedStream
from api.feed.watch import FeedWatch
from api.known import require_known
from api.middleware import turn_of
from api.problems import described
from api.representation_cache import RepresentationCache
from api.schemas import alerts
from api.services import Services, ServicesDep
from estimation.values.alerts import AlertEvent

router = APIRouter(prefix="/v1/alerts", tags=["alerts"])
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


@router.get("/feed", response_model=alerts.Feed, responses=described(400, 404, 409))
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
    read = partial(_page, services, narrowed, request.scope["path"], after, limit)
    page = await run_in_threadpool(read)
    if wait_s and not page.events:
        places: WaitingPlaces = request.app.state.waiting_places
        with places.held(Waits.LONG_POLL, caller), turn_of(request.scope).given_back():
            await _news(_watch(request), services, narrowed, page, wait_s)
        page = await run_in_threadpool(
            partial(_page, services, narrowed, request.scope["path"], page.end.cursor, limit)
        )
    path = next_path(request, "after", page.end.cursor)
    headers = {"Link": f'<{path}>; rel="next"'}
    if wants_table(request):
        body = alerts.Feed(
            items=[alerts.event(event) for event, _ in page.events], next_cursor=page.end.cursor, next=path
        )
        return answer(request, body, headers=headers)
    payload = await run_in_threadpool(partial(_payload, services.cache, page, path))
    return answer_bytes(request, payload, headers=headers)


def _payload(cache: RepresentationCache, page: FeedPage, path: str) -> bytes:
    """Return a ``Feed``; an event never changes, so that its text is made once."""
    items = []
    for event, _ in page.events:
        key = ("event", event.sequence, event.recorded_ns, event.alert.alert_id, event.alert.version)
        items.append(cache.get_or_make(key, partial(_event, event)))
    rest = orjson.dumps({"next_cursor": page.end.cursor, "next": path})
    return b'{"items":[' + b",".join(items) + b"]," + rest[1:]


def _event(event: AlertEvent) -> bytes:
    return payload_of(alerts.event(event))


@router.get(
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
    page = await run_in_threadpool(partial(_page, services, narrowed, path, begin, CATCH_UP))
    stream = FeedStream(_watch(request), narrowed, services.storage)
    places: WaitingPlaces = request.app.state.waiting_places
    held = (places.held(Waits.STREAM, caller), turn_of(request.scope).given_back())
    return EventStream(stream.parts(page), STREAM_HEADERS, held)


def _watch(request: Request) -> FeedWatch:
    return cast("FeedWatch", request.app.state.feed_watch)


def _page(services: Services, narrowed: FeedFilter, path: str, after: str | None, limit: int) -> FeedPage:
    page = opened(services.storage, narrowed, path, after, limit)
    if narrowed.fleets and not page.events:
        with services.storage.read() as unit:
            for fleet in sorted(narrowed.fleets):
                require_known(unit, fleet=fleet)
    return page


async def _news(watch: FeedWatch, services: Services, narrowed: FeedFilter, page: FeedPage, wait_s: float) -> None:
    """Wait until there is something behind a page, or for a time."""
    until, histories = time.monotonic() + wait_s, watch.histories
    async with watch.following(narrowed, services.storage, page) as channel:
        while (left_s := until - time.monotonic()) > 0 and not watch.ended and histories == watch.histories:
            if channel.after(page.end.sequence) != []:
                return
            await watch.wait(left_s)
