"""What is done with a webhook: tried out, sent the feed again, signed with another secret."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from http import HTTPStatus

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.scopes import Scope, requires
from api.answers import answer
from api.feed.places import TRY_AGAIN
from api.middleware import turn_of
from api.problems import ProblemError, ProblemItem, described
from api.routes.webhooks import WebhookId
from api.services import ServicesDep, writer_slot
from api.webhooks import representations as webhooks
from api.webhooks.making import place_of
from api.webhooks.sending import TRIALS, Sender
from api.webhooks.signing import new_secret
from api.webhooks.trials import trial_of

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
    trial = await run_in_threadpool(trial_of, services.storage, webhook_id, services.clock.now_ns())
    async with places:
        with turn_of(request.scope).given_back():
            outcome = await sender.send(trial.url, trial.headers, trial.body)
    return answer(request, webhooks.trial(trial.identity, outcome))


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
        place = place_of(unit, known, body.after, body.from_time, request.scope["path"])
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
