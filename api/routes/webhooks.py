"""Webhooks: made, listed, changed and deleted by who administers their fleets."""

from __future__ import annotations

from dataclasses import replace
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api import cursors
from api.access.caller import NOBODY_NAMED, Caller, CallerDep
from api.access.scopes import Scope, requires
from api.answers import IfMatch, answer, require_match
from api.asking import AskedDep, AskedListDep
from api.known import require_known
from api.problems import ProblemError, ProblemItem, described
from api.schemas.common import Page
from api.services import Services, ServicesDep
from api.webhooks import representations as webhooks
from api.webhooks.making import Wanted, handled_up_to, in_state, make_webhook
from api.webhooks.sending import Sender
from api.webhooks.targets import RefusedTargetError
from fleet_db.webhook_records import DeliveryState, Webhook, WebhookState

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], dependencies=[Depends(requires(Scope.ADMIN))])
WebhookId = Annotated[int, Path(ge=1, lt=cursors.INT64, description="Number of the webhook.", examples=[1])]
OfState = Annotated[DeliveryState | None, Query(description="Only in this state.")]


@router.get("", response_model=Page[webhooks.Webhook], responses=described(400))
def list_webhooks(asked: AskedListDep) -> Response:
    """List the webhooks by number: those whose fleets the caller sees, never their secrets."""
    after = asked.after_number({})
    with asked.read() as unit:
        rows = unit.webhooks.page(after, asked.limit + 1)
    return asked.page({}, rows, lambda record: record.webhook_id, webhooks.webhook)


@router.get("/{webhook_id}", response_model=webhooks.Webhook, responses=described(404))
def get_webhook(asked: AskedDep, webhook_id: WebhookId) -> Response:
    """Return one webhook, without its secret; its ETag is what changes to it ask for."""
    with asked.read() as unit:
        found = unit.webhooks.get(webhook_id)
    return asked.answer(webhooks.webhook(found))


@router.get("/{webhook_id}/deliveries", response_model=Page[webhooks.WebhookDelivery], responses=described(400, 404))
def list_webhook_deliveries(asked: AskedListDep, webhook_id: WebhookId, state: OfState = None) -> Response:
    """List what was sent to a webhook, newest first, with attempts, answers, and when what waits is sent again."""
    filters = {"webhook": webhook_id, "state": state}
    before = asked.after_number(filters)
    with asked.read() as unit:
        unit.webhooks.get(webhook_id)
        rows = unit.webhooks.deliveries(webhook_id, before, asked.limit + 1, state)
    return asked.page(filters, rows, lambda record: record.delivery_id, webhooks.delivery)


@router.post(
    "",
    status_code=HTTPStatus.CREATED,
    response_model=webhooks.WebhookWithSecret,
    responses=described(404, 409, 413, 415),
)
async def create_webhook(
    request: Request, services: ServicesDep, caller: CallerDep, body: webhooks.NewWebhook
) -> Response:
    """Make a webhook; its secret is in this answer alone. There is no `Idempotency-Key`: its answer would be stored.

    It begins with what happens from now on, and never carries an event of a fleet that this key does not see.
    """
    if caller.fleets is not None and not caller.fleets:
        raise ProblemError(403, "forbidden", "this needs a key that sees a fleet")
    await run_in_threadpool(_require_fleets, services, caller.fleets, frozenset(body.fleets))
    await _require_target(request, body.url)
    async with services.writers.slot():
        made, secret = await run_in_threadpool(_made, services, caller, body)
    headers = {"Location": f"/v1/webhooks/{made.webhook_id}", "Cache-Control": "no-store"}
    return answer(request, webhooks.webhook_with_secret(made, secret), status=HTTPStatus.CREATED, headers=headers)


@router.patch("/{webhook_id}", response_model=webhooks.Webhook, responses=described(404, 409, 412, 413, 415, 428))
async def change_webhook(
    request: Request,
    services: ServicesDep,
    webhook_id: WebhookId,
    body: webhooks.WebhookChange,
    if_match: IfMatch = None,
) -> Response:
    """Change a webhook; `If-Match` carries its ETag. What it was not sent yet is sent as it is now asked for.

    Another filter applies to events from now on, and to those that wait.
    """
    known = await run_in_threadpool(_read, services, webhook_id)
    if body.fleets is not None:
        await run_in_threadpool(_require_fleets, services, known.bound, frozenset(body.fleets))
    if body.url is not None:
        await _require_target(request, body.url)
    async with services.writers.slot():
        changed = await run_in_threadpool(_changed, services, webhook_id, body, if_match)
    return answer(request, webhooks.webhook(changed))


@router.delete("/{webhook_id}", response_model=webhooks.Webhook, responses=described(404))
def delete_webhook(request: Request, services: ServicesDep, webhook_id: WebhookId) -> Response:
    """Delete a webhook with its secrets and the records of its deliveries; return what it was."""
    with services.storage.write() as unit:
        found = unit.webhooks.get(webhook_id)
        unit.webhooks.delete(webhook_id)
    return answer(request, webhooks.webhook(found))


def _made(services: Services, caller: Caller, body: webhooks.NewWebhook) -> tuple[Webhook, str]:
    severities = frozenset(one.value for one in body.severities)
    wanted = Wanted(
        body.url, body.description, frozenset(body.fleets), frozenset(body.kinds), severities, caller.fleets
    )
    with services.storage.write() as unit:
        return make_webhook(unit, wanted, caller.name or NOBODY_NAMED, services.clock.now_ns())


def _changed(services: Services, webhook_id: int, body: webhooks.WebhookChange, if_match: str | None) -> Webhook:
    with services.storage.write() as unit:
        known = unit.webhooks.locked(webhook_id)
        require_match(if_match, webhooks.webhook(known))
        wanted = _as_asked(known, body, services.clock.now_ns())
        if (wanted.fleets, wanted.kinds, wanted.severities) != (known.fleets, known.kinds, known.severities):
            wanted = replace(wanted, position=handled_up_to(unit, known))
        return unit.webhooks.change(wanted)


def _as_asked(known: Webhook, body: webhooks.WebhookChange, now_ns: int) -> Webhook:
    """Return a webhook with what a change names; one that becomes active again is no longer disabled."""
    wanted = known
    if body.url is not None:
        wanted = replace(wanted, url=body.url)
    if body.description is not None:
        wanted = replace(wanted, description=body.description)
    if body.fleets is not None:
        wanted = replace(wanted, fleets=frozenset(body.fleets))
    if body.kinds is not None:
        wanted = replace(wanted, kinds=frozenset(body.kinds))
    if body.severities is not None:
        wanted = replace(wanted, severities=frozenset(one.value for one in body.severities))
    return wanted if body.state is None else in_state(wanted, WebhookState(body.state), now_ns)


def _read(services: Services, webhook_id: int) -> Webhook:
    with services.storage.read() as unit:
        return unit.webhooks.get(webhook_id)


def _require_fleets(services: Services, bound: frozenset[str] | None, fleets: frozenset[str]) -> None:
    """Refuse a filter that names a fleet which the webhook can never carry."""
    with services.storage.seen_by(bound).read() as unit:
        for fleet in sorted(fleets):
            require_known(unit, fleet=fleet)


async def _require_target(request: Request, url: str) -> None:
    """Refuse a URL that leads where nothing may be sent now; what it leads to is looked up again at each attempt."""
    sender: Sender = request.app.state.webhook_sender
    try:
        await sender.look_up(url)
    except RefusedTargetError as error:
        item = ProblemItem(part="body", pointer="#/url", detail=error.detail)
        raise ProblemError(422, "invalid-request", f"body #/url: {error.detail}", [item]) from None
