"""The feed of alerts: polled, polled with a wait, or streamed."""

from __future__ import annotations

import time
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.gate import CallerDep, require_still_good, still_good
from api.answers import DEFAULT_LIMIT, Limit, answer, answer_items, link, next_path, wants_table
from api.feed.pages import FeedFilter, FeedFilterDep, FeedPage, opened, read_kept, read_page
from api.feed.watch import CATCH_UP, EVENT_STREAM, EventStream, FeedStream, FeedWatch, WaitingPlaces, Waits
from api.middleware import turn_of
from api.problems import described
from api.schemas import alerts
from api.services import Services, ServicesDep, require_fleets

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
