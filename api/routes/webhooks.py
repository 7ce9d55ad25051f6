"""Webhooks: made, listed, changed and deleted by who administers their fleets; tried out, moved, given new secrets."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from http import HTTPStatus
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import AfterValidator, Field, Strict, StringConstraints
from starlette.concurrency import run_in_threadpool

from api import cursors
from api.access.gate import CallerDep, Scope, requires
from api.access.key_ring import Caller
from api.access.keys import NOBODY_NAMED
from api.answers import IfMatch, answer, require_match
from api.asking import AskedDep, AskedListDep, Key
from api.feed.watch import TRY_AGAIN
from api.middleware import turn_of
from api.problems import ProblemError, described, invalid
from api.schemas.alerts import KnownKind
from api.schemas.common import Body, Derived, Links, Page, Representation
from api.services import Services, ServicesDep, require_fleets, writer_slot
from api.times import Moment, Timestamp, to_rfc3339
from api.webhooks.cloud_events import Wanted, handled_up_to, in_state, make_webhook, new_secret, place_of, trial_of
from api.webhooks.sending import MOST_CHARACTERS, TRIALS, RefusedTargetError, Sender, parsed
from estimation.errors import ParameterError
from estimation.values.alerts import AlertEventKind, Severity
from estimation.values.units import SECOND_NS
from fleet_db.records import Delivery, DeliveryState, Failure, WebhookState
from fleet_db.records import Webhook as WebhookRecord

MOST_VALUES = 50
LONGEST_OVERLAP_S = 604_800


def _leads_somewhere(url: str) -> str:
    try:
        parsed(url)
    except ParameterError as error:
        raise ValueError(error.reason) from None
    return url


Url = Annotated[
    str, StringConstraints(pattern=r"^https?://", max_length=MOST_CHARACTERS), AfterValidator(_leads_somewhere)
]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{0,500}$")]
WrittenSeverity = Annotated[Severity, Strict(strict=False)]  # JSON has texts, not members of an enumeration
URL = "Where events are posted to: https://, or http:// in an allowed network."
DESCRIPTION = "What it is for."
FLEETS = "Only events of these fleets; empty is all that it may carry."
KINDS = "Only events of alerts of these kinds; empty is all."
SEVERITIES = "Only alerts that have had one of these, from then on to their end; empty is all."
EXAMPLE_URL = "https://receiver.example/treadwatch"


class Webhook(
    Derived,
    of=WebhookRecord,
    without=("position", "revision"),
    columns="id url description fleets kinds severities bound_to state disabled_reason state_since created_at"
    " created_by links",
    links={"self": "/v1/webhooks/{webhook_id}", "deliveries": "/v1/webhooks/{webhook_id}/deliveries"},
):
    """Where events of the feed are sent, without its secret."""

    url: str = Field(description=URL, examples=[EXAMPLE_URL])
    description: str = Field(description=DESCRIPTION, examples=["work orders"])
    fleets: list[str] = Field(description=FLEETS, examples=[["alpha"]])
    kinds: list[str] = Field(description=KINDS)
    severities: list[Severity] = Field(description=SEVERITIES)

    @classmethod
    def made(cls, value: WebhookRecord, **more: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of a webhook, its severities in their order."""
        severities = [severity for severity in Severity if severity in value.severities]
        return super().made(value, severities=severities, **more)


class WebhookWithSecret(Webhook):
    """A webhook with a new secret."""

    secret: str = Field(description="What signs its events, as Standard Webhooks writes it; it is shown this once.")


class RotatedSecret(Representation):
    """A new secret of a webhook."""

    secret: str = Field(description="What signs its events from now on; it is shown this once.")
    former_signs_until: Timestamp = Field(description="Until when the secrets before it sign beside it.")
    links: Links


class NewWebhook(Body):
    """A webhook that is to be made; it begins with what happens from now on."""

    url: Url = Field(description=URL, examples=[EXAMPLE_URL])
    description: Text = Field(default="", description=DESCRIPTION, examples=["work orders"])
    fleets: list[Key] = Field(default=[], max_length=MOST_VALUES, description=FLEETS, examples=[["alpha"]])
    kinds: list[KnownKind] = Field(default=[], max_length=MOST_VALUES, description=KINDS)
    severities: list[WrittenSeverity] = Field(default=[], max_length=MOST_VALUES, description=SEVERITIES)


class WebhookChange(Body):
    """What changes of a webhook; what is left out, or null, stays."""

    url: Url | None = Field(default=None, description=URL, examples=[EXAMPLE_URL])
    description: Text | None = Field(default=None, description=DESCRIPTION)
    fleets: list[Key] | None = Field(default=None, max_length=MOST_VALUES, description=FLEETS)
    kinds: list[KnownKind] | None = Field(default=None, max_length=MOST_VALUES, description=KINDS)
    severities: list[WrittenSeverity] | None = Field(default=None, max_length=MOST_VALUES, description=SEVERITIES)
    state: Literal["active", "paused"] | None = Field(
        default=None, description="`active` goes on from where it stood; `paused` waits there."
    )


class Replay(Body):
    """From where a webhook is sent the feed again: give one of the two."""

    after: str | None = Field(
        default=None,
        description="A cursor of the feed, or the id of an event that was sent: from the event behind it on. "
        "`latest` leaves out what was not delivered yet.",
        examples=["latest"],
    )
    from_time: Moment | None = Field(
        default=None, alias="from", description="From the first event on that was recorded at or after this time."
    )


class Rotation(Body):
    """How a secret is replaced."""

    overlap_s: int = Field(
        default=86_400,
        ge=0,
        le=LONGEST_OVERLAP_S,
        description="How long the secrets before it still sign beside it; 0 where one has leaked.",
    )


class WebhookDelivery(
    Derived,
    of=Delivery,
    without=("webhook_id", "sequence", "event_kind", "alert_id"),
    columns="id event_id event event_recorded_at state attempts first_attempt_at last_attempt_at next_attempt_at"
    " status_code reason_code reason links",
    links={"webhook": "/v1/webhooks/{webhook_id}", "alert": "/v1/alerts/{alert_id}"},
):
    """An event on its way to a webhook."""

    event: AlertEventKind


class WebhookTrial(Representation):
    """What came back of an event that only tries out a webhook."""

    event_id: str = Field(description="Its id.", examples=["test-4b6d"])
    delivered: bool = Field(description="Whether the receiver took it.")
    status_code: int | None = Field(description="Status of the answer; null without one.", examples=[204])
    reason_code: Failure | None = Field(description="Why it was not taken; null where it was.")
    reason: str | None = Field(description="The same as a sentence.")
    took_s: float = Field(description="How long it took.", examples=[0.2])


router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], dependencies=[Depends(requires(Scope.ADMIN))])
WebhookId = Annotated[int, Path(ge=1, lt=cursors.INT64, description="Number of the webhook.", examples=[1])]
OfState = Annotated[DeliveryState | None, Query(description="Only in this state.")]


@router.get("", response_model=Page[Webhook], responses=described(400))
def list_webhooks(asked: AskedListDep) -> Response:
    """List the webhooks by number: those whose fleets the caller sees, never their secrets."""
    after = asked.after_number({})
    with asked.read() as unit:
        rows = unit.webhooks.page(after, asked.limit + 1)
    return asked.page({}, rows, lambda record: record.webhook_id, Webhook.made)


@router.get("/{webhook_id}", response_model=Webhook, responses=described(404))
def get_webhook(asked: AskedDep, webhook_id: WebhookId) -> Response:
    """Return one webhook, without its secret; its ETag is what changes to it ask for."""
    return asked.one(lambda unit: Webhook.made(unit.webhooks.get(webhook_id)))


@router.get("/{webhook_id}/deliveries", response_model=Page[WebhookDelivery], responses=described(400, 404))
def list_webhook_deliveries(asked: AskedListDep, webhook_id: WebhookId, state: OfState = None) -> Response:
    """List what was sent to a webhook, newest first, with attempts, answers, and when what waits is sent again."""
    filters = {"webhook": webhook_id, "state": state}
    before = asked.after_number(filters)
    with asked.read() as unit:
        unit.webhooks.get(webhook_id)
        rows = unit.webhooks.deliveries(webhook_id, before, asked.limit + 1, state)

    def represent(record: Delivery) -> WebhookDelivery:
        return WebhookDelivery.made(record, event=AlertEventKind(record.event_kind))

    return asked.page(filters, rows, lambda record: record.delivery_id, represent)


@router.post("", status_code=201, response_model=WebhookWithSecret, responses=described(404, 409, 413, 415))
async def create_webhook(request: Request, services: ServicesDep, caller: CallerDep, body: NewWebhook) -> Response:
    """Make a webhook; its secret is in this answer alone. There is no `Idempotency-Key`: its answer would be stored.

    It begins with what happens from now on, and never carries an event of a fleet that this key does not see.
    """
    if caller.fleets is not None and not caller.fleets:
        raise ProblemError(403, "forbidden", "this needs a key that sees a fleet")
    await run_in_threadpool(require_fleets, services.storage, body.fleets)
    await _require_target(request, body.url)
    async with services.writers.slot():
        made, secret = await run_in_threadpool(_made, services, caller, body)
    headers = {"Location": f"/v1/webhooks/{made.webhook_id}", "Cache-Control": "no-store"}
    return answer(request, WebhookWithSecret.made(made, secret=secret), status=HTTPStatus.CREATED, headers=headers)


@router.patch("/{webhook_id}", response_model=Webhook, responses=described(404, 409, 412, 413, 415, 428))
async def change_webhook(
    request: Request, services: ServicesDep, webhook_id: WebhookId, body: WebhookChange, if_match: IfMatch = None
) -> Response:
    """Change a webhook; `If-Match` carries its ETag. What it was not sent yet is sent as it is now asked for.

    Another filter applies to events from now on, and to those that wait.
    """
    webhook = await run_in_threadpool(_read, services, webhook_id)
    if body.fleets is not None:
        await run_in_threadpool(require_fleets, services.storage.seen_by(webhook.bound), body.fleets)
    if body.url is not None:
        await _require_target(request, body.url)
    async with services.writers.slot():
        changed = await run_in_threadpool(_changed, services, webhook_id, body, if_match)
    return answer(request, Webhook.made(changed))


@router.delete("/{webhook_id}", response_model=Webhook, responses=described(404))
def delete_webhook(request: Request, services: ServicesDep, webhook_id: WebhookId) -> Response:
    """Delete a webhook with its secrets and the records of its deliveries; return what it was."""
    with services.storage.write() as unit:
        webhook = unit.webhooks.get(webhook_id)
        unit.webhooks.delete(webhook_id)
    return answer(request, Webhook.made(webhook))


def _made(services: Services, caller: Caller, body: NewWebhook) -> tuple[WebhookRecord, str]:
    filters = frozenset(body.fleets), frozenset(body.kinds), frozenset(severity.value for severity in body.severities)
    wanted = Wanted(body.url, body.description, *filters, caller.fleets)
    with services.storage.write() as unit:
        return make_webhook(unit, wanted, caller.name or NOBODY_NAMED, services.clock.now_ns())


def _changed(services: Services, webhook_id: int, body: WebhookChange, if_match: str | None) -> WebhookRecord:
    with services.storage.write() as unit:
        webhook = unit.webhooks.locked(webhook_id)
        require_match(if_match, Webhook.made(webhook))
        given = body.model_dump(mode="json", exclude_none=True, exclude={"state"}).items()
        changes: dict[str, Any] = {name: frozenset(item) if isinstance(item, list) else item for name, item in given}
        wanted = replace(webhook, **changes)
        if body.state is not None:
            wanted = in_state(wanted, WebhookState(body.state), services.clock.now_ns())
        if any(getattr(wanted, name) != getattr(webhook, name) for name in ("fleets", "kinds", "severities")):
            wanted = replace(wanted, position=handled_up_to(unit, webhook))
        return unit.webhooks.change(wanted)


def _read(services: Services, webhook_id: int) -> WebhookRecord:
    with services.storage.read() as unit:
        return unit.webhooks.get(webhook_id)


async def _require_target(request: Request, url: str) -> None:
    """Refuse a URL that leads where nothing may be sent now; what it leads to is looked up again at each attempt."""
    sender: Sender = request.app.state.webhook_sender
    try:
        await sender.look_up(url)
    except RefusedTargetError as error:
        raise invalid("#/url", error.detail) from None


_WRITING = [Depends(writer_slot)]


@router.post("/{webhook_id}/test", response_model=WebhookTrial, responses=described(404, 415))
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
    shown = WebhookTrial(
        event_id=trial.identity,
        delivered=outcome.failure is None,
        status_code=outcome.status_code,
        reason_code=outcome.failure,
        reason=outcome.detail,
        took_s=round(outcome.took_s, 3),
    )
    return answer(request, shown)


@router.post(
    "/{webhook_id}/replay", dependencies=_WRITING, response_model=Webhook, responses=described(400, 404, 409, 413, 415)
)
def replay_webhook(request: Request, services: ServicesDep, webhook_id: WebhookId, body: Replay) -> Response:
    """Let a webhook go on from another place of the feed; what was sent already is sent again, under the same ids."""
    if (body.after is None) == (body.from_time is None):
        raise invalid("#/after", "give either `after` or `from`")
    with services.storage.read() as unit:
        webhook = unit.webhooks.get(webhook_id)
        place = place_of(unit, webhook, body.after, body.from_time, request.scope["path"])
    with services.storage.write() as unit:
        moved = unit.webhooks.change(replace(unit.webhooks.locked(webhook_id), position=place))
    return answer(request, Webhook.made(moved))


@router.post(
    "/{webhook_id}/secret", dependencies=_WRITING, response_model=RotatedSecret, responses=described(404, 413, 415)
)
def rotate_webhook_secret(request: Request, services: ServicesDep, webhook_id: WebhookId, body: Rotation) -> Response:
    """Let another secret sign; it is in this answer alone. Those before it sign beside it for a while."""
    secret, now_ns = new_secret(), services.clock.now_ns()
    until_ns = now_ns + body.overlap_s * SECOND_NS
    with services.storage.write() as unit:
        unit.webhooks.locked(webhook_id)
        unit.webhooks.rotate(webhook_id, secret, now_ns, until_ns)
    links = {"webhook": f"/v1/webhooks/{webhook_id}"}
    shown = RotatedSecret(secret=secret, former_signs_until=to_rfc3339(until_ns), links=links)
    return answer(request, shown, headers={"Cache-Control": "no-store"})
