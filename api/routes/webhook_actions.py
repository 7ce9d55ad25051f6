"""What is done with a webhook: tried out, sent the feed again, signed with another secret."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from http import HTTPStatus

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.scopes import Scope, requires
from api.answers import answer
from api.feed import cursors as feed_cursors
from api.feed.filters import FeedFilter
from api.feed.pages import LATEST
from api.feed.places import TRY_AGAIN
from api.middleware import turn_of
from api.problems import ProblemError, ProblemItem, described
from api.routes.webhooks import WebhookId
from api.services import Services, ServicesDep, writer_slot
from api.webhooks import representations as webhooks
from api.webhooks.cloud_events import trial_event
from api.webhooks.sending import TRIALS, Sender
from api.webhooks.signing import new_secret, signed_headers
from fleet_db.storage import SqlUnitOfWork
from fleet_db.webhook_records import Webhook

router = APIRouter(prefix="/v1/webhooks/{webhook_id}", tags=["webhooks"])
_ADMIN = [Depends(requires(Scope.ADMIN))]
_WRITING = [*_ADMIN, Depends(writer_slot)]
SECOND_NS = 1_000_000_000


@router.post("/test", dependencies=_ADMIN, response_model=webhooks.WebhookTrial, responses=described(404, 415))
async def try_webhook(request: Request, services: ServicesDep, webhook_id: WebhookId) -> Response:
    """Send one signed event that only tries the webhook out, of whatever state, once; return what came back.

    What the receiver said besides its status is not shown.
    """
    sender: Sender = request.app.state.webhook_sender
    places: asyncio.Semaphore = request.app.state.webhook_trials
    if places.locked():
        raise ProblemError(503, "overloaded", f"{TRIALS} webhooks are being tried out; try again", headers=TRY_AGAIN)
    url, identity, headers, payload = await run_in_threadpool(_trial, services, webhook_id)
    async with places:
        with turn_of(request.scope).given_back():
            outcome = await sender.send(url, headers, payload)
    return answer(request, webhooks.trial(identity, outcome))


@router.post(
    "/replay", dependencies=_WRITING, response_model=webhooks.Webhook, responses=described(400, 404, 409, 413, 415)
)
def replay_webhook(request: Request, services: ServicesDep, webhook_id: WebhookId, body: webhooks.Replay) -> Response:
    """Let a webhook go on from another place of the feed; what was sent already is sent again, under the same ids."""
    if (body.after is None) == (body.from_time is None):
        item = ProblemItem(part="body", pointer="#/after", detail="give either `after` or `from`")
        raise ProblemError(422, "invalid-request", "body #/after: give either `after` or `from`", [item])
    with services.storage.read() as unit:
        known = unit.webhooks.get(webhook_id)
        place = _place(unit, known, request.scope["path"], body)
    with services.storage.write() as unit:
        moved = unit.webhooks.change(replace(unit.webhooks.locked(webhook_id), position=place))
    return answer(request, webhooks.webhook(moved))


@router.post(
    "/secret", dependencies=_WRITING, response_model=webhooks.RotatedSecret, responses=described(404, 413, 415)
)
def rotate_webhook_secret(
    request: Request, services: ServicesDep, webhook_id: WebhookId, body: webhooks.Rotation
) -> Response:
    """Let another secret sign; it is in this answer alone. Those before it sign beside it for a while."""
    secret, now_ns = new_secret(), services.clock.now_ns()
    until_ns = now_ns + body.overlap_s * SECOND_NS
    with services.storage.write() as unit:
        unit.webhooks.locked(webhook_id)
        unit.webhooks.rotate(webhook_id, secret, now_ns, until_ns)
    headers = {"Cache-Control": "no-store"}
    return answer(request, webhooks.rotated(webhook_id, secret, until_ns), status=HTTPStatus.OK, headers=headers)


def _trial(services: Services, webhook_id: int) -> tuple[str, str, dict[str, str], bytes]:
    """Return where a trial is sent, its identity, its headers and its body."""
    now_ns = services.clock.now_ns()
    with services.storage.read() as unit:
        webhook, branches = unit.webhooks.get(webhook_id), unit.feed_branches.all()
    with replace(services.storage, visible_fleets=None).read() as unit:  # what signs is shown to no bound caller
        secrets = unit.webhooks.secrets(webhook_id, now_ns)
    identity, payload = trial_event(branches, webhook_id, now_ns)
    return webhook.url, identity, dict(signed_headers(secrets, identity, now_ns, payload)), payload


def _place(unit: SqlUnitOfWork, known: Webhook, path: str, body: webhooks.Replay) -> int:
    """Return the number of the event behind which a webhook is to go on.

    Raises
    ------
    ProblemError
        400: the cursor is none of the feed, of the webhook's events, or of all that its key sees; 409: it is of
        another history of the database.
    """
    if body.from_time is not None:
        return unit.webhooks.last_before(body.from_time)
    if body.after == LATEST:
        return unit.feed_branches.newest_sequence()
    whole = FeedFilter(visible=known.bound)
    own = replace(whole, fleets=known.fleets, kinds=known.kinds, severities=known.severities)
    try:
        narrowed, given = whole, feed_cursors.decode(whole, body.after)
    except ProblemError:
        narrowed, given = own, feed_cursors.decode(own, body.after)
    last = feed_cursors.position(unit, narrowed, path, given)
    return 0 if last is None else last.sequence
